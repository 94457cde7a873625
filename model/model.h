// model/model.h - a weights file, checked whole: sizes, numbers, and what they were made for.
//
// Whatever this class holds fits its configuration: every tensor is there in its shape and is finite, nothing
// is there that nobody reads. A file that does not fit is refused with words. The format is told in
// docs/weights.md.
#pragma once

#include <array>
#include <cstdint>
#include <filesystem>
#include <map>
#include <memory>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "model/config.h"
#include "model/normalisation.h"
#include "model/safetensors.h"
#include "model/tensor.h"
#include "proto/pose.h"

namespace csipose {

/// Room from label frame: p_room = R p + t, rows [R | t]; R keeps lengths, and may mirror (the data set's
/// axes do).
using RoomTransform = std::array<std::array<float, 4>, 3>;
inline constexpr RoomTransform kIdentityTransform = {{{1, 0, 0, 0}, {0, 1, 0, 0}, {0, 0, 1, 0}}};

/// How a window must have been made for this network.
struct WindowDemand {
  double rate_hz = 300;           ///< samples a second of the window's grid
  std::string phase = "joint";    ///< "joint" or "phasefi"
  std::string amplitude = "raw";  ///< "raw" or "scaled"
  std::size_t min_links = 9;      ///< fewer present links: the network was not trained for that
};

/// Person score = sigmoid(a logit + b).
struct PlattScaling {
  float a = 1, b = 0;
};
inline constexpr std::size_t kConfidenceKnots = 20;
/// Monotone, piecewise linear: raw confidence -> confidence. `raw` ascends strictly.
struct ConfidenceCurve {
  std::array<float, kConfidenceKnots> raw{}, corrected{};
};

struct Calibration {
  std::optional<PlattScaling> score;  ///< tensor calib.score [2]
  std::optional<std::array<float, kJoints>>
      joint_scale;                            ///< tensor calib.joint_scale [14]: k of sigma_m = k sigma
  std::optional<ConfidenceCurve> confidence;  ///< tensor calib.conf [2, 20]: raw, corrected
  /// Largest magnitude seen at the input of a layer, by the layer's name (weight's name without ".weight" or
  /// "_weight"): scalars calib.int8.<layer>. Empty: the file is not calibrated for int8.
  std::map<std::string, float> int8_input_max;
};

/// How far a precision moves the joints against float32, measured when the file was calibrated.
struct GateFigures {
  double mean_joint_shift_m = 0, max_joint_shift_m = 0;
  std::uint64_t windows = 0;
  struct Labelled {
    double mpjpe_m = 0,
           f32_mpjpe_m = 0;  ///< protocol piw3d, of this precision and of float32 on the same windows
    std::uint64_t windows = 0;
  };
  std::optional<Labelled> labelled{};  ///< where people were labelled; decides then
};

/// Where the weights come from; for people, and for the mark UNTRAINED.
struct Provenance {
  std::string stage;  ///< "untrained", "pretrained", "finetuned"
  std::uint64_t step = 0, seed = 0;
  std::string git;                 ///< commit of the program that wrote it
  std::string corpus;              ///< what it was trained on; empty when on nothing
  std::string metrics;             ///< JSON object as the evaluation printed it; "{}" when there is none
  std::string confidences = "{}";  ///< JSON object: on what they were calibrated, and with what success
};

class Model {
 public:
  /// Reads and checks. Throws SetupError (no_input, io, bad_data).
  static std::shared_ptr<const Model> load(const std::filesystem::path& path);
  /// The same from a file in memory.
  static std::shared_ptr<const Model> from(const SafetensorsFile& file);

  const NetworkConfig& config() const { return config_; }
  /// Everything in required_tensors(config()), joints in the project's order whatever the file's was.
  const TensorMap& tensors() const { return tensors_; }
  const Normalisation& normalisation() const { return normalisation_; }
  const WindowDemand& demand() const { return demand_; }
  const RoomTransform& model_to_room() const { return model_to_room_; }
  const Calibration& calibration() const { return calibration_; }
  /// By precision ("bf16", "int8").
  const std::map<std::string, GateFigures>& gate() const { return gate_; }
  const Provenance& provenance() const { return provenance_; }
  bool untrained() const { return provenance_.stage == "untrained"; }
  /// SHA-256 of the file, 64 hex digits.
  const std::string& digest() const { return digest_; }
  /// Where it was read from; for words.
  const std::string& file_name() const { return file_name_; }

 private:
  friend class ModelReader;
  Model() = default;
  NetworkConfig config_;
  TensorMap tensors_;
  Normalisation normalisation_;
  WindowDemand demand_;
  RoomTransform model_to_room_ = kIdentityTransform;
  Calibration calibration_;
  std::map<std::string, GateFigures> gate_;
  Provenance provenance_;
  std::string digest_, file_name_;
};

/// What the last layers of the pose heads start as.
enum class HeadInit : std::uint8_t {
  zero,    ///< as training wants it: the untrained network says the same for every input, and finds nobody
  random,  ///< numbers everywhere, so that every output depends on the input: for comparing engines, and for
           ///< timing
};

/// Bytes of a weights file with random numbers, marked untrained. Encoder: normal, sigma 0.02 (timm's
/// trunc_normal_ cuts at +-2, a hundred sigma), biases 0. Decoder: Xavier uniform, biases 0, query tables
/// N(0, 1), class bias -ln 99, the last layer of every pose head as `heads` says. LayerNorm 1 and 0,
/// refine_identity 0 (random with HeadInit::random). Same configuration and seed: same bytes.
std::vector<std::uint8_t> random_weights(const NetworkConfig& config, std::uint64_t seed, HeadInit heads);
/// A model of those bytes.
std::shared_ptr<const Model> init_random(const NetworkConfig& config, std::uint64_t seed, HeadInit heads);

/// The file's metadata and tensors with `figures` and `input_max` put in (replacing older ones): what
/// calibration writes. Tensors outside the network, such as predictor.*, stay.
std::vector<std::uint8_t> with_int8_calibration(const SafetensorsFile& file,
                                                const std::map<std::string, float>& input_max,
                                                const std::map<std::string, GateFigures>& figures);
/// The same with `figures` alone put in.
std::vector<std::uint8_t> with_gate(const SafetensorsFile& file,
                                    const std::map<std::string, GateFigures>& figures);
/// As the metadata have it.
std::string to_json(const std::map<std::string, GateFigures>& gate);
/// The same with score, joint_scale and confidence of `calibration` in place of those it has; what is not given is taken
/// out. `account`: a JSON object, Provenance::confidences of the new file.
std::vector<std::uint8_t> with_confidences(const SafetensorsFile& file, const Calibration& calibration,
                                           const std::string& account);
/// The file with this background in place of the one of its name, or beside those it has. Throws SetupError (bad_data): it has
/// too many.
std::vector<std::uint8_t> with_background(const SafetensorsFile& file, const Background& background);
/// The file with these backgrounds, at least one, and no others.
std::vector<std::uint8_t> with_backgrounds(const SafetensorsFile& file, const std::vector<Background>& all);

}  // namespace csipose
