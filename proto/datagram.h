// proto/datagram.h - sealed UDP between a receiver's agent and the daemon: who may speak, and what was said
// once.
//
// Two state machines without sockets and without clocks: AgentSession on the receiver's host, ReceiverDoor in
// the daemon. Whoever owns a socket passes bytes and the time in, and sends what comes out. docs/datagram.md
// is the page for people; the bytes, all little-endian:
//
//   header   "CSU1"  u8 version  u8 kind  u16 agent  u64 session  u64 counter           24 bytes, in the clear
//   HELLO    header | nonce 24 | sealed{ AgentTime 24, zero 8 } | tag 16                96 bytes, agent to daemon
//   WELCOME  header | nonce 24 | sealed{ HELLO's nonce 24, u32 lifetime_s, zero 4 } | tag   96 bytes, daemon to agent
//   DATA     header | sealed{ AgentTime 24, records } | tag                             at most 1,400 bytes, agent to daemon
//   ACK      header | sealed{ u64 newest counter, u64 datagrams accepted } | tag        56 bytes, daemon to agent
//
// Sealed is XChaCha20-Poly1305 (libsodium) with the header as associated data. HELLO and WELCOME use their
// random nonces; DATA and ACK use agent | session | counter | zeros, which never repeats under a session's
// key. No answer is larger than its question, and nothing unauthenticated is answered at all.
//
// Not here: key files (keys.h), sockets (sealed_sender.h, capture/udp_source.h).
// C++17-clean: the receiver's agent is built on old machines.
#pragma once

#include <array>
#include <bitset>
#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include "proto/bytes.h"
#include "proto/time.h"

namespace csipose {

inline constexpr std::size_t kMaxDatagram = 1400;  // fits an Ethernet frame with room for tunnels
inline constexpr std::size_t kDatagramHeader = 24;
inline constexpr std::size_t kSealTag = 16;
inline constexpr std::size_t kSealNonce = 24;
inline constexpr std::size_t kAgentTimeBytes = 24;
inline constexpr std::size_t kHandshakeBytes = kDatagramHeader + kSealNonce + 32 + kSealTag;
inline constexpr std::size_t kMaxRecords = kMaxDatagram - kDatagramHeader - kAgentTimeBytes - kSealTag;
inline constexpr std::size_t kReplayWindow = 1024;  // counters; reordering within it is tolerated

/// What a key may speak for: a receiver's NIC, an agent that plays a recording, a simulator. Fixed when the key is made,
/// mixed into everything derived from it, never sent. Numbers are those of Source (proto/pose.h).
enum class KeyKind : std::uint8_t { live = 1, replay = 2, simulated = 3 };

using Secret = std::array<std::uint8_t, 32>;
using SealNonce = std::array<std::uint8_t, kSealNonce>;

struct AgentKey {
  std::string name;  ///< the receiver's id in the configuration: "rx1"
  KeyKind kind = KeyKind::live;
  Secret secret{};
};
/// The number that stands for this key in headers: two bytes derived from the secret, so nobody has to hand
/// it out.
std::uint16_t agent_number(const AgentKey& key);
/// Before the first use of libsodium. Throws SetupError when it cannot start.
void require_sodium();

/// Why a datagram was refused. A closed list: one counter per value, and no answer.
enum class DatagramFault : std::uint8_t {
  bad_size,  ///< shorter than its kind, or longer than kMaxDatagram
  bad_magic,
  bad_version,
  bad_kind,       ///< a kind that does not travel in this direction
  unknown_agent,  ///< no key with this number
  stale_session,  ///< a session that was replaced, or that a daemon before a restart had made
  expired,        ///< the session outlived its lifetime
  forged,         ///< the seal does not fit: wrong key, or changed on the way
  replayed,       ///< was here before
  too_old,        ///< more than kReplayWindow behind the newest: cannot be told from a replay
  over_rate,      ///< authentic, but more than a receiver may send
};
inline constexpr std::size_t kDatagramFaults = 11;
const char* name(DatagramFault fault);
using DatagramFaultCounts = std::array<std::uint64_t, kDatagramFaults>;

/// The agent's clocks when it sealed a datagram, and what it could not send.
struct AgentTime {
  std::uint64_t mono_ns = 0;  ///< CLOCK_MONOTONIC of the receiver's host
  std::int64_t utc_ns = 0;
  std::uint32_t clock_error_us = 0;  ///< bound on the error of utc_ns, from the kernel; 0 = unknown
  std::uint32_t omitted = 0;  ///< records since the agent's start that did not fit or were lost in its host
};

/// Remembers the last kReplayWindow counters of one session.
class ReplayWindow {
 public:
  /// nullopt: never seen, may be accepted. Does not change anything: only an authentic counter may.
  std::optional<DatagramFault> check(std::uint64_t counter) const;
  void accept(std::uint64_t counter);
  std::uint64_t highest() const { return highest_; }

 private:
  std::bitset<kReplayWindow> seen_;
  std::uint64_t highest_ = 0;
};

/// One direction's key of one session, and where and when the session began.
struct SessionKeys {
  std::uint64_t session = 0;
  SealNonce hello_nonce{}, welcome_nonce{};
  Secret up{}, down{};  ///< agent to daemon, daemon to agent
};

/// The daemon's side: every receiver's key, one session each.
class ReceiverDoor {
 public:
  struct Entry {
    std::uint8_t receiver = 0;  ///< Packet::receiver
    AgentKey key;
  };
  struct Limits {
    Nanoseconds lifetime = std::chrono::hours(1);  ///< of a session; the agent renews it in time
    std::uint32_t max_per_second = 3000;           ///< datagrams of one receiver
  };
  enum class Kind : std::uint8_t { refused, handshake, keep_alive, records };
  /// Views are valid until the next call.
  struct Answer {
    Kind kind = Kind::refused;
    DatagramFault fault = DatagramFault::bad_size;  ///< when refused
    std::uint8_t receiver = 0;                      ///< unless refused
    AgentTime time{};                               ///< keep_alive and records
    ByteView records;  ///< csitool framing, as the driver gave them; not yet checked
    ByteView reply;    ///< send this back to where the datagram came from; may be empty
  };
  struct Counts {
    DatagramFaultCounts refused{};
    std::uint64_t accepted = 0;  ///< datagrams with records
    std::uint64_t keep_alives = 0;
    std::uint64_t sessions = 0;
    std::uint64_t lost = 0;     ///< counters of all sessions that never came (those still under way included)
    AgentTime last{};           ///< newest time from the agent
    std::uint64_t omitted = 0;  ///< records that the agent says it could not send, all its runs together
  };

  /// Throws SetupError when two keys have the same number, or none is given.
  ReceiverDoor(std::vector<Entry> entries, const Limits& limits);

  /// Opens one datagram. Nothing from outside throws; nothing is allocated.
  ///   cost: 2 us for 400 bytes
  Answer receive(ByteView datagram, SteadyTime now);

  /// By place in `entries`.
  Counts counts(std::size_t entry) const;
  /// Refused before a receiver could be named.
  const DatagramFaultCounts& unattributed() const { return unattributed_; }

 private:
  struct Pending {
    SessionKeys keys;
    SteadyTime made{};
    bool used = false;
  };
  struct Active {
    SessionKeys keys;
    SteadyTime since{}, last_ack{};
    ReplayWindow window;
    std::uint64_t accepted = 0, acks = 0;
  };
  struct Receiver {
    Entry entry;
    std::uint16_t number = 0;
    Secret hello_key{}, welcome_key{};
    std::optional<Active> active;
    std::array<Pending, 8> pending{};  // as many HELLOs may wait for their first data; the oldest gives way
    double tokens = 0;                 // leaky bucket of max_per_second
    SteadyTime tokens_at{};
    Counts counts;
    std::uint64_t lost_before = 0;  // of sessions that are over
  };

  static Answer refuse(DatagramFault fault, DatagramFaultCounts& counts);
  Answer hello(Receiver& receiver, ByteView datagram, SteadyTime now);
  Answer data(Receiver& receiver, ByteView datagram, SteadyTime now);
  Answer accept(Receiver& receiver, ByteView plain, std::uint64_t counter, SteadyTime now);
  ByteView welcome(const Receiver& receiver, const SessionKeys& keys);
  ByteView ack(Receiver& receiver, SteadyTime now);
  bool within_rate(Receiver& receiver, SteadyTime now) const;

  Limits limits_;
  std::vector<Receiver> receivers_;
  DatagramFaultCounts unattributed_{};
  std::array<std::uint8_t, kMaxDatagram> plain_{};
  std::array<std::uint8_t, kHandshakeBytes> reply_{};
};

/// The agent's side: says HELLO until it is welcome, and again when the daemon has gone quiet.
///
/// The daemon acknowledges four times a second as long as anything comes; an agent with nothing to send sends
/// empty DATA as often. One second without an acknowledgement, and the agent says HELLO again, every 250 ms,
/// while it goes on sending under the old session: so neither a restarted daemon nor a lost acknowledgement
/// costs more than that.
class AgentSession {
 public:
  struct Counts {
    DatagramFaultCounts refused{};
    std::uint64_t sealed = 0;      ///< datagrams with records handed out for sending
    std::uint64_t no_session = 0;  ///< records that came before the daemon had answered
    std::uint64_t hellos = 0, sessions = 0;
    std::uint64_t acknowledged = 0;  ///< of this session, as the daemon said last
  };

  explicit AgentSession(AgentKey key);

  /// A HELLO or a keep-alive when one is due, else empty. Call at least ten times a second.
  ByteView due(SteadyTime now, const AgentTime& time);
  /// One datagram from the daemon.
  std::optional<DatagramFault> receive(ByteView datagram, SteadyTime now);
  /// The datagram that carries these records, or empty when there is no session yet.
  ///   requires records.size() <= kMaxRecords
  ByteView seal(ByteView records, SteadyTime now, const AgentTime& time);

  /// Welcome, and heard of within the last second.
  bool connected(SteadyTime now) const;
  std::uint64_t session() const { return keys_ ? keys_->session : 0; }
  const Counts& counts() const { return counts_; }

 private:
  bool wants_hello(SteadyTime now) const;
  ByteView hello(SteadyTime now, const AgentTime& time);
  ByteView seal_data(ByteView records, SteadyTime now, const AgentTime& time);
  std::optional<DatagramFault> welcomed(ByteView datagram, SteadyTime now);
  std::optional<DatagramFault> acknowledged(ByteView datagram, SteadyTime now);

  AgentKey key_;
  std::uint16_t number_;
  Secret hello_key_, welcome_key_;
  std::optional<SessionKeys> keys_;
  Nanoseconds lifetime_{};
  SteadyTime since_{}, last_heard_{}, last_sent_{};
  std::uint64_t counter_ = 0, last_ack_ = 0;
  std::optional<SealNonce> hello_nonce_;  // of the HELLO that waits for its WELCOME
  SteadyTime nonce_made_{}, hello_sent_{-std::chrono::hours(1)};
  std::array<std::uint8_t, kHandshakeBytes> hello_{};
  std::array<std::uint8_t, kMaxDatagram> out_{};
  Counts counts_;
};

}  // namespace csipose
