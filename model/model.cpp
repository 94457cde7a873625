#include "model/model.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <nlohmann/json.hpp>
#include <numeric>
#include <set>

#include "proto/result.h"

namespace csipose {
namespace {

using nlohmann::json;

constexpr const char* kFormatVersion = "1";
constexpr std::string_view kInt8Prefix = "calib.int8.";
/// Kept in the file for training; the live network has no use for them.
constexpr std::array<std::string_view, 2> kTrainingPrefixes = {"target_encoder.", "predictor."};

bool starts_with(std::string_view text, std::string_view prefix) {
  return text.substr(0, prefix.size()) == prefix;
}

/// joint_of[i] = the project's joint that stands at place i of the file.
using JointOrder = std::array<std::size_t, kJoints>;

/// Moves groups of `width` rows from the file's order of joints to ours.
void permute_joints(Tensor& tensor, const JointOrder& joint_of) {
  const std::size_t width = tensor.data.size() / kJoints;
  const std::vector<float> file_order = tensor.data;
  for (std::size_t i = 0; i < kJoints; ++i)
    std::copy_n(file_order.begin() + static_cast<std::ptrdiff_t>(i * width), width,
                tensor.data.begin() + static_cast<std::ptrdiff_t>(joint_of[i] * width));
}

}  // namespace

/// Goes through a file once; every refusal names the file and the culprit.
class ModelReader {
 public:
  explicit ModelReader(const SafetensorsFile& file) : file_(file) {}

  std::shared_ptr<const Model> read() {
    model_ = std::shared_ptr<Model>(new Model);
    model_->digest_ = file_.digest();
    model_->file_name_ = file_.name();
    if (!file_.sealed()) refuse("it carries no content_sha256, so damage could not be seen", kOtherProgram);
    if (metadata("format_version") != kFormatVersion)
      refuse(fmt::format("its format_version is '{}', this program reads {}", metadata("format_version"),
                         kFormatVersion),
             "take a program and a file of the same age");
    read_config();
    read_provenance();
    read_demand();
    read_room();
    read_network();
    read_normalisation();
    read_calibration();
    read_gate();
    apply_joint_order();
    check_nothing_unknown();
    return model_;
  }

  JointOrder read_joint_order() const {
    const json names = json::parse(metadata("joint_order"), nullptr, false);
    if (!names.is_array() || names.size() != kJoints) refuse("its joint_order is no list of 14 names");
    JointOrder joint_of{};
    std::set<std::size_t> seen;
    for (std::size_t i = 0; i < kJoints; ++i) {
      if (!names[i].is_string()) refuse("its joint_order holds something that is no name");
      const auto& name = names[i].get_ref<const std::string&>();
      const auto* found = std::find(kJointNames.begin(), kJointNames.end(), name);
      joint_of[i] = static_cast<std::size_t>(found - kJointNames.begin());
      if (found == kJointNames.end() || !seen.insert(joint_of[i]).second)
        refuse(fmt::format("its joint_order has '{}', which is unknown or named twice", name));
    }
    return joint_of;
  }

 private:
  static constexpr const char* kOtherProgram =
      "take a file that csipose wrote, or make one with 'csipose model init'";
  static constexpr const char* kMadeWrong =
      "take the file from its origin again, or report it to whoever made it";

  [[noreturn]] void refuse(const std::string& reason, const std::string& remedy = kMadeWrong) const {
    throw SetupError(ExitStatus::bad_data,
                     fmt::format("model file {}: {}; {}", file_.name(), reason, remedy));
  }

  const std::string& metadata(const std::string& key) const {
    const auto found = file_.metadata().find(key);
    if (found == file_.metadata().end()) refuse(fmt::format("its metadata have no '{}'", key));
    return found->second;
  }

  const std::string& one_of(const std::string& key, const std::vector<std::string>& allowed) const {
    const std::string& value = metadata(key);
    if (std::find(allowed.begin(), allowed.end(), value) == allowed.end())
      refuse(fmt::format("its metadata '{}' is '{}', none of {}", key, value, fmt::join(allowed, ", ")));
    return value;
  }

  /// A number written as JSON writes it, within bounds.
  template <class Number>
  Number number(const std::string& key, Number least, Number most) const {
    const json value = json::parse(metadata(key), nullptr, /*allow_exceptions=*/false);
    const bool fits = std::is_integral_v<Number> ? value.is_number_unsigned() : value.is_number();
    if (!fits || value.get<Number>() < least || value.get<Number>() > most)
      refuse(fmt::format("its metadata '{}' is '{}', not a number from {} to {}", key, metadata(key), least,
                         most));
    return value.get<Number>();
  }

  /// A tensor by name as float32: right shape, floating point, finite.
  Tensor tensor(const std::string& name, const std::vector<std::size_t>& shape) {
    const TensorView* view = file_.find(name);
    if (view == nullptr) refuse(fmt::format("tensor '{}' of shape {} is missing", name, shape_text(shape)));
    const bool scalar = shape.empty() && view->shape == std::vector<std::size_t>{1};
    if (view->shape != shape && !scalar)
      refuse(fmt::format("tensor '{}' has shape {}, its configuration demands {}", name,
                         shape_text(view->shape), shape_text(shape)));
    if (!is_floating_point(view->dtype))
      refuse(fmt::format("tensor '{}' is {}, no floating point", name, name_of(view->dtype)));
    Tensor read{shape, to_floats(*view)};
    for (const float value : read.data)
      if (!std::isfinite(value)) refuse(fmt::format("tensor '{}' holds a number that is not finite", name));
    known_.insert(name);
    return read;
  }

  float scalar(const std::string& name) { return tensor(name, {}).data.front(); }
  float positive_scalar(const std::string& name) {
    const float value = scalar(name);
    if (!(value > 0)) refuse(fmt::format("'{}' is {}, it must be above zero", name, value));
    return value;
  }

  void read_config() try {
    model_->config_ = config_from_json(metadata("preset"), metadata("config"));
  } catch (const SetupError& error) {
    if (starts_with(error.what(), "model file")) throw;
    refuse(fmt::format("its {}", error.what()));
  }

  void read_provenance() {
    Provenance& from = model_->provenance_;
    from.stage = one_of("stage", {"untrained", "pretrained", "finetuned"});
    from.step = number<std::uint64_t>("step", 0, UINT64_MAX);
    from.seed = number<std::uint64_t>("seed", 0, UINT64_MAX);
    from.git = metadata("git");
    from.corpus = metadata("corpus");
    from.metrics = metadata("metrics");
    if (!json::parse(from.metrics, nullptr, false).is_object())
      refuse("its metadata 'metrics' is no JSON object");
    if (file_.metadata().count("calibration") > 0) from.confidences = metadata("calibration");
    if (!json::parse(from.confidences, nullptr, false).is_object())
      refuse("its metadata 'calibration' is no JSON object");
  }

  void read_demand() {
    WindowDemand& demand = model_->demand_;
    demand.rate_hz = number<double>("rate_hz", 1, 10'000);
    demand.phase = one_of("phase", {"joint", "phasefi"});
    demand.amplitude = one_of("amplitude", {"raw", "scaled"});
    demand.min_links = number<std::size_t>("min_links", 1, kLinks);
  }

  void read_room() {
    const json rows = json::parse(metadata("model_to_room"), nullptr, false);
    if (!rows.is_array() || rows.size() != 3) refuse("its model_to_room is no 3 x 4 matrix");
    for (std::size_t r = 0; r < 3; ++r) {
      if (!rows[r].is_array() || rows[r].size() != 4) refuse("its model_to_room is no 3 x 4 matrix");
      for (std::size_t c = 0; c < 4; ++c) {
        if (!rows[r][c].is_number()) refuse("its model_to_room holds something that is no number");
        model_->model_to_room_[r][c] = rows[r][c].get<float>();
      }
    }
    check_keeps_lengths(model_->model_to_room_);
  }

  void check_keeps_lengths(const RoomTransform& m) const {
    for (std::size_t i = 0; i < 3; ++i)
      for (std::size_t j = i; j < 3; ++j) {
        const float dot = m[i][0] * m[j][0] + m[i][1] * m[j][1] + m[i][2] * m[j][2];
        if (!(std::fabs(dot - (i == j ? 1.f : 0.f)) < 1e-3f))
          refuse("its model_to_room is no rotation or mirroring: it would change lengths");
      }
    for (const auto& row : m)
      if (!std::isfinite(row[3])) refuse("its model_to_room shifts by a number that is not finite");
  }

  void read_network() {
    for (const TensorSpec& spec : required_tensors(model_->config_))
      model_->tensors_.add(spec.name, tensor(spec.name, spec.shape));
  }

  void read_normalisation() {
    model_->normalisation_ = {
        scalar("norm.amp_mean"), positive_scalar("norm.amp_std"), positive_scalar("norm.ph_std"), {}};
    if (file_.find("norm.background_response") || file_.find("norm.background_deviation")) read_backgrounds();
  }

  void read_backgrounds() {
    const json names = json::parse(metadata("backgrounds"), nullptr, false);
    if (!names.is_array() || names.empty() || names.size() > kMostBackgrounds)
      refuse(fmt::format("its metadata 'backgrounds' is no list of 1 to {} names", kMostBackgrounds));
    const Tensor response = tensor("norm.background_response", {names.size(), kChannels, kLinks});
    const Tensor deviation = tensor("norm.background_deviation", {names.size(), kChannels, kLinks});
    if (!(*std::min_element(deviation.data.begin(), deviation.data.end()) > 0))
      refuse("'norm.background_deviation' has a number not above zero");
    for (std::size_t i = 0; i < names.size(); ++i) {
      if (!names[i].is_string()) refuse("its metadata 'backgrounds' holds something that is no name");
      Background& background = model_->normalisation_.backgrounds.emplace_back();
      background.name = names[i].get<std::string>();
      const auto first = static_cast<std::ptrdiff_t>(i * kElements);
      std::copy_n(response.data.begin() + first, kElements, background.response.begin());
      std::copy_n(deviation.data.begin() + first, kElements, background.deviation.begin());
    }
  }

  void read_calibration() {
    Calibration& calibration = model_->calibration_;
    if (file_.find("calib.score")) {
      const Tensor ab = tensor("calib.score", {2});
      calibration.score = PlattScaling{ab.data[0], ab.data[1]};
      if (!(ab.data[0] > 0)) refuse("'calib.score' would turn the order of scores around");
    }
    if (file_.find("calib.joint_scale")) {
      calibration.joint_scale.emplace();
      const Tensor k = tensor("calib.joint_scale", {kJoints});
      std::copy(k.data.begin(), k.data.end(), calibration.joint_scale->begin());
      if (*std::min_element(k.data.begin(), k.data.end()) <= 0)
        refuse("'calib.joint_scale' has a factor not above zero");
    }
    if (file_.find("calib.conf")) calibration.confidence = read_curve();
    for (const TensorView& view : file_.tensors())
      if (starts_with(view.name, kInt8Prefix)) read_int8_scale(view.name);
  }

  ConfidenceCurve read_curve() {
    const Tensor knots = tensor("calib.conf", {2, kConfidenceKnots});
    ConfidenceCurve curve;
    std::copy_n(knots.data.begin(), kConfidenceKnots, curve.raw.begin());
    std::copy_n(knots.data.begin() + kConfidenceKnots, kConfidenceKnots, curve.corrected.begin());
    for (std::size_t i = 0; i < kConfidenceKnots; ++i) {
      const bool rises =
          i == 0 || (curve.raw[i] > curve.raw[i - 1] && curve.corrected[i] >= curve.corrected[i - 1]);
      if (!rises || curve.corrected[i] < 0 || curve.corrected[i] > 1)
        refuse("'calib.conf' is no rising curve of probabilities");
    }
    return curve;
  }

  void read_int8_scale(const std::string& name) {
    const std::string layer = name.substr(kInt8Prefix.size());
    if (!model_->tensors_.find(layer + ".weight") && !model_->tensors_.find(layer + "_weight"))
      refuse(fmt::format("'{}' belongs to no layer of this network", name));
    model_->calibration_.int8_input_max[layer] = positive_scalar(name);
  }

  /// {"int8": {"mean_joint_shift_m": .., "max_joint_shift_m": .., "windows": ..}}
  void read_gate() {
    if (file_.metadata().count("gate") == 0) return;
    const json gate = json::parse(metadata("gate"), nullptr, false);
    if (!gate.is_object()) refuse("its metadata 'gate' is no JSON object");
    for (const auto& [precision, figures] : gate.items()) {
      if (precision != "bf16" && precision != "int8")
        refuse(fmt::format("its gate names the precision '{}'", precision));
      GateFigures& read = model_->gate_[precision];
      only(figures, {"mean_joint_shift_m", "max_joint_shift_m", "windows", "labelled"});
      read = {gate_number(figures, "mean_joint_shift_m"), gate_number(figures, "max_joint_shift_m"),
              static_cast<std::uint64_t>(gate_number(figures, "windows")), std::nullopt};
      if (figures.contains("labelled")) {
        const json& labelled = figures["labelled"];
        only(labelled, {"mpjpe_m", "f32_mpjpe_m", "windows"});
        read.labelled = {gate_number(labelled, "mpjpe_m"), gate_number(labelled, "f32_mpjpe_m"),
                         static_cast<std::uint64_t>(gate_number(labelled, "windows"))};
      }
    }
  }

  void only(const json& figures, const std::set<std::string>& keys) const {
    if (!figures.is_object()) refuse("its gate holds something that is no object");
    for (const auto& [key, value] : figures.items())
      if (keys.count(key) == 0) refuse(fmt::format("its gate has a '{}' that nobody reads", key));
  }
  double gate_number(const json& figures, const char* key) const {
    if (!figures.contains(key) || !figures[key].is_number() || !(figures[key].get<double>() >= 0) ||
        figures[key].get<double>() > 1e15)
      refuse(fmt::format("its gate has no sound '{}'", key));
    return figures[key].get<double>();
  }

  /// Joints meet the weights in four places; attention among them does not care for order.
  void apply_joint_order() {
    const JointOrder joint_of = read_joint_order();
    for (std::size_t i = 0; i <= model_->config_.decoder_layers; ++i) {
      permute_joints(model_->tensors_.at(fmt::format("kpt_branches.{}.6.weight", i)), joint_of);
      permute_joints(model_->tensors_.at(fmt::format("kpt_branches.{}.6.bias", i)), joint_of);
    }
    if (model_->config_.refine_layers > 0)
      permute_joints(model_->tensors_.at("refine_query_embedding.weight"), joint_of);
    if (auto& scale = model_->calibration_.joint_scale) {
      const auto file_order = *scale;
      for (std::size_t i = 0; i < kJoints; ++i) (*scale)[joint_of[i]] = file_order[i];
    }
  }

  void check_nothing_unknown() const {
    for (const TensorView& view : file_.tensors()) {
      const bool training =
          std::any_of(kTrainingPrefixes.begin(), kTrainingPrefixes.end(),
                      [&](std::string_view prefix) { return starts_with(view.name, prefix); });
      if (!training && known_.count(view.name) == 0)
        refuse(fmt::format("tensor '{}' is not part of a network of this configuration", view.name));
    }
  }

  const SafetensorsFile& file_;
  std::shared_ptr<Model> model_;
  std::set<std::string> known_;
};

std::shared_ptr<const Model> Model::load(const std::filesystem::path& path) {
  return from(SafetensorsFile::read(path));
}
std::shared_ptr<const Model> Model::from(const SafetensorsFile& file) { return ModelReader(file).read(); }

namespace {
template <class Predicate>
std::vector<TensorView> tensors_without(const SafetensorsFile& file, Predicate unwanted) {
  std::vector<TensorView> tensors;
  for (const TensorView& view : file.tensors())
    if (!unwanted(view.name)) tensors.push_back(view);
  return tensors;
}
}  // namespace

std::string to_json(const std::map<std::string, GateFigures>& gate) {
  json out = json::object();
  for (const auto& [precision, figures] : gate) {
    json& one = out[precision] = {{"mean_joint_shift_m", figures.mean_joint_shift_m},
                                  {"max_joint_shift_m", figures.max_joint_shift_m},
                                  {"windows", figures.windows}};
    if (figures.labelled)
      one["labelled"] = {{"mpjpe_m", figures.labelled->mpjpe_m},
                         {"f32_mpjpe_m", figures.labelled->f32_mpjpe_m},
                         {"windows", figures.labelled->windows}};
  }
  return out.dump();
}

std::vector<std::uint8_t> with_int8_calibration(const SafetensorsFile& file,
                                                const std::map<std::string, float>& input_max,
                                                const std::map<std::string, GateFigures>& figures) {
  std::vector<TensorView> tensors =
      tensors_without(file, [](std::string_view name) { return starts_with(name, kInt8Prefix); });
  for (const auto& [layer, value] : input_max)
    tensors.push_back({std::string(kInt8Prefix) + layer, DType::f32, {}, ByteView(&value, sizeof(value))});
  std::map<std::string, std::string> metadata = file.metadata();
  metadata["gate"] = to_json(figures);
  return pack_safetensors(std::move(metadata), tensors);
}

std::vector<std::uint8_t> with_gate(const SafetensorsFile& file,
                                    const std::map<std::string, GateFigures>& figures) {
  std::map<std::string, std::string> metadata = file.metadata();
  metadata["gate"] = to_json(figures);
  return pack_safetensors(std::move(metadata), file.tensors());
}

std::vector<std::uint8_t> with_confidences(const SafetensorsFile& file, const Calibration& calibration,
                                           const std::string& account) {
  std::vector<TensorView> tensors = tensors_without(file, [](std::string_view name) {
    return name == "calib.score" || name == "calib.joint_scale" || name == "calib.conf";
  });
  const auto put = [&](const char* name, std::vector<std::size_t> shape, const std::vector<float>& numbers) {
    tensors.push_back(
        {name, DType::f32, std::move(shape), ByteView(numbers.data(), numbers.size() * sizeof(float))});
  };
  std::vector<float> score, joint_scale, curve;
  if (calibration.score) put("calib.score", {2}, score = {calibration.score->a, calibration.score->b});
  if (calibration.joint_scale) {
    for (const std::size_t joint : ModelReader(file).read_joint_order())
      joint_scale.push_back((*calibration.joint_scale)[joint]);
    put("calib.joint_scale", {kJoints}, joint_scale);
  }
  if (calibration.confidence) {
    const auto& [raw, corrected] = *calibration.confidence;
    curve.assign(raw.begin(), raw.end());
    curve.insert(curve.end(), corrected.begin(), corrected.end());
    put("calib.conf", {2, kConfidenceKnots}, curve);
  }
  std::map<std::string, std::string> metadata = file.metadata();
  metadata["calibration"] = account;
  return pack_safetensors(std::move(metadata), tensors);
}

std::vector<std::uint8_t> with_background(const SafetensorsFile& file, const Background& background) {
  std::vector<Background> all = Model::from(file)->normalisation().backgrounds;
  const auto known = std::ranges::find(all, background.name, &Background::name);
  if (known != all.end())
    *known = background;
  else
    all.push_back(background);
  return with_backgrounds(file, all);
}

std::vector<std::uint8_t> with_backgrounds(const SafetensorsFile& file, const std::vector<Background>& all) {
  if (all.size() > kMostBackgrounds)
    throw SetupError(ExitStatus::bad_data, fmt::format("{} has {} backgrounds, more it cannot have",
                                                       file.name(), kMostBackgrounds));
  std::vector<TensorView> tensors =
      tensors_without(file, [](std::string_view name) { return starts_with(name, "norm.background_"); });
  std::vector<float> response, deviation;
  json names = json::array();
  for (const Background& one : all) {
    response.insert(response.end(), one.response.begin(), one.response.end());
    deviation.insert(deviation.end(), one.deviation.begin(), one.deviation.end());
    names.push_back(one.name);
  }
  for (const auto& [name, numbers] :
       {std::pair("norm.background_response", &response), std::pair("norm.background_deviation", &deviation)})
    tensors.push_back({name,
                       DType::f32,
                       {all.size(), kChannels, kLinks},
                       ByteView(numbers->data(), numbers->size() * sizeof(float))});
  std::map<std::string, std::string> metadata = file.metadata();
  metadata["backgrounds"] = names.dump();
  return pack_safetensors(std::move(metadata), tensors);
}

}  // namespace csipose
