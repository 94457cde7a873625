// The live feed's bytes against the data set's rows: two ways from one scene to the network's tensor.
#include <gtest/gtest.h>

#include "capture/features.h"
#include "capture/front_end.h"
#include "proto/datagram.h"
#include "proto/record_stream.h"
#include "sim/frame_maker.h"
#include "sim/human_scene.h"
#include "sim/packet_feed.h"
#include "sim/truth_server.h"

namespace csipose::sim {
namespace {

constexpr std::uint64_t kSeed = 3;
constexpr std::uint32_t kFrames = 3;
constexpr double kRateHz = 300;

std::unique_ptr<MovingScene> office_with(std::size_t people) {
  return std::make_unique<HumanScene>(HumanSpec{read_room_plan("office"), people, {Action::walk}, false},
                                      kSeed, 0, kRateHz);
}

std::unique_ptr<MovingScene> nobody_in_an_empty_room() {
  return std::make_unique<HumanScene>(HumanSpec{read_room_plan("empty"), 0, {Action::walk}, false}, kSeed, 0,
                                      kRateHz);
}

// ---- The way of the live feed: records, sealed, opened, through the front end ----

/// One receiver's agent and the daemon's door, without sockets.
class SealedWay {
 public:
  SealedWay() : session_(key_), door_({{0, key_}}, {}) {
    const auto hello = copy(session_.due(now_, {}));
    session_.receive(ByteView(copy(door_.receive(ByteView(hello), now_).reply)), now_);
  }
  std::vector<std::uint8_t> through(const std::vector<std::uint8_t>& records) {
    now_ += std::chrono::milliseconds(1);
    const auto datagram = copy(session_.seal(ByteView(records), now_, {}));
    EXPECT_FALSE(datagram.empty());
    return copy(door_.receive(ByteView(datagram), now_).records);
  }

 private:
  static std::vector<std::uint8_t> copy(ByteView bytes) { return {bytes.begin(), bytes.end()}; }
  AgentKey key_{"rx1", KeyKind::simulated, Secret{1, 2, 3}};
  SteadyTime now_{std::chrono::seconds(100)};
  AgentSession session_;
  ReceiverDoor door_;
};

std::vector<Window> windows_of_feed(ImpairmentLevel level) {
  PacketFeed feed(office_with(2), impairments(level), kSeed, 0, kRateHz);
  FrontEnd front_end({.grid_hz = kRateHz, .tx_hz = kRateHz, .hop = static_cast<int>(kSamples)});
  std::array<SealedWay, kReceivers> ways;
  SentPacket packet;
  for (std::uint32_t p = 0; p < kFrames * kSamples; ++p) {
    feed.next(packet);
    for (std::size_t r = 0; r < kReceivers; ++r) {
      if (packet.records[r].empty()) continue;
      const auto records = ways[r].through(packet.records[r]);
      const SteadyTime arrival{std::chrono::seconds(5) + from_seconds(packet.sent_s)};
      front_end.add(
          {static_cast<std::uint8_t>(r), arrival, UtcTime{arrival.time_since_epoch()}, ByteView(records)});
    }
  }
  std::vector<Window> windows(kFrames);
  for (Window& window : windows) front_end.take(window);
  return windows;
}

// ---- The way of a data set: rows of one clip, every sample by itself ----

struct Rows {
  explicit Rows(ImpairmentLevel level) {
    rows = make_clip(*office_with(2), {}, impairments(level), kSeed, 0, kFrames, kRateHz);
    const auto arrays = frame_arrays({});
    for (std::size_t i = 0; i < arrays.size(); ++i) {
      if (arrays[i].name == "csi") csi = rows[i].data();
      if (arrays[i].name == "received") received = rows[i].data();
    }
  }
  /// Sample `at` of the clip as receiver r reported it.
  CsiRecord record(std::size_t at, std::size_t r) const {
    CsiRecord out;
    out.nrx = 3, out.ntx = 1, out.perm_valid = true;
    const std::uint8_t* cell = csi + (at * kReceivers + r) * kSubcarriers * kAntennas * 2;
    for (std::size_t k = 0; k < kSubcarriers; ++k)
      for (std::size_t a = 0; a < kAntennas; ++a, cell += 2)
        for (std::size_t part = 0; part < 2; ++part)
          out.csi[CsiRecord::index(k, a, 0) + part] = static_cast<std::int8_t>(cell[part]);
    return out;
  }
  bool heard(std::size_t at, std::size_t r) const { return received[at * kReceivers + r] != 0; }

  ClipRows rows;
  const std::uint8_t *csi = nullptr, *received = nullptr;
};

/// The sample that stands for `at`: itself, or the nearest older one at most max_gap back.
std::optional<std::size_t> stand_in(const Rows& rows, std::size_t at, std::size_t r) {
  constexpr std::size_t kMaxGap = 2;
  for (std::size_t back = 0; back <= kMaxGap && back <= at; ++back)
    if (rows.heard(at - back, r)) return at - back;
  return std::nullopt;
}

/// Compares one receiver's part of a window; how many samples were compared.
std::size_t expect_same(const Window& window, const Rows& rows, std::size_t frame, std::size_t r) {
  std::size_t compared = 0;
  if (!window.links[kAntennas * r]) return 0;  // a gap too long: masked
  for (std::size_t t = 0; t < kSamples; ++t) {
    const auto at = stand_in(rows, frame * kSamples + t, r);
    EXPECT_TRUE(at.has_value());
    Features features;
    EXPECT_TRUE(extract_features(rows.record(at.value_or(0), r), {}, features));
    for (std::size_t c = 0; c < kChannels; ++c)
      for (std::size_t a = 0; a < kAntennas; ++a)
        EXPECT_EQ(window.x[Window::index(c, t, kAntennas * r + a)], features[c * kAntennas + a])
            << "frame " << frame << " sample " << t << " receiver " << r << " channel " << c;
    ++compared;
  }
  return compared;
}

void expect_the_same_tensors(ImpairmentLevel level, std::size_t least) {
  const auto windows = windows_of_feed(level);
  const Rows rows(level);
  std::size_t compared = 0;
  for (std::size_t frame = 0; frame < kFrames; ++frame)
    for (std::size_t r = 0; r < kReceivers; ++r) compared += expect_same(windows[frame], rows, frame, r);
  EXPECT_GE(compared, least);
}

TEST(LiveFeed, TheDaemonsTensorsAreTheDataSetsBitForBitAsTheCardReports) {
  expect_the_same_tensors(ImpairmentLevel::intel5300, kFrames * kSamples * kReceivers * 3 / 4);
}

TEST(LiveFeed, AndWithoutImpairments) {
  expect_the_same_tensors(ImpairmentLevel::none, kFrames * kSamples * kReceivers);
}

// ---- Ahead of time ----

TEST(ReadAhead, GivesThePacketsOfTheFeedInTheirOrder) {
  const auto feed = [] {
    return PacketFeed(nobody_in_an_empty_room(), impairments(ImpairmentLevel::intel5300), kSeed, 0, kRateHz);
  };
  ReadAhead ahead(feed(), 2 * kSamples);
  PacketFeed plain = feed();
  SentPacket expected;
  for (int p = 0; p < 70; ++p) {
    plain.next(expected);
    const SentPacket* packet = ahead.front();
    while (packet == nullptr) std::this_thread::yield(), packet = ahead.front();
    ASSERT_EQ(packet->counter, expected.counter);
    ASSERT_EQ(packet->records, expected.records);
    ASSERT_EQ(packet->sent_s, expected.sent_s);
    ahead.pop();
    ASSERT_LE(ahead.ready(), 2 * kSamples);
  }
}

/// A scene that breaks.
class Broken final : public MovingScene {
 public:
  const Scene& still() const override { return good_->still(); }
  std::size_t people() const override { return 0; }
  void next(Snapshot& out) override {
    if (++asked_ > 30) throw SetupError(ExitStatus::io, "no more");
    good_->next(out);
  }

 private:
  std::unique_ptr<MovingScene> good_ = nobody_in_an_empty_room();
  int asked_ = 0;
};

TEST(ReadAhead, ThrowsWhatTheFeedThrewAfterTheLastGoodPacket) {
  ReadAhead ahead(PacketFeed(std::make_unique<Broken>(), {}, 1, 0, kRateHz), 2 * kSamples);
  int good = 0;
  const auto read = [&] {
    for (;;)
      if (ahead.front() != nullptr)
        ++good, ahead.pop();
      else
        std::this_thread::yield();
  };
  EXPECT_THROW(read(), SetupError);
  EXPECT_EQ(good, static_cast<int>(kSamples));
}

}  // namespace
}  // namespace csipose::sim
