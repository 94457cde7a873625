#include "sim/receiver_log.h"

#include <gtest/gtest.h>

#include "proto/frame_record.h"
#include "proto/intel5300.h"
#include "proto/record_stream.h"
#include "sim/reflector.h"

namespace csipose::sim {
namespace {

using Logs = std::array<std::vector<std::uint8_t>, kReceivers>;

Logs simulate(ImpairmentLevel level, std::uint32_t packets) {
  const Band band;
  const ReflectorScene scene = default_reflector_scene(band);
  ReceiverBank bank(impairments(level), band, /*seed=*/5, /*clip=*/0, /*rate_hz=*/300);
  Logs logs;
  for (std::uint32_t p = 0; p < packets; ++p) bank.send(reflector_channel(scene, band, p / 300.0), logs);
  return logs;
}

/// Transmit counters of a log's frames, each followed by its CSI.
std::vector<std::uint64_t> counters(const std::vector<std::uint8_t>& log) {
  RecordStream stream(log, RecordStream::Policy::strict);
  std::vector<std::uint64_t> found;
  while (const auto frame = stream.next()) {
    EXPECT_EQ(frame->code, kFrameCode);
    EXPECT_EQ(std::string(reinterpret_cast<const char*>(frame->body.data()) + kDataHeaderBytes, 4), "CSIP");
    found.push_back(load_le<std::uint64_t>(frame->body.data() + kDataHeaderBytes + 8));
    const auto csi = stream.next();
    CsiRecord record;
    EXPECT_TRUE(csi && csi->code == kCsiCode && !decode_bfee(csi->body, record));
    EXPECT_TRUE(record.usable());
  }
  EXPECT_FALSE(stream.broken());
  return found;
}

TEST(ReceiverBank, WithoutImpairmentsEveryReceiverHearsEveryPacket) {
  const Logs logs = simulate(ImpairmentLevel::none, 50);
  for (const auto& log : logs) {
    const auto found = counters(log);
    ASSERT_EQ(found.size(), 50u);
    for (std::size_t i = 0; i < found.size(); ++i) EXPECT_EQ(found[i], i + 1);
  }
}

TEST(ReceiverBank, LossesAreGapsOfTheCounterEachReceiversOwn) {
  const Logs logs = simulate(ImpairmentLevel::intel5300, 3000);
  std::array<std::vector<std::uint64_t>, kReceivers> found;
  for (std::size_t r = 0; r < kReceivers; ++r) {
    found[r] = counters(logs[r]);
    EXPECT_GT(found[r].size(), 2800u);
    EXPECT_LT(found[r].size(), 3000u);
  }
  EXPECT_NE(found[0], found[1]);
  EXPECT_NE(found[1], found[2]);
}

TEST(ReceiverBank, SameSeedSameBytes) {
  EXPECT_EQ(simulate(ImpairmentLevel::intel5300, 100), simulate(ImpairmentLevel::intel5300, 100));
}

}  // namespace
}  // namespace csipose::sim
