// Any bytes as packets: receiver, time and records are all the input's.
//
//   1 byte  settings: bit 0 by time, bit 1 scaled, bit 2 rate not told
//   then packets of   1 byte receiver, 4 bytes milliseconds since the last (signed), 2 bytes length, records
#include <algorithm>
#include <cmath>
#include <cstdlib>

#include "capture/front_end.h"

namespace {
void take_windows(csipose::FrontEnd& front_end) {
  static csipose::Window window;
  for (int i = 0; i < 3 && front_end.next(); ++i) {
    front_end.take(window);
    for (const float x : window.x)
      if (!std::isfinite(x)) std::abort();
  }
}
}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  using namespace csipose;
  if (size == 0) return 0;
  FrontEndConfig config;
  config.grid_hz = 30;  // a small ring
  config.tx_hz = (data[0] & 4) != 0 ? 0 : 30;
  config.align = (data[0] & 1) != 0 ? AlignMethod::time : AlignMethod::tx_counter;
  config.amplitude = (data[0] & 2) != 0 ? AmplitudeMethod::scaled : AmplitudeMethod::raw;
  FrontEnd front_end(config);
  ByteView left = ByteView(data, size).sub(1);
  std::int64_t time_ms = 1'000'000;
  while (left.size() >= 7) {
    time_ms =
        std::clamp<std::int64_t>(time_ms + load_le<std::int32_t>(left.data() + 1), -1000, 1'000'000'000'000);
    const SteadyTime arrival{std::chrono::milliseconds(time_ms)};
    const ByteView records = left.sub(7, load_le<std::uint16_t>(left.data() + 5));
    front_end.add({static_cast<std::uint8_t>(left[0] % kReceivers), arrival,
                   UtcTime{arrival.time_since_epoch()}, records});
    if (left[0] >= 128) take_windows(front_end);
    if (left[0] == 127) front_end.skip_before(arrival);
    left = left.sub(7 + records.size());
  }
  take_windows(front_end);
  front_end.finish();
  return 0;
}
