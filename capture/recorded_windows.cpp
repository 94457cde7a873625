#include "capture/recorded_windows.h"

#include <memory>

namespace csipose {

void for_each_packet(PacketSource& source, const std::function<void(const Packet&)>& use) {
  Packet packet;
  for (SourceEvent event = source.poll(Nanoseconds(0), packet); event != SourceEvent::closed;
       event = source.poll(Nanoseconds(0), packet))
    if (event == SourceEvent::packet) use(packet);
}

void for_each_window(PacketSource& source, FrontEnd& front_end, Nanoseconds jitter,
                     const std::function<void(const Window&)>& use) {
  const auto window = std::make_unique<Window>();
  const auto take = [&] {
    front_end.take(*window);
    use(*window);
  };
  for_each_packet(source, [&](const Packet& packet) {
    while (const auto due = front_end.next()) {
      if (packet.arrival <= due->last_sample + jitter) break;
      take();
    }
    front_end.add(packet);
  });
  while (const auto due = front_end.next()) {
    if (due->end_slot > front_end.newest_slot()) break;
    take();
  }
}

}  // namespace csipose
