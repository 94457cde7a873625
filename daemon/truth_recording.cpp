#include "daemon/truth_recording.h"

#include <fmt/format.h>

namespace csipose {

std::unique_ptr<TruthRecording> TruthRecording::open(const std::string& path) {
  constexpr std::uint64_t kLookedAt = 1000;  // every packet of the simulator has one
  std::unique_ptr<TruthRecording> truth(new TruthRecording(path));
  if (!truth->reader_.is_mcap() || !truth->read_on(kLookedAt)) return nullptr;
  return truth;
}

TruthRecording::TruthRecording(const std::string& path) : path_(path), file_(path), reader_(file_.bytes()) {}

const Truth* TruthRecording::at(UtcTime time) {
  while (newest() == nullptr || newest()->sent < time)
    if (!read_on()) break;
  return nearest(time, kept_spacing_s());
}

bool TruthRecording::read_on(std::uint64_t messages) {
  for (std::uint64_t i = 0; i < messages; ++i) {
    const auto message = reader_.next();
    if (!message) return false;
    const auto channel = reader_.channels().find(message->channel);
    if (channel == reader_.channels().end() || channel->second.topic != "/truth") continue;
    auto said = parse_truth({reinterpret_cast<const char*>(message->data.data()), message->data.size()});
    if (!said)
      throw SetupError(ExitStatus::bad_data,
                       fmt::format("{} holds a truth that is damaged: {}.", path_, said.error()));
    Truth* const truth = std::get_if<Truth>(&*said);
    if (truth == nullptr) continue;
    keep(std::move(*truth));
    return true;
  }
  return false;
}

}  // namespace csipose
