#include "proto/datagram.h"

#include <sodium.h>

#include <algorithm>
#include <cassert>
#include <cstring>
#include <utility>

#include "proto/result.h"

namespace csipose {
namespace {

constexpr std::array<std::uint8_t, 4> kMagic = {'C', 'S', 'U', '1'};
constexpr std::uint8_t kVersion = 1;
enum Kind : std::uint8_t { kHello = 1, kWelcome = 2, kData = 3, kAck = 4 };

constexpr auto kPendingLife = std::chrono::seconds(10);      // from WELCOME to the first good data
constexpr auto kHeartbeat = std::chrono::milliseconds(250);  // HELLO, keep-alive and ACK
constexpr auto kLostAfter = std::chrono::seconds(1);         // without ACK: four heartbeats
constexpr auto kNonceLife = std::chrono::seconds(2);         // one HELLO nonce: longer than any round trip
constexpr std::size_t kAckPlain = 16, kHandshakePlain = 32;

struct Header {
  Kind kind;
  std::uint16_t agent;
  std::uint64_t session, counter;
};

void put_header(std::uint8_t* out, const Header& h) {
  std::copy(kMagic.begin(), kMagic.end(), out);
  out[4] = kVersion;
  out[5] = h.kind;
  store_le<std::uint16_t>(out + 6, h.agent);
  store_le<std::uint64_t>(out + 8, h.session);
  store_le<std::uint64_t>(out + 16, h.counter);
}

Result<Header, DatagramFault> get_header(ByteView d) {
  if (d.size() < kDatagramHeader || d.size() > kMaxDatagram) return DatagramFault::bad_size;
  if (!std::equal(kMagic.begin(), kMagic.end(), d.data())) return DatagramFault::bad_magic;
  if (d[4] != kVersion) return DatagramFault::bad_version;
  return Header{static_cast<Kind>(d[5]), load_le<std::uint16_t>(d.data() + 6),
                load_le<std::uint64_t>(d.data() + 8), load_le<std::uint64_t>(d.data() + 16)};
}

void put_time(std::uint8_t* out, const AgentTime& t) {
  store_le<std::uint64_t>(out, t.mono_ns);
  store_le<std::int64_t>(out + 8, t.utc_ns);
  store_le<std::uint32_t>(out + 16, t.clock_error_us);
  store_le<std::uint32_t>(out + 20, t.omitted);
}
AgentTime get_time(const std::uint8_t* p) {
  return {load_le<std::uint64_t>(p), load_le<std::int64_t>(p + 8), load_le<std::uint32_t>(p + 16),
          load_le<std::uint32_t>(p + 20)};
}

// BLAKE2b keyed with the agent's secret over: purpose, kind of key, context. Different purposes give
// unrelated keys.
Secret derive(const AgentKey& key, const char* purpose, const SessionKeys* context = nullptr) {
  crypto_generichash_state state;
  Secret out;
  crypto_generichash_init(&state, key.secret.data(), key.secret.size(), out.size());
  crypto_generichash_update(&state, reinterpret_cast<const unsigned char*>(purpose),
                            std::strlen(purpose) + 1);
  const auto kind = static_cast<std::uint8_t>(key.kind);
  crypto_generichash_update(&state, &kind, 1);
  if (context != nullptr) {
    std::uint8_t session[8];
    store_le<std::uint64_t>(session, context->session);
    crypto_generichash_update(&state, session, sizeof session);
    crypto_generichash_update(&state, context->hello_nonce.data(), kSealNonce);
    crypto_generichash_update(&state, context->welcome_nonce.data(), kSealNonce);
  }
  crypto_generichash_final(&state, out.data(), out.size());
  return out;
}

void derive_session(const AgentKey& key, SessionKeys& keys) {
  keys.up = derive(key, "csipose agent to daemon", &keys);
  keys.down = derive(key, "csipose daemon to agent", &keys);
}

SealNonce counter_nonce(const Header& h) {
  SealNonce nonce{};
  store_le<std::uint16_t>(nonce.data(), h.agent);
  store_le<std::uint64_t>(nonce.data() + 2, h.session);
  store_le<std::uint64_t>(nonce.data() + 10, h.counter);
  return nonce;
}

// Seals plain[0, size) to `out`, which may be the same memory; the header lies before, at `header`.
void seal_to(std::uint8_t* out, const std::uint8_t* plain, std::size_t size, const std::uint8_t* header,
             const SealNonce& nonce, const Secret& key) {
  crypto_aead_xchacha20poly1305_ietf_encrypt(out, nullptr, plain, size, header, kDatagramHeader, nullptr,
                                             nonce.data(), key.data());
}
bool open_to(std::uint8_t* out, ByteView sealed, const std::uint8_t* header, const SealNonce& nonce,
             const Secret& key) {
  return crypto_aead_xchacha20poly1305_ietf_decrypt(out, nullptr, nullptr, sealed.data(), sealed.size(),
                                                    header, kDatagramHeader, nonce.data(), key.data()) == 0;
}

// HELLO and WELCOME: header, nonce, sealed 32 bytes.
void put_handshake(std::uint8_t* out, const Header& h, const SealNonce& nonce,
                   const std::array<std::uint8_t, kHandshakePlain>& plain, const Secret& key) {
  put_header(out, h);
  std::copy(nonce.begin(), nonce.end(), out + kDatagramHeader);
  seal_to(out + kDatagramHeader + kSealNonce, plain.data(), plain.size(), out, nonce, key);
}
std::optional<DatagramFault> get_handshake(ByteView d, const Secret& key, SealNonce& nonce,
                                           std::array<std::uint8_t, kHandshakePlain>& plain) {
  if (d.size() != kHandshakeBytes) return DatagramFault::bad_size;
  std::copy_n(d.data() + kDatagramHeader, kSealNonce, nonce.begin());
  if (!open_to(plain.data(), d.sub(kDatagramHeader + kSealNonce), d.data(), nonce, key))
    return DatagramFault::forged;
  return std::nullopt;
}

template <class Array>
void randomise(Array& bytes) {
  randombytes_buf(bytes.data(), bytes.size());
}

}  // namespace

void require_sodium() {
  if (sodium_init() < 0)
    throw SetupError(ExitStatus::os_refusal, "libsodium cannot start: the system gives it no random numbers");
}

std::uint16_t agent_number(const AgentKey& key) {
  return load_le<std::uint16_t>(derive(key, "csipose agent number").data());
}

const char* name(DatagramFault fault) {
  static constexpr std::array<const char*, kDatagramFaults> kNames = {
      "bad_size", "bad_magic", "bad_version", "bad_kind", "unknown_agent", "stale_session",
      "expired",  "forged",    "replayed",    "too_old",  "over_rate"};
  return kNames[static_cast<std::size_t>(fault)];
}

std::optional<DatagramFault> ReplayWindow::check(std::uint64_t counter) const {
  if (counter > highest_) return std::nullopt;
  if (highest_ - counter >= kReplayWindow) return DatagramFault::too_old;
  if (counter == 0 || seen_[counter % kReplayWindow]) return DatagramFault::replayed;
  return std::nullopt;
}

void ReplayWindow::accept(std::uint64_t counter) {
  if (counter > highest_) {
    const std::uint64_t steps = std::min<std::uint64_t>(counter - highest_, kReplayWindow);
    for (std::uint64_t i = 0; i < steps; ++i) seen_.reset((counter - i) % kReplayWindow);
    highest_ = counter;
  }
  seen_.set(counter % kReplayWindow);
}

// ---- the daemon's side

ReceiverDoor::ReceiverDoor(std::vector<Entry> entries, const Limits& limits) : limits_(limits) {
  require_sodium();
  if (entries.empty())
    throw SetupError(
        ExitStatus::bad_config,
        "no receiver has a key, so no datagram could ever be accepted; make one with `csipose agent add`");
  for (Entry& entry : entries) {
    Receiver receiver;
    receiver.number = agent_number(entry.key);
    for (const Receiver& other : receivers_)
      if (other.number == receiver.number)
        throw SetupError(
            ExitStatus::bad_config,
            "the keys of " + other.entry.key.name + " and " + entry.key.name +
                " have the same number (or are the same key); make a new one with `csipose agent add`");
    receiver.hello_key = derive(entry.key, "csipose hello");
    receiver.welcome_key = derive(entry.key, "csipose welcome");
    receiver.tokens = limits.max_per_second;
    receiver.entry = std::move(entry);
    receivers_.push_back(std::move(receiver));
  }
}

ReceiverDoor::Answer ReceiverDoor::refuse(DatagramFault fault, DatagramFaultCounts& counts) {
  ++counts[static_cast<std::size_t>(fault)];
  Answer answer;
  answer.fault = fault;
  return answer;
}

ReceiverDoor::Answer ReceiverDoor::receive(ByteView datagram, SteadyTime now) {
  const auto header = get_header(datagram);
  if (!header) return refuse(header.error(), unattributed_);
  const auto receiver = std::find_if(receivers_.begin(), receivers_.end(),
                                     [&](const Receiver& r) { return r.number == header->agent; });
  if (receiver == receivers_.end()) return refuse(DatagramFault::unknown_agent, unattributed_);
  if (header->kind == kHello) return hello(*receiver, datagram, now);
  if (header->kind == kData) return data(*receiver, datagram, now);
  return refuse(DatagramFault::bad_kind, receiver->counts.refused);
}

ReceiverDoor::Answer ReceiverDoor::hello(Receiver& receiver, ByteView datagram, SteadyTime now) {
  SessionKeys keys;
  std::array<std::uint8_t, kHandshakePlain> plain;
  if (const auto fault = get_handshake(datagram, receiver.hello_key, keys.hello_nonce, plain))
    return refuse(*fault, receiver.counts.refused);
  if (receiver.active && receiver.active->keys.hello_nonce == keys.hello_nonce)
    return refuse(DatagramFault::replayed, receiver.counts.refused);

  // The same HELLO again (its WELCOME was lost) gets the same session; a new one takes the oldest place.
  auto place = std::find_if(receiver.pending.begin(), receiver.pending.end(), [&](const Pending& p) {
    return p.used && p.keys.hello_nonce == keys.hello_nonce && now - p.made < kPendingLife;
  });
  if (place == receiver.pending.end()) {
    place = std::min_element(
        receiver.pending.begin(), receiver.pending.end(),
        [](const Pending& a, const Pending& b) { return a.used != b.used ? !a.used : a.made < b.made; });
    randomise(keys.welcome_nonce);
    randombytes_buf(&keys.session, sizeof keys.session);
    derive_session(receiver.entry.key, keys);
    *place = {keys, now, true};
  }
  Answer answer;
  answer.kind = Kind::handshake;
  answer.receiver = receiver.entry.receiver;
  answer.reply = welcome(receiver, place->keys);
  return answer;
}

ByteView ReceiverDoor::welcome(const Receiver& receiver, const SessionKeys& keys) {
  std::array<std::uint8_t, kHandshakePlain> plain{};
  std::copy(keys.hello_nonce.begin(), keys.hello_nonce.end(), plain.begin());
  const auto lifetime = std::chrono::duration_cast<std::chrono::seconds>(limits_.lifetime);
  store_le<std::uint32_t>(plain.data() + kSealNonce, static_cast<std::uint32_t>(lifetime.count()));
  put_handshake(reply_.data(), {kWelcome, receiver.number, keys.session, 0}, keys.welcome_nonce, plain,
                receiver.welcome_key);
  return {reply_.data(), kHandshakeBytes};
}

ReceiverDoor::Answer ReceiverDoor::data(Receiver& receiver, ByteView datagram, SteadyTime now) {
  auto& refused = receiver.counts.refused;
  if (datagram.size() < kDatagramHeader + kAgentTimeBytes + kSealTag)
    return refuse(DatagramFault::bad_size, refused);
  const Header header = *get_header(datagram);
  const bool is_active = receiver.active && receiver.active->keys.session == header.session;
  const auto pending = std::find_if(receiver.pending.begin(), receiver.pending.end(), [&](const Pending& p) {
    return p.used && p.keys.session == header.session && now - p.made < kPendingLife;
  });
  if (!is_active && pending == receiver.pending.end()) return refuse(DatagramFault::stale_session, refused);
  if (is_active && now - receiver.active->since >= limits_.lifetime)
    return refuse(DatagramFault::expired, refused);

  const SessionKeys& keys = is_active ? receiver.active->keys : pending->keys;
  if (!open_to(plain_.data(), datagram.sub(kDatagramHeader), datagram.data(), counter_nonce(header), keys.up))
    return refuse(DatagramFault::forged, refused);
  if (!is_active) {  // the first good data: only now does the new session replace the old one
    receiver.lost_before = counts(static_cast<std::size_t>(&receiver - receivers_.data())).lost;
    receiver.active = Active{keys, now, now - kHeartbeat, {}, 0, 0};
    receiver.pending.fill({});
    ++receiver.counts.sessions;
  }
  if (const auto fault = receiver.active->window.check(header.counter)) return refuse(*fault, refused);
  receiver.active->window.accept(header.counter);
  ++receiver.active->accepted;
  if (!within_rate(receiver, now)) return refuse(DatagramFault::over_rate, refused);
  return accept(receiver, {plain_.data(), datagram.size() - kDatagramHeader - kSealTag}, header.counter, now);
}

ReceiverDoor::Answer ReceiverDoor::accept(Receiver& receiver, ByteView plain, std::uint64_t counter,
                                          SteadyTime now) {
  Answer answer;
  answer.receiver = receiver.entry.receiver;
  answer.time = get_time(plain.data());
  answer.records = plain.sub(kAgentTimeBytes);
  answer.kind = answer.records.empty() ? Kind::keep_alive : Kind::records;
  ++(answer.records.empty() ? receiver.counts.keep_alives : receiver.counts.accepted);
  if (counter == receiver.active->window.highest()) {
    // A smaller number than before: the agent itself has started anew.
    const std::uint32_t before = receiver.counts.last.omitted;
    receiver.counts.omitted +=
        answer.time.omitted >= before ? answer.time.omitted - before : answer.time.omitted;
    receiver.counts.last = answer.time;
  }
  if (now - receiver.active->last_ack >= kHeartbeat) answer.reply = ack(receiver, now);
  return answer;
}

ByteView ReceiverDoor::ack(Receiver& receiver, SteadyTime now) {
  Active& active = *receiver.active;
  active.last_ack = now;
  const Header header = {kAck, receiver.number, active.keys.session, ++active.acks};
  std::array<std::uint8_t, kAckPlain> plain;
  store_le<std::uint64_t>(plain.data(), active.window.highest());
  store_le<std::uint64_t>(plain.data() + 8, active.accepted);
  put_header(reply_.data(), header);
  seal_to(reply_.data() + kDatagramHeader, plain.data(), plain.size(), reply_.data(), counter_nonce(header),
          active.keys.down);
  return {reply_.data(), kDatagramHeader + kAckPlain + kSealTag};
}

bool ReceiverDoor::within_rate(Receiver& receiver, SteadyTime now) const {
  const double limit = limits_.max_per_second;
  receiver.tokens =
      std::min(limit, receiver.tokens + limit * std::max(0.0, seconds(now - receiver.tokens_at)));
  receiver.tokens_at = now;
  if (receiver.tokens < 1) return false;
  receiver.tokens -= 1;
  return true;
}

ReceiverDoor::Counts ReceiverDoor::counts(std::size_t entry) const {
  const Receiver& receiver = receivers_[entry];
  Counts counts = receiver.counts;
  counts.lost = receiver.lost_before;
  if (receiver.active) counts.lost += receiver.active->window.highest() - receiver.active->accepted;
  return counts;
}

// ---- the agent's side

AgentSession::AgentSession(AgentKey key) : key_(std::move(key)) {
  require_sodium();
  number_ = agent_number(key_);
  hello_key_ = derive(key_, "csipose hello");
  welcome_key_ = derive(key_, "csipose welcome");
}

bool AgentSession::connected(SteadyTime now) const { return keys_ && now - last_heard_ < kLostAfter; }

bool AgentSession::wants_hello(SteadyTime now) const {
  return !connected(now) || now - since_ > lifetime_ / 4 * 3;
}

ByteView AgentSession::due(SteadyTime now, const AgentTime& time) {
  if (wants_hello(now) && now - hello_sent_ >= kHeartbeat) return hello(now, time);
  if (keys_ && now - last_sent_ >= kHeartbeat) return seal_data({}, now, time);
  return {};
}

ByteView AgentSession::hello(SteadyTime now, const AgentTime& time) {
  // A nonce seals one message only, so a repeated HELLO is the same bytes and carries the time of the first.
  if (!hello_nonce_ || now - nonce_made_ >= kNonceLife) {
    randomise(hello_nonce_.emplace());
    nonce_made_ = now;
    std::array<std::uint8_t, kHandshakePlain> plain{};
    put_time(plain.data(), time);
    put_handshake(hello_.data(), {kHello, number_, 0, 0}, *hello_nonce_, plain, hello_key_);
  }
  hello_sent_ = now;
  ++counts_.hellos;
  return {hello_.data(), hello_.size()};
}

ByteView AgentSession::seal(ByteView records, SteadyTime now, const AgentTime& time) {
  assert(records.size() <= kMaxRecords);
  if (!keys_) {
    ++counts_.no_session;
    return {};
  }
  ++counts_.sealed;
  return seal_data(records, now, time);
}

ByteView AgentSession::seal_data(ByteView records, SteadyTime now, const AgentTime& time) {
  last_sent_ = now;
  const Header header = {kData, number_, keys_->session, ++counter_};
  std::uint8_t* const body = out_.data() + kDatagramHeader;
  put_header(out_.data(), header);
  put_time(body, time);
  std::copy(records.begin(), records.end(), body + kAgentTimeBytes);
  seal_to(body, body, kAgentTimeBytes + records.size(), out_.data(), counter_nonce(header), keys_->up);
  return {out_.data(), kDatagramHeader + kAgentTimeBytes + records.size() + kSealTag};
}

std::optional<DatagramFault> AgentSession::receive(ByteView datagram, SteadyTime now) {
  const auto header = get_header(datagram);
  std::optional<DatagramFault> fault;
  if (!header)
    fault = header.error();
  else if (header->agent != number_)
    fault = DatagramFault::unknown_agent;
  else if (header->kind == kWelcome)
    fault = welcomed(datagram, now);
  else if (header->kind == kAck)
    fault = acknowledged(datagram, now);
  else
    fault = DatagramFault::bad_kind;
  if (fault) ++counts_.refused[static_cast<std::size_t>(*fault)];
  return fault;
}

std::optional<DatagramFault> AgentSession::welcomed(ByteView datagram, SteadyTime now) {
  SessionKeys keys;
  std::array<std::uint8_t, kHandshakePlain> plain;
  if (const auto fault = get_handshake(datagram, welcome_key_, keys.welcome_nonce, plain)) return fault;
  if (!hello_nonce_ || !std::equal(hello_nonce_->begin(), hello_nonce_->end(), plain.begin()))
    return DatagramFault::stale_session;
  keys.session = get_header(datagram)->session;
  keys.hello_nonce = *hello_nonce_;
  derive_session(key_, keys);
  keys_ = keys;
  lifetime_ = std::chrono::seconds(load_le<std::uint32_t>(plain.data() + kSealNonce));
  since_ = last_heard_ = now;
  last_sent_ = now - kHeartbeat;  // say something at once: the daemon takes the session only then
  counter_ = last_ack_ = 0;
  hello_nonce_.reset();
  ++counts_.sessions;
  counts_.acknowledged = 0;
  return std::nullopt;
}

std::optional<DatagramFault> AgentSession::acknowledged(ByteView datagram, SteadyTime now) {
  if (datagram.size() != kDatagramHeader + kAckPlain + kSealTag) return DatagramFault::bad_size;
  const Header header = *get_header(datagram);
  if (!keys_ || header.session != keys_->session) return DatagramFault::stale_session;
  std::array<std::uint8_t, kAckPlain> plain;
  if (!open_to(plain.data(), datagram.sub(kDatagramHeader), datagram.data(), counter_nonce(header),
               keys_->down))
    return DatagramFault::forged;
  if (header.counter <= last_ack_) return DatagramFault::replayed;
  last_ack_ = header.counter;
  last_heard_ = now;
  counts_.acknowledged = load_le<std::uint64_t>(plain.data() + 8);
  return std::nullopt;
}

}  // namespace csipose
