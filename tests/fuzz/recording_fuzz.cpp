#include "proto/recording.h"
#include "proto/result.h"

using namespace csipose;

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) try {
  RecordingReader reader({data, size}, "fuzz");
  Packet packet;
  PoseItem pose;
  std::uint64_t sum = 0;
  for (auto item = reader.next(packet, pose); item != RecordingReader::Item::end;
       item = reader.next(packet, pose)) {
    if (item == RecordingReader::Item::packet && packet.receiver >= kReceivers) __builtin_trap();
    for (const std::uint8_t byte : item == RecordingReader::Item::packet ? packet.records : pose.frame)
      sum += byte;
  }
  return sum == UINT64_MAX;  // so that every byte is read
} catch (const SetupError&) {
  return 0;
}
