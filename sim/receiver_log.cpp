#include "sim/receiver_log.h"

#include "proto/frame_record.h"
#include "proto/intel5300.h"

namespace csipose::sim {

ReceiverBank::ReceiverBank(const Impairments& on, const Band& band, std::uint64_t seed, std::uint32_t clip,
                           double rate_hz)
    : on_(on),
      next_{seed, clip, 0},
      rate_hz_(rate_hz),
      session_(static_cast<std::uint16_t>(seed * 0x9E37 + clip)) {
  for (std::size_t r = 0; r < kReceivers; ++r)
    radios_.emplace_back(on_, band, draw_nic(on_, seed, clip, r), r, rate_hz);
}

ReceiverBank::Heard ReceiverBank::hear(const Channel& channel) {
  Heard heard;
  heard.sent_s = next_.number / rate_hz_ + access_delay_s(on_, next_);
  for (std::size_t r = 0; r < kReceivers; ++r) {
    CsiRecord record;
    if (radios_[r].receive(next_, heard.sent_s, channel[r], record)) heard.records[r] = record;
  }
  ++next_.number;
  return heard;
}

double ReceiverBank::send(const Channel& channel, std::array<std::vector<std::uint8_t>, kReceivers>& logs) {
  // Counters from 1: 0 is the word for "no counter known".
  const std::uint64_t counter = std::uint64_t{next_.number} + 1;
  const Heard heard = hear(channel);
  const auto frame = encode_csip_record({session_, counter, static_cast<std::uint64_t>(heard.sent_s * 1e9)});
  for (std::size_t r = 0; r < kReceivers; ++r) {
    if (!heard.records[r]) continue;
    logs[r].insert(logs[r].end(), frame.begin(), frame.end());
    append_bfee_record(*heard.records[r], logs[r]);
  }
  return heard.sent_s;
}

}  // namespace csipose::sim
