// What a stranger writes to the pose socket: any bytes in any pieces, frames in between. Memory stays bounded, and what
// comes out is whole messages.
#include <cassert>
#include <cstdint>
#include <cstdlib>

#include "daemon/client_session.h"

using namespace csipose;

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  SteadyTime now{std::chrono::seconds(1)};
  SharedFramePool pool({"rx1", "rx2", "rx3"});
  ClientSession session({}, "{}\n", now);
  std::size_t out = 0;
  while (size > 0 && !session.finished()) {
    const std::size_t piece = std::min<std::size_t>(size, 1U + data[0] % 61);
    session.receive(ByteView(data, piece), now);
    PoseFrame frame;
    frame.seq = size;
    frame.people_count = data[0] % (kMaxPeople + 1);
    session.offer(pool.take(frame));
    if (data[0] % 3 != 0) {
      std::size_t offered = 0;
      for (const auto part : session.next_bytes()) offered += part.size();
      if (offered > 0) session.sent(std::min<std::size_t>(offered, 997), now);
      out += offered;
    }
    data += piece;
    size -= piece;
    now += std::chrono::milliseconds(10);
  }
  if (session.level() > Level::pose || out > (1U << 26)) std::abort();
  return 0;
}
