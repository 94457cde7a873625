#include "train/pack.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <glm/gtc/packing.hpp>

#include "model/model.h"
#include "proto/result.h"

namespace csipose::train {
namespace {

constexpr float kMostFloat16 = 65504;

bool starts_with_any(std::string_view name, std::initializer_list<std::string_view> beginnings) {
  for (const std::string_view beginning : beginnings)
    if (name.substr(0, beginning.size()) == beginning) return true;
  return false;
}

std::vector<std::uint8_t> as_float16(const std::string& file, const TensorView& tensor) {
  std::vector<std::uint8_t> bytes;
  for (const float number : to_floats(tensor)) {
    if (!(std::fabs(number) <= kMostFloat16))
      throw SetupError(
          ExitStatus::bad_data,
          fmt::format("{}: {} holds {}, which float16 has not; train it again", file, tensor.name, number));
    const std::uint16_t half = glm::packHalf1x16(number);
    bytes.push_back(static_cast<std::uint8_t>(half & 0xff));
    bytes.push_back(static_cast<std::uint8_t>(half >> 8));
  }
  return bytes;
}

}  // namespace

std::vector<std::uint8_t> pack_for_shipping(const SafetensorsFile& file,
                                            const std::map<std::string, std::string>& extra) {
  std::vector<TensorView> views;
  std::vector<std::vector<std::uint8_t>> kept;
  for (const TensorView& tensor : file.tensors()) {
    if (starts_with_any(tensor.name, {"predictor.", "target_encoder."})) continue;
    views.push_back(tensor);
    if (!is_floating_point(tensor.dtype) || starts_with_any(tensor.name, {"norm.", "calib."})) continue;
    kept.push_back(as_float16(file.name(), tensor));
    views.back().dtype = DType::f16;
    views.back().bytes = ByteView(kept.back().data(), kept.back().size());
  }
  std::map<std::string, std::string> metadata = file.metadata();
  for (const char* only_while_training : {"progress", "run", "content_sha256"})
    metadata.erase(only_while_training);
  for (const auto& [key, value] : extra) metadata[key] = value;
  return pack_safetensors(std::move(metadata), views);
}

SafetensorsFile knowing_only(const SafetensorsFile& file, const std::vector<std::string>& installations) {
  const auto model = Model::from(file);
  const std::vector<Background>& known = model->normalisation().backgrounds;
  std::vector<Background> kept;
  for (const std::string& name : installations) {
    const auto found = std::ranges::find(known, name, &Background::name);
    if (found == known.end()) {
      std::vector<std::string> names;
      for (const Background& background : known) names.push_back(background.name);
      throw SetupError(ExitStatus::usage,
                       fmt::format("{} knows no installation '{}'; it knows {}", file.name(), name,
                                   names.empty() ? "none" : fmt::to_string(fmt::join(names, "; "))));
    }
    kept.push_back(*found);
  }
  return SafetensorsFile::parse(with_backgrounds(file, kept), file.name());
}

}  // namespace csipose::train
