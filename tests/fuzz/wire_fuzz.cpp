// What a client might read from a daemon gone wrong, and a daemon from a client: parsed or refused with words, never more.
#include <cstdint>
#include <cstdlib>

#include "proto/wire.h"

using namespace csipose;

namespace {
/// A request that was understood means the same when it is said again.
void check_request(Format format, ByteView bytes) {
  const auto read = parse_client_message(format, bytes);
  if (!read) {
    if (read.error().code.empty() || read.error().remedy.empty()) std::abort();
    return;
  }
  const std::string again = encode(Format::protobuf, *read);
  const auto reread = parse_client_message(Format::protobuf, ByteView(again).sub(4));
  if (std::holds_alternative<Subscription>(*read)) {
    if (!reread || std::get<Subscription>(*reread).queue != std::get<Subscription>(*read).queue) std::abort();
  }
}

void check_answer(Format format, ByteView bytes) {
  const auto read = parse_server_message(format, bytes);
  if (!read) return;
  if (const auto* pose = std::get_if<ReceivedPose>(&*read)) {
    if (pose->people_described > kMaxPeople || pose->frame.people_count > kMaxPeople) std::abort();
    (void)name_of(pose->frame.state);
    (void)names_of(pose->frame.reasons);
  }
}
}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  const ByteView bytes(data, size);
  for (const Format format : {Format::json, Format::protobuf}) {
    check_request(format, bytes);
    check_answer(format, bytes);
  }
  return 0;
}
