#include "capture/netlink_source.h"

namespace csipose {

bool NetlinkSource::take(Packet& packet) {
  for (ByteView record = socket_.take(); !record.empty(); record = socket_.take()) {
    const Now now = now_on_both_clocks();
    const ByteView records = pairer_.add(record);
    if (records.empty()) continue;
    ++packets_;
    packet = {receiver_, now.steady, now.utc, records};
    return true;
  }
  return false;
}

SourceStats NetlinkSource::stats() const {
  SourceStats stats;
  stats.receivers[receiver_].packets = packets_;
  stats.receivers[receiver_].sessions = 1;
  const NetlinkSocket::Counts& counts = socket_.counts();
  for (std::size_t i = 0; i < kNetlinkFaults; ++i)
    if (counts.faults[i] > 0)
      stats.refusals.push_back({receiver_, name(static_cast<NetlinkFault>(i)), counts.faults[i]});
  if (counts.overflows > 0) stats.refusals.push_back({receiver_, "queue_overflow", counts.overflows});
  return stats;
}

}  // namespace csipose
