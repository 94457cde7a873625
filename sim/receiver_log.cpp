#include "sim/receiver_log.h"

#include "proto/frame_record.h"
#include "proto/intel5300.h"

namespace csipose::sim {

ReceiverBank::ReceiverBank(ImpairmentLevel level, const Band& band, std::uint64_t seed, std::uint32_t clip,
                           double rate_hz)
    : on_(impairments(level)),
      next_{seed, clip, 0},
      rate_hz_(rate_hz),
      session_(static_cast<std::uint16_t>(seed * 0x9E37 + clip)) {
  for (std::size_t r = 0; r < kReceivers; ++r)
    radios_.emplace_back(on_, band, draw_nic(on_, seed, clip, r), r, rate_hz);
}

void ReceiverBank::send(const Channel& channel, std::array<std::vector<std::uint8_t>, kReceivers>& logs) {
  const double sent_s = next_.number / rate_hz_ + access_delay_s(on_, next_);
  // Counters from 1: 0 is the word for "no counter known".
  const auto frame = encode_csip_record(
      {session_, std::uint64_t{next_.number} + 1, static_cast<std::uint64_t>(sent_s * 1e9)});
  for (std::size_t r = 0; r < kReceivers; ++r) {
    CsiRecord record;
    if (!radios_[r].receive(next_, sent_s, channel[r], record)) continue;
    logs[r].insert(logs[r].end(), frame.begin(), frame.end());
    append_bfee_record(record, logs[r]);
  }
  ++next_.number;
}

}  // namespace csipose::sim
