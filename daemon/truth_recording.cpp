#include "daemon/truth_recording.h"

namespace csipose {

std::unique_ptr<TruthRecording> TruthRecording::open(const std::string& path) {
  constexpr std::uint64_t kLookedAt = 1000;  // every packet of the simulator has one
  std::unique_ptr<TruthRecording> truth(new TruthRecording(path));
  return truth->read_on(kLookedAt) ? std::move(truth) : nullptr;
}

TruthRecording::TruthRecording(const std::string& path) : file_(path), reader_(file_.bytes(), path) {}

const Truth* TruthRecording::at(UtcTime time) {
  while (newest() == nullptr || newest()->sent < time)
    if (!read_on(UINT64_MAX)) break;
  return nearest(time, kept_spacing_s());
}

bool TruthRecording::read_on(std::uint64_t messages) {
  std::optional<Truth> truth = reader_.next(messages);
  if (truth) keep(std::move(*truth));
  return truth.has_value();
}

}  // namespace csipose
