#include "capture/tx_counter.h"

#include <algorithm>
#include <array>
#include <cstring>
#include <numeric>
#include <utility>
#include <vector>

#include "proto/frame_record.h"

namespace csipose {
namespace {

constexpr std::uint32_t kSeed = 0x1F3D5B79;
constexpr std::size_t kStateBytes = 4;  // any 4 bytes in a row, read big-endian, are the generator's state
constexpr std::size_t kLeastBody = 8, kVerifiedBytes = 8;
constexpr unsigned kFailuresBeforeAnew = 64;

/// Eight steps of the generator at once: one step shifts left and puts bit31^bit29^bit25^bit24 into bit 0,
/// and no bit that a step makes is read again within eight steps.
constexpr std::uint32_t next_byte(std::uint32_t state) {
  return state << 8 | ((state >> 24 ^ state >> 22 ^ state >> 18 ^ state >> 17) & 0xFF);
}

std::uint32_t state_at(const std::uint8_t* p) {
  return std::uint32_t{p[0]} << 24 | std::uint32_t{p[1]} << 16 | std::uint32_t{p[2]} << 8 | p[3];
}

/// One state in 64 is a landmark: the table holds landmarks only, and a search walks on to the next one.
constexpr bool is_landmark(std::uint32_t state) { return (state & 63) == 0; }

/// Whether the bytes behind the first four follow from them.
bool follows_generator(ByteView body) {
  const std::size_t end = std::min(body.size(), kStateBytes + kVerifiedBytes);
  std::uint32_t state = state_at(body.data());
  for (std::size_t i = kStateBytes; i < end; ++i) {
    state = next_byte(state);
    if ((state & 0xFF) != body[i]) return false;
  }
  return true;
}

/// x with a * x = 1 (mod m), for a and m without common divisor. Extended Euclid.
std::int64_t inverse_modulo(std::int64_t a, std::int64_t m) {
  std::int64_t r0 = m, r1 = a % m, x0 = 0, x1 = 1;
  while (r1 > 0) {
    const std::int64_t quotient = r0 / r1;
    r0 = std::exchange(r1, r0 - quotient * r1);
    x0 = std::exchange(x1, x0 - quotient * x1);
  }
  return x0 < 0 ? x0 + m : x0;
}

bool says_csip(ByteView body) {
  return body.size() >= kCsipBodyBytes && std::memcmp(body.data(), "CSIP", 4) == 0 &&
         body[4] == kCsipVersion && body[5] == 0;
}

std::optional<TxCounter> by_csip(const Mpdu& frame) {
  if (!says_csip(frame.body)) return std::nullopt;
  const std::uint8_t* p = frame.body.data();
  return TxCounter{.value = load_le<std::uint64_t>(p + 8),
                   .modulus = 0,
                   .session = load_le<std::uint16_t>(p + 6),
                   .transmit_ns = load_le<std::uint64_t>(p + 16)};
}

std::optional<TxCounter> by_sequence16(const Mpdu& frame) {
  return TxCounter{.value = frame.sequence_control, .modulus = 65536};
}

}  // namespace

const char* name(CounterMethod method) {
  switch (method) {
    case CounterMethod::automatic:
      return "automatic";
    case CounterMethod::csip:
      return "csip";
    case CounterMethod::sequence16:
      return "sequence16";
    case CounterMethod::lfsr:
      return "lfsr";
    case CounterMethod::sequence12:
      return "sequence12";
    case CounterMethod::none:
      break;
  }
  return "none";
}

/// Open addressing from a landmark's state to its distance from the start of the stream.
struct LfsrBodies::Table {
  struct Slot {
    std::uint32_t state = 0, position = 0;  // state 0 never occurs
  };
  static constexpr std::size_t kSlots = 1 << 16;  // twice the number of landmarks
  std::vector<Slot> slots = std::vector<Slot>(kSlots);
  std::uint32_t longest_walk = 0;

  Table() {
    std::uint32_t state = kSeed, walked = 0;
    for (std::size_t i = 0; i < kStateBytes; ++i) state = next_byte(state);
    // Beyond the stream's end until a landmark, so that a walk from its last states arrives too.
    for (std::uint32_t position = 0; position < kStreamBytes || walked > 0;
         ++position, state = next_byte(state)) {
      longest_walk = std::max(longest_walk, ++walked);
      if (!is_landmark(state)) continue;
      insert(state, position);
      walked = 0;
      if (position >= kStreamBytes) break;
    }
  }
  static std::size_t home(std::uint32_t state) { return (state * 2654435761u) >> 16; }  // Knuth's multiplier
  void insert(std::uint32_t state, std::uint32_t position) {
    std::size_t i = home(state);
    while (slots[i].state != 0) i = (i + 1) % kSlots;
    slots[i] = {state, position};
  }
  std::optional<std::uint32_t> find(std::uint32_t state) const {
    for (std::size_t i = home(state); slots[i].state != 0; i = (i + 1) % kSlots)
      if (slots[i].state == state) return slots[i].position;
    return std::nullopt;
  }
  /// Position of a state: of the next landmark, less the steps to it.
  std::optional<std::uint32_t> position_of(std::uint32_t state) const {
    for (std::uint32_t steps = 0; steps < longest_walk; ++steps, state = next_byte(state)) {
      if (!is_landmark(state)) continue;
      const std::optional<std::uint32_t> landmark = find(state);
      if (!landmark || *landmark < steps || *landmark - steps >= kStreamBytes) return std::nullopt;
      return *landmark - steps;
    }
    return std::nullopt;
  }
};

LfsrBodies::LfsrBodies() {
  static const std::shared_ptr<const Table> table = std::make_shared<Table>();
  table_ = table;
}
LfsrBodies::~LfsrBodies() = default;

std::optional<std::uint32_t> LfsrBodies::position(ByteView body) const {
  // A body that runs over the stream's end goes on at its start. Where that happens in the bytes looked at,
  // those behind the break tell as much.
  constexpr std::size_t kSecondLook = kStateBytes + kVerifiedBytes;
  for (const std::size_t at : {std::size_t{0}, kSecondLook}) {
    const ByteView rest = body.sub(at);
    if (rest.size() < kLeastBody) return std::nullopt;
    if (!follows_generator(rest)) continue;
    const std::optional<std::uint32_t> found = table_->position_of(state_at(rest.data()));
    if (found) return static_cast<std::uint32_t>((*found + kStreamBytes - at) % kStreamBytes);
  }
  return std::nullopt;
}

std::optional<std::uint32_t> LfsrBodies::frame_at(std::uint32_t position, std::size_t body_size) {
  const auto size = static_cast<std::int64_t>(body_size);
  const std::int64_t common = std::gcd(size, std::int64_t{kStreamBytes});
  if (size == 0 || position % common != 0) return std::nullopt;
  const std::int64_t frames = kStreamBytes / common;
  return static_cast<std::uint32_t>(position / common * inverse_modulo(size / common, frames) % frames);
}

std::uint32_t LfsrBodies::period(std::size_t body_size) {
  return static_cast<std::uint32_t>(kStreamBytes / std::gcd(body_size, std::size_t{kStreamBytes}));
}

void LfsrBodies::fill(std::uint64_t frame, std::uint8_t* body, std::size_t size) {
  std::size_t position = frame % kStreamBytes * size % kStreamBytes;
  std::uint32_t state = kSeed;
  for (std::size_t i = 0; i < position; ++i) state = next_byte(state);
  for (std::size_t i = 0; i < size; ++i, ++position) {
    if (position == kStreamBytes) position = 0, state = kSeed;
    state = next_byte(state);
    body[i] = static_cast<std::uint8_t>(state);
  }
}

CounterRecovery::CounterRecovery(CounterMethod method)
    : automatic_(method == CounterMethod::automatic), method_(method) {}

std::optional<TxCounter> CounterRecovery::recover(const Mpdu& frame) {
  if (method_ == CounterMethod::automatic) return settle(frame);
  const std::optional<TxCounter> counter = by_method(method_, frame);
  failures_ = counter ? 0 : failures_ + 1;
  if (automatic_ && failures_ == kFailuresBeforeAnew) {
    method_ = CounterMethod::automatic;
    failures_ = 0;
    flow_.known = false;
    evidence_count_ = 0;
  }
  return counter;
}

std::optional<TxCounter> CounterRecovery::by_method(CounterMethod method, const Mpdu& frame) {
  switch (method) {
    case CounterMethod::csip:
      return by_csip(frame);
    case CounterMethod::sequence16:
      return by_sequence16(frame);
    case CounterMethod::lfsr:
      return by_lfsr(frame);
    case CounterMethod::sequence12:
      return by_sequence12(frame);
    case CounterMethod::automatic:
    case CounterMethod::none:
      break;
  }
  return std::nullopt;
}

std::optional<TxCounter> CounterRecovery::by_lfsr(const Mpdu& frame) const {
  const std::optional<std::uint32_t> position = lfsr_.position(frame.body);
  if (!position) return std::nullopt;
  const std::optional<std::uint32_t> index = LfsrBodies::frame_at(*position, frame.body.size());
  if (!index) return std::nullopt;
  return TxCounter{.value = *index, .modulus = LfsrBodies::period(frame.body.size())};
}

std::optional<TxCounter> CounterRecovery::by_sequence12(const Mpdu& frame) {
  if (!frame.is_data() || !of_the_flow(frame)) return std::nullopt;
  return TxCounter{.value = std::uint64_t{frame.sequence_control} >> 4, .modulus = 4096};
}

/// Whether the frame is of the transmitter and traffic class looked at; the first one met is.
bool CounterRecovery::of_the_flow(const Mpdu& frame) {
  if (!flow_.known) {
    std::copy(frame.transmitter.begin(), frame.transmitter.end(), flow_.transmitter.begin());
    flow_.traffic_class = frame.traffic_class;
    flow_.known = true;
  }
  return flow_.traffic_class == frame.traffic_class &&
         std::equal(frame.transmitter.begin(), frame.transmitter.end(), flow_.transmitter.begin());
}

std::optional<TxCounter> CounterRecovery::settle(const Mpdu& frame) {
  for (const CounterMethod certain : {CounterMethod::csip, CounterMethod::lfsr})
    if (const std::optional<TxCounter> counter = by_method(certain, frame)) {
      method_ = certain;
      return counter;
    }
  if (!frame.is_data()) return std::nullopt;
  if (!of_the_flow(frame)) {
    // Too many of others: another flow may be the one that counts.
    if (++failures_ == kFailuresBeforeAnew) failures_ = 0, flow_.known = false, evidence_count_ = 0;
    return std::nullopt;
  }
  evidence_[evidence_count_++] = frame.sequence_control;
  if (evidence_count_ < kEvidenceFrames) return std::nullopt;
  evidence_count_ = 0;
  method_ = judge_sequence();
  return by_method(method_, frame);
}

/// sequence16 or sequence12 when three quarters of the steps are forward and small, automatic when neither.
CounterMethod CounterRecovery::judge_sequence() const {
  constexpr unsigned kSmallStep = 64, kEnough = (kEvidenceFrames - 1) * 3 / 4;
  const bool fragments =
      std::any_of(evidence_.begin(), evidence_.end(), [](auto s) { return (s & 0xF) != 0; });
  const unsigned shift = fragments ? 0 : 4, mask = fragments ? 0xFFFF : 0x0FFF;
  unsigned forward = 0;
  for (std::size_t i = 1; i < kEvidenceFrames; ++i) {
    const unsigned step = ((evidence_[i] >> shift) - (evidence_[i - 1] >> shift)) & mask;
    forward += step >= 1 && step <= kSmallStep;
  }
  if (forward < kEnough) return CounterMethod::automatic;
  return fragments ? CounterMethod::sequence16 : CounterMethod::sequence12;
}

}  // namespace csipose
