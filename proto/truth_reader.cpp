#include "proto/truth_reader.h"

#include <fmt/format.h>

namespace csipose {

std::optional<Truth> TruthReader::next(std::uint64_t messages) {
  for (std::uint64_t i = 0; i < messages; ++i) {
    const auto message = reader_.next();
    if (!message) break;
    const auto channel = reader_.channels().find(message->channel);
    if (channel == reader_.channels().end() || channel->second.topic != "/truth") continue;
    auto said = parse_truth({reinterpret_cast<const char*>(message->data.data()), message->data.size()});
    if (!said)
      throw SetupError(ExitStatus::bad_data,
                       fmt::format("{}: its truth is damaged: {}", name_, said.error()));
    if (auto* truth = std::get_if<Truth>(&*said)) return std::move(*truth);
  }
  return std::nullopt;
}

}  // namespace csipose
