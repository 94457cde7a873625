// Agent and door talk in memory here; the test is the network between them and may lose, repeat, reorder and
// forge.
#include "proto/datagram.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <random>
#include <string>
#include <vector>

#include "proto/result.h"

namespace csipose {
namespace {

using Bytes = std::vector<std::uint8_t>;
using namespace std::chrono_literals;
Bytes copy(ByteView view) { return {view.begin(), view.end()}; }

AgentKey make_key(const std::string& name, std::uint8_t fill, KeyKind kind = KeyKind::live) {
  AgentKey key{name, kind, {}};
  key.secret.fill(fill);
  return key;
}

constexpr AgentTime kTime = {1'000'000'007, 1'790'000'000'000'000'001, 250, 0};
const Bytes kRecords = {0, 3, 0xBB, 1, 2};

struct Wire {
  Wire() : Wire(ReceiverDoor::Limits{}) {}
  explicit Wire(const ReceiverDoor::Limits& limits) : door({{0, key}, {1, make_key("rx2", 9)}}, limits) {}

  // Lets the agent say HELLO, carries the answer back, and sends the first keep-alive.
  void connect() {
    const auto answer = door.receive(copy(agent.due(now, kTime)), now);
    ASSERT_EQ(answer.kind, ReceiverDoor::Kind::handshake);
    ASSERT_FALSE(agent.receive(copy(answer.reply), now));
    ASSERT_EQ(deliver(agent.due(now, kTime)).kind, ReceiverDoor::Kind::keep_alive);
  }
  ReceiverDoor::Answer deliver(ByteView datagram) { return door.receive(datagram, now); }
  Bytes sealed(const Bytes& records = kRecords) { return copy(agent.seal(records, now, kTime)); }
  DatagramFault refused(ByteView datagram) {
    const auto answer = deliver(datagram);
    EXPECT_EQ(answer.kind, ReceiverDoor::Kind::refused);
    EXPECT_TRUE(answer.reply.empty());
    return answer.fault;
  }
  // Time passes in steps of 50 ms; both sides hear each other.
  void run(Nanoseconds duration) {
    for (const SteadyTime end = now + duration; now < end; now += 50ms) {
      const Bytes said = copy(agent.due(now, kTime));
      if (said.empty()) continue;
      const Bytes reply = copy(deliver(said).reply);
      if (!reply.empty() && agent.receive(reply, now)) ADD_FAILURE() << "the agent refused an answer";
    }
  }

  AgentKey key = make_key("rx1", 7);
  SteadyTime now{10s};
  ReceiverDoor door;
  AgentSession agent{key};
};

TEST(Datagram, CarriesRecordsAndTimeUnchanged) {
  Wire wire;
  wire.connect();
  const auto answer = wire.deliver(wire.sealed());
  ASSERT_EQ(answer.kind, ReceiverDoor::Kind::records);
  EXPECT_EQ(copy(answer.records), kRecords);
  EXPECT_EQ(answer.receiver, 0);
  EXPECT_EQ(answer.time.mono_ns, kTime.mono_ns);
  EXPECT_EQ(answer.time.utc_ns, kTime.utc_ns);
  EXPECT_EQ(answer.time.clock_error_us, kTime.clock_error_us);
  EXPECT_EQ(wire.door.counts(0).accepted, 1u);
  EXPECT_EQ(wire.door.counts(0).lost, 0u);
}

TEST(Datagram, LargestRecordsFillADatagramExactly) {
  Wire wire;
  wire.connect();
  const Bytes records(kMaxRecords, 0x5A);
  const Bytes datagram = wire.sealed(records);
  EXPECT_EQ(datagram.size(), kMaxDatagram);
  EXPECT_EQ(copy(wire.deliver(datagram).records), records);
}

TEST(Datagram, NothingOfTheRecordsIsReadable) {
  Wire wire;
  wire.connect();
  const Bytes datagram = wire.sealed(Bytes(64, 0x5A));
  const Bytes clear(8, 0x5A);
  EXPECT_EQ(std::search(datagram.begin(), datagram.end(), clear.begin(), clear.end()), datagram.end());
}

TEST(Datagram, BeforeTheWelcomeThereIsNothingToSend) {
  Wire wire;
  EXPECT_TRUE(wire.agent.seal(kRecords, wire.now, kTime).empty());
  EXPECT_EQ(wire.agent.counts().no_session, 1u);
}

TEST(Datagram, AnyChangedBitIsRefused) {
  Wire wire;
  wire.connect();
  for (std::size_t bit = 0; bit < 8 * wire.sealed().size(); ++bit) {
    Bytes datagram = wire.sealed();
    datagram[bit / 8] ^= static_cast<std::uint8_t>(1u << (bit % 8));
    EXPECT_EQ(wire.deliver(datagram).kind, ReceiverDoor::Kind::refused) << "bit " << bit;
  }
  EXPECT_EQ(wire.door.counts(0).accepted, 0u);
}

TEST(Datagram, AnyTruncationIsRefused) {
  Wire wire;
  wire.connect();
  const Bytes whole = wire.sealed();
  for (std::size_t size = 0; size < whole.size(); ++size)
    EXPECT_EQ(wire.deliver(ByteView(whole).sub(0, size)).kind, ReceiverDoor::Kind::refused) << size;
  EXPECT_EQ(wire.deliver(whole).kind, ReceiverDoor::Kind::records);
}

TEST(Datagram, EachReasonHasItsName) {
  Wire wire;
  wire.connect();
  const auto changed = [&](std::size_t at) {
    Bytes datagram = wire.sealed();
    datagram[at] ^= 0x40;
    return datagram;
  };
  EXPECT_EQ(wire.refused(Bytes(23, 0)), DatagramFault::bad_size);
  EXPECT_EQ(wire.refused(Bytes(kMaxDatagram + 1, 0)), DatagramFault::bad_size);
  EXPECT_EQ(wire.refused(changed(0)), DatagramFault::bad_magic);
  EXPECT_EQ(wire.refused(changed(4)), DatagramFault::bad_version);
  EXPECT_EQ(wire.refused(changed(5)), DatagramFault::bad_kind);
  EXPECT_EQ(wire.refused(changed(6)), DatagramFault::unknown_agent);
  EXPECT_EQ(wire.refused(changed(8)), DatagramFault::stale_session);
  EXPECT_EQ(wire.refused(changed(16)), DatagramFault::forged);
  EXPECT_EQ(wire.refused(changed(30)), DatagramFault::forged);
  EXPECT_STREQ(name(DatagramFault::over_rate), "over_rate");
  EXPECT_EQ(wire.door.unattributed()[static_cast<std::size_t>(DatagramFault::bad_magic)], 1u);
  EXPECT_EQ(wire.door.counts(0).refused[static_cast<std::size_t>(DatagramFault::forged)], 2u);
}

TEST(Datagram, WrongKeyGetsNoAnswer) {
  Wire wire;
  AgentSession stranger(make_key("rx1", 8));
  EXPECT_EQ(wire.refused(copy(stranger.due(wire.now, kTime))), DatagramFault::unknown_agent);
  // Even one who knows the agent's number, which is in the clear:
  Bytes hello = copy(stranger.due(wire.now + 1s, kTime));
  store_le<std::uint16_t>(hello.data() + 6, agent_number(wire.key));
  EXPECT_EQ(wire.refused(hello), DatagramFault::forged);
}

TEST(Datagram, AKeyOfTheOtherKindIsAnotherKey) {
  Wire wire;
  AgentSession simulator(make_key("rx1", 7, KeyKind::simulated));
  EXPECT_EQ(wire.deliver(copy(simulator.due(wire.now, kTime))).kind, ReceiverDoor::Kind::refused);
}

TEST(Datagram, ReplayIsRefusedReorderingIsNot) {
  Wire wire;
  wire.connect();
  std::vector<Bytes> sent;
  for (int i = 0; i < 200; ++i) sent.push_back(wire.sealed());
  std::mt19937 random(1);
  std::shuffle(sent.begin(), sent.end(), random);
  for (const Bytes& datagram : sent) EXPECT_EQ(wire.deliver(datagram).kind, ReceiverDoor::Kind::records);
  for (const Bytes& datagram : sent) EXPECT_EQ(wire.refused(datagram), DatagramFault::replayed);
  EXPECT_EQ(wire.door.counts(0).accepted, 200u);
  EXPECT_EQ(wire.door.counts(0).lost, 0u);
}

TEST(Datagram, BehindTheWindowIsTooOld) {
  Wire wire;
  wire.connect();
  const Bytes outside = wire.sealed(), inside = wire.sealed();
  for (std::size_t i = 0; i + 2 < kReplayWindow; ++i) wire.sealed();
  EXPECT_EQ(wire.deliver(wire.sealed()).kind, ReceiverDoor::Kind::records);
  EXPECT_EQ(wire.refused(outside), DatagramFault::too_old);
  EXPECT_EQ(wire.deliver(inside).kind, ReceiverDoor::Kind::records);
}

TEST(Datagram, LossIsCountedExactly) {
  Wire wire;
  wire.connect();
  std::mt19937 random(2);
  std::uint64_t lost = 0;
  for (int i = 0; i < 5000; ++i, wire.now += 1ms) {
    const Bytes datagram = wire.sealed();
    const bool loses = i + 1 < 5000 && random() % 10 == 0;
    lost += loses;
    if (loses) continue;
    EXPECT_EQ(wire.deliver(datagram).kind, ReceiverDoor::Kind::records);
  }
  EXPECT_EQ(wire.door.counts(0).lost, lost);
  EXPECT_EQ(wire.door.counts(0).accepted, 5000 - lost);
}

TEST(Datagram, TheAgentFindsARestartedDaemonByItself) {
  Wire wire;
  wire.connect();
  wire.run(3s);
  EXPECT_TRUE(wire.agent.connected(wire.now));
  EXPECT_EQ(wire.agent.counts().hellos, 1u);

  wire.door = ReceiverDoor({{0, wire.key}}, {});  // forgot everything
  EXPECT_EQ(wire.refused(wire.sealed()), DatagramFault::stale_session);
  wire.run(1500ms);
  EXPECT_TRUE(wire.agent.connected(wire.now));
  EXPECT_EQ(wire.deliver(wire.sealed()).kind, ReceiverDoor::Kind::records);
  EXPECT_EQ(wire.agent.counts().sessions, 2u);
}

TEST(Datagram, ALostWelcomeIsSentAgain) {
  Wire wire;
  wire.deliver(copy(wire.agent.due(wire.now, kTime)));  // its answer is lost
  wire.now += 100ms;
  EXPECT_TRUE(wire.agent.due(wire.now, kTime).empty());
  wire.now += 150ms;
  wire.connect();
  EXPECT_EQ(wire.door.counts(0).sessions, 1u);
}

TEST(Datagram, ANewSessionReplacesTheOldOnlyWithItsFirstGoodData) {
  Wire wire;
  wire.connect();
  AgentSession again(wire.key);  // the agent's program was started anew
  const auto welcome = wire.deliver(copy(again.due(wire.now, kTime)));
  ASSERT_EQ(welcome.kind, ReceiverDoor::Kind::handshake);
  ASSERT_FALSE(again.receive(copy(welcome.reply), wire.now));
  EXPECT_EQ(wire.deliver(wire.sealed()).kind, ReceiverDoor::Kind::records) << "the old session still holds";

  Bytes forged = copy(again.seal(kRecords, wire.now, kTime));
  forged.back() ^= 1;
  EXPECT_EQ(wire.refused(forged), DatagramFault::forged);
  EXPECT_EQ(wire.deliver(wire.sealed()).kind, ReceiverDoor::Kind::records);

  EXPECT_EQ(wire.deliver(copy(again.seal(kRecords, wire.now, kTime))).kind, ReceiverDoor::Kind::records);
  EXPECT_EQ(wire.refused(wire.sealed()), DatagramFault::stale_session);
  EXPECT_EQ(wire.door.counts(0).sessions, 2u);
}

TEST(Datagram, AReplayedHelloTakesNothingOver) {
  Wire wire;
  const Bytes hello = copy(wire.agent.due(wire.now, kTime));
  ASSERT_FALSE(wire.agent.receive(copy(wire.deliver(hello).reply), wire.now));
  ASSERT_EQ(wire.deliver(wire.sealed()).kind, ReceiverDoor::Kind::records);
  EXPECT_EQ(wire.refused(hello), DatagramFault::replayed);
  EXPECT_EQ(wire.deliver(wire.sealed()).kind, ReceiverDoor::Kind::records);
}

TEST(Datagram, TheAgentRefusesWhatItDidNotAskFor) {
  Wire wire;
  const Bytes hello = copy(wire.agent.due(wire.now, kTime));
  const Bytes welcome = copy(wire.deliver(hello).reply);
  for (std::size_t bit = 0; bit < 8 * welcome.size(); ++bit) {
    Bytes changed = welcome;
    changed[bit / 8] ^= static_cast<std::uint8_t>(1u << (bit % 8));
    EXPECT_TRUE(wire.agent.receive(changed, wire.now)) << "bit " << bit;
  }
  EXPECT_FALSE(wire.agent.receive(welcome, wire.now));
  EXPECT_EQ(wire.agent.receive(welcome, wire.now), DatagramFault::stale_session) << "a WELCOME counts once";
  const Bytes ack = copy(wire.deliver(wire.sealed()).reply);
  ASSERT_FALSE(ack.empty());
  EXPECT_FALSE(wire.agent.receive(ack, wire.now));
  EXPECT_EQ(wire.agent.receive(ack, wire.now), DatagramFault::replayed);
  EXPECT_EQ(wire.agent.receive(wire.sealed(), wire.now), DatagramFault::bad_kind);
}

TEST(Datagram, NoAnswerIsLargerThanItsQuestion) {
  Wire wire;
  const Bytes hello = copy(wire.agent.due(wire.now, kTime));
  EXPECT_LE(wire.deliver(hello).reply.size(), hello.size());
  wire.agent.receive(copy(wire.deliver(hello).reply), wire.now);
  const Bytes keep_alive = copy(wire.agent.due(wire.now, kTime));
  const auto answer = wire.deliver(keep_alive);
  EXPECT_FALSE(answer.reply.empty());
  EXPECT_LE(answer.reply.size(), keep_alive.size());
}

TEST(Datagram, ASessionEndsAfterItsLifetimeAndTheAgentRenewsItBefore) {
  Wire wire(ReceiverDoor::Limits{4s, 3000});
  wire.connect();
  const Bytes early = wire.sealed();
  wire.run(20s);
  EXPECT_GE(wire.door.counts(0).sessions, 6u);
  EXPECT_EQ(wire.door.counts(0).refused, DatagramFaultCounts{}) << "renewed before any datagram was refused";

  const Bytes late = wire.sealed();
  wire.now += 5s;
  EXPECT_EQ(wire.refused(late), DatagramFault::expired);
}

TEST(Datagram, MoreThanTheRateIsRefused) {
  Wire wire(ReceiverDoor::Limits{1h, 100});
  wire.connect();
  int passed = 0;
  for (int i = 0; i < 1000; ++i) passed += wire.deliver(wire.sealed()).kind == ReceiverDoor::Kind::records;
  EXPECT_EQ(passed, 99);  // the keep-alive of connect() was the first of 100
  wire.now += 1s;
  EXPECT_EQ(wire.deliver(wire.sealed()).kind, ReceiverDoor::Kind::records);
}

TEST(Datagram, TimeThatStepsBackBreaksNothing) {
  Wire wire;
  wire.connect();
  wire.now -= 5s;
  EXPECT_EQ(wire.deliver(wire.sealed()).kind, ReceiverDoor::Kind::records);
  EXPECT_EQ(wire.deliver(wire.sealed()).kind, ReceiverDoor::Kind::records);
}

TEST(Datagram, OmittedRecordsAddUpOverRestartsOfTheAgent) {
  Wire wire;
  wire.connect();
  AgentTime time = kTime;
  for (const std::uint32_t omitted : {2u, 5u, 1u}) {
    time.omitted = omitted;
    wire.deliver(copy(wire.agent.seal(kRecords, wire.now, time)));
  }
  EXPECT_EQ(wire.door.counts(0).omitted, 6u);  // 5, then a new start with 1
}

TEST(Datagram, SetUpMistakesAreSaid) {
  EXPECT_THROW(ReceiverDoor({}, {}), SetupError);
  EXPECT_THROW(ReceiverDoor({{0, make_key("rx1", 7)}, {1, make_key("rx2", 7)}}, {}), SetupError);
}

// The plain way to say what a replay window is, as oracle of the fast one.
TEST(ReplayWindow, AgreesWithASetOfAllCounters) {
  std::mt19937_64 random(3);
  ReplayWindow window;
  std::vector<bool> seen(200'000);
  std::uint64_t highest = 0;
  for (int i = 0; i < 50'000; ++i) {
    const std::uint64_t ahead = highest + random() % 8, back = random() % 4 == 0 ? random() % 1500 : 0;
    const std::uint64_t counter = ahead > back ? ahead - back : 1;
    std::optional<DatagramFault> expected;
    if (counter + kReplayWindow <= highest)
      expected = DatagramFault::too_old;
    else if (seen[counter])
      expected = DatagramFault::replayed;
    ASSERT_EQ(window.check(counter), expected) << counter << " after " << highest;
    if (expected) continue;
    window.accept(counter);
    seen[counter] = true;
    highest = std::max(highest, counter);
  }
  EXPECT_GT(highest, 10'000u);
}

}  // namespace
}  // namespace csipose
