// capture/netlink_source.h - the NIC of this host as one receiver.
#pragma once

#include "capture/frame_pairer.h"
#include "capture/live_source.h"
#include "capture/netlink.h"

namespace csipose {

class NetlinkSource final : public LiveSource {
 public:
  /// Throws SetupError when the driver is not there or may not be listened to: see netlink.h.
  explicit NetlinkSource(std::uint8_t receiver) : NetlinkSource(receiver, csi_connector_of_this_host()) {}
  NetlinkSource(std::uint8_t receiver, ConnectorId id) : receiver_(receiver), socket_(id) {}

  int descriptor() const override { return socket_.descriptor(); }
  bool take(Packet& packet) override;
  Source kind() const override { return Source::live; }
  std::string describe() const override { return "netlink"; }
  SourceStats stats() const override;

 private:
  std::uint8_t receiver_;
  NetlinkSocket socket_;
  FramePairer pairer_;
  std::uint64_t packets_ = 0;
};

}  // namespace csipose
