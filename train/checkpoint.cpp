#include "train/checkpoint.h"

#include <fcntl.h>
#include <fmt/format.h>
#include <sys/file.h>

#include <algorithm>
#include <cerrno>
#include <charconv>
#include <cstring>
#include <nlohmann/json.hpp>
#include <set>
#include <system_error>

#include "proto/result.h"

namespace csipose::train {
namespace {

namespace fs = std::filesystem;

fs::path weights_file(const fs::path& folder, std::uint64_t step) {
  return folder / fmt::format("step-{:08}.safetensors", step);
}
fs::path optimiser_file(const fs::path& folder, std::uint64_t step) {
  return folder / fmt::format("step-{:08}.optim.safetensors", step);
}

/// Steps of the checkpoints whose weights are there, ascending.
std::set<std::uint64_t> steps_in(const fs::path& folder) {
  std::set<std::uint64_t> steps;
  for (const fs::directory_entry& entry : fs::directory_iterator(folder)) {
    const std::string name = entry.path().filename().string();
    std::uint64_t step = 0;
    if (name.rfind("step-", 0) != 0) continue;
    const auto [rest, error] = std::from_chars(name.data() + 5, name.data() + name.size(), step);
    if (error == std::errc() && std::string_view(rest) == ".safetensors") steps.insert(step);
  }
  return steps;
}

std::vector<std::uint8_t> packed(const std::map<std::string, std::string>& metadata,
                                 const Parameters& parameters) {
  std::vector<at::Tensor> kept;
  return pack_safetensors(metadata, views_of(parameters, kept));
}

}  // namespace

Weights untrained_weights(const NetworkConfig& config, std::uint64_t seed) {
  const SafetensorsFile file =
      SafetensorsFile::parse(random_weights(config, seed, HeadInit::zero), "untrained weights");
  return {config, file.metadata(), parameters_of(file)};
}

Weights read_weights(const fs::path& path) {
  const SafetensorsFile file = SafetensorsFile::read(path);
  return {Model::from(file)->config(), file.metadata(), parameters_of(file)};
}

void write_weights(const fs::path& path, const Weights& weights) {
  write_file_atomically(path, packed(weights.metadata, weights.parameters));
}

void set_normalisation(Weights& weights, const Normalisation& scaling) {
  weights.parameters.set("norm.amp_mean", at::full({}, scaling.amp_mean));
  weights.parameters.set("norm.amp_std", at::full({}, scaling.amp_std));
  weights.parameters.set("norm.ph_std", at::full({}, scaling.ph_std));
  if (scaling.backgrounds.empty()) return;
  const auto count = static_cast<std::int64_t>(scaling.backgrounds.size());
  const at::Tensor response = at::empty({count, kChannels, kLinks}), deviation = at::empty_like(response);
  nlohmann::json names = nlohmann::json::array();
  for (std::size_t i = 0; i < scaling.backgrounds.size(); ++i) {
    const Background& background = scaling.backgrounds[i];
    std::ranges::copy(background.response, response.data_ptr<float>() + i * kElements);
    std::ranges::copy(background.deviation, deviation.data_ptr<float>() + i * kElements);
    names.push_back(background.name);
  }
  weights.parameters.set("norm.background_response", response);
  weights.parameters.set("norm.background_deviation", deviation);
  weights.metadata["backgrounds"] = names.dump();
}

CheckpointFolder::CheckpointFolder(fs::path folder) : folder_(std::move(folder)) {
  std::error_code error;
  fs::create_directories(folder_, error);
  if (error)
    throw SetupError(ExitStatus::cannot_create,
                     fmt::format("the folder {} of the run (run.out) cannot be made: {}", folder_.string(),
                                 error.message()));
}

void CheckpointFolder::claim() {
  const fs::path path = folder_ / "lock";
  FileDescriptor lock(::open(path.c_str(), O_RDWR | O_CREAT | O_CLOEXEC, 0666));
  if (!lock)
    throw SetupError(ExitStatus::cannot_create,
                     fmt::format("{} cannot be made, which keeps a second run out of the folder: {}",
                                 path.string(), std::strerror(errno)));
  if (::flock(lock.get(), LOCK_EX | LOCK_NB) == 0) {
    lock_ = std::move(lock);
    return;
  }
  if (errno == EWOULDBLOCK)
    throw SetupError(
        ExitStatus::try_again,
        fmt::format("another csipose-train is running in {} (run.out) and would lose its checkpoints "
                    "to this one; wait for it, stop it, or take another run.out",
                    folder_.string()));
  throw SetupError(ExitStatus::cannot_create, fmt::format("{} cannot be locked against a second run: {}",
                                                          path.string(), std::strerror(errno)));
}

void CheckpointFolder::write(std::uint64_t step, const Weights& weights, const Parameters& optimiser) const {
  const std::set<std::uint64_t> older = steps_in(folder_);
  write_file_atomically(optimiser_file(folder_, step), packed({{"step", std::to_string(step)}}, optimiser));
  write_weights(weights_file(folder_, step), weights);
  std::error_code ignored;  // what cannot be removed is in nobody's way
  for (const std::uint64_t old : older)
    if (old != step) {
      fs::remove(weights_file(folder_, old), ignored);
      fs::remove(optimiser_file(folder_, old), ignored);
    }
}

std::optional<Checkpoint> CheckpointFolder::newest() const {
  const std::set<std::uint64_t> steps = steps_in(folder_);
  if (steps.empty()) return std::nullopt;
  Checkpoint found;
  found.step = *steps.rbegin();
  found.weights = read_weights(weights_file(folder_, found.step));
  found.optimiser = parameters_of(SafetensorsFile::read(optimiser_file(folder_, found.step)));
  return found;
}

}  // namespace csipose::train
