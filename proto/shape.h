// proto/shape.h - the sizes everything here has, once.
//
// One alphabet: T time, N receivers, R antennas of a receiver, S streams, K subcarriers, L links (N*R), C channels
// of a token (K amplitudes, then K phases), P people, J joints.
#pragma once

#include <array>
#include <cstddef>

namespace csipose {

inline constexpr std::size_t kReceivers = 3;
inline constexpr std::size_t kAntennas = 3;
inline constexpr std::size_t kMaxStreams = 3;
inline constexpr std::size_t kLinks = kReceivers * kAntennas;  // l = 3 * receiver + antenna
inline constexpr std::size_t kSubcarriers = 30;                // Intel 5300 grouping, 20 and 40 MHz alike
inline constexpr std::size_t kChannels = 2 * kSubcarriers;
inline constexpr std::size_t kSamples = 20;
inline constexpr std::size_t kTokens = kSamples * kLinks;  // token i = t * 9 + l
inline constexpr std::size_t kJoints = 14;
inline constexpr std::size_t kPoseWidth = 3 * kJoints;  ///< numbers of one pose
inline constexpr std::size_t kMaxPeople = 10;           // the most that a frame can carry

}  // namespace csipose
