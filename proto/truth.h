// proto/truth.h - where simulated people really are, instant by instant: what the simulator says on its truth socket.
//
// JSON lines, one object each; docs/truth.md is the page for people. First a hello, then one line for every packet that the
// virtual transmitter sends. Truth is never an input of the daemon: it is for viewers and error meters.
#pragma once

#include <string>
#include <string_view>
#include <variant>
#include <vector>

#include "proto/pose.h"
#include "proto/result.h"

namespace csipose {

inline constexpr std::string_view kTruthApi = "1.0";
inline constexpr std::size_t kMaxTruthLine = 64 * 1024;  ///< bytes; a longer one is refused
inline constexpr std::size_t kMaxTruePeople = 64;

struct TruthHello {
  std::string scene;  ///< what is simulated, in words: "office, 2 people: walk"
  std::uint64_t seed = 0;
  double rate_hz = 0;  ///< instants per simulated second
  double speed = 1;    ///< simulated seconds per second
  std::string impair;  ///< "none", "mild", "5300"
  Point3 size_m, transmitter_m;
  std::vector<Point3> receivers_m;
};

struct TruePerson {
  std::uint32_t id = 0;  ///< from 1, the same for as long as the simulator runs
  Skeleton joints{};
};
struct Truth {
  std::uint64_t counter = 0;  ///< of the transmitted packet, as in its frame
  double simulated_s = 0;     ///< of the instant that the joints belong to
  UtcTime sent{};  ///< when its packet left, comparable with the pose stream's window times on the same host
  std::vector<TruePerson> people;
  std::uint32_t dropped_before = 0;  ///< lines that this reader lost just before this one
};
using TruthMessage = std::variant<TruthHello, Truth>;

/// One line, newline included.
std::string encode(const TruthHello& hello);
std::string encode(const Truth& truth);

/// A line without its newline. The error says what is wrong with it.
Result<TruthMessage, std::string> parse_truth(std::string_view line);

}  // namespace csipose
