// tests/daemon/pose_frames.h - frames, statuses and messages with known contents.
#pragma once

#include <cstring>
#include <string>

#include "proto/wire.h"

namespace csipose::testing {

inline Person standing_person(std::uint32_t id, float x, float y) {
  Person person;
  person.id = id;
  person.score = 0.75F + 0.01F * static_cast<float>(id);
  person.age_ms = 1000 * id;
  for (std::size_t j = 0; j < kJoints; ++j) {
    const auto n = static_cast<float>(j);
    person.joints[j] = {x + 0.0123F * n, y - 0.02F * n, 1.7F - 0.1F * n};
    person.joints_raw[j] = {x, y, n};
    person.confidence[j] = 0.9F - 0.05F * n;
    person.sigma_m[j] = kUnknown;
  }
  return person;
}

/// A degraded frame of a replay by untrained weights: every field has a value of its own.
inline PoseFrame frame_with(std::uint32_t people, std::uint64_t seq = 7) {
  PoseFrame frame;
  frame.seq = seq;
  frame.session = 0xFEDCBA9876543210;
  frame.window_end = UtcTime{Nanoseconds{1790000000000000000}};
  frame.window_start = frame.window_end - Nanoseconds{63333333};
  frame.published = frame.window_end + std::chrono::milliseconds(50);
  frame.mono_ns = 123456789012345 + static_cast<std::int64_t>(seq) * 33'333'333;
  frame.clock_error_ns = 2500;
  frame.source = Source::replay;
  frame.state = State::degraded;
  frame.reasons = reason_bit(Reason::rx_missing) | reason_bit(Reason::untrained);
  std::memcpy(frame.model.data(), "0123456789ab", 12);
  frame.untrained = true;
  frame.people_count = people;
  for (std::uint32_t p = 0; p < people; ++p)
    frame.people[p] = standing_person(p + 1, 1.0F + static_cast<float>(p), 2);
  frame.latency_us = {10, 20, 30, 4000, 50};
  for (std::size_t r = 0; r < kReceivers; ++r)
    frame.receivers[r] = {300.25F, {-50, -60.5F, kUnknown}, 0.125F, 1000 + r};
  return frame;
}

inline Status busy_status() {
  Status status;
  status.name = "csipose";
  status.version = "1.2.3";
  status.session = 1ULL << 63;
  status.source = Source::replay;
  status.state = State::degraded;
  status.reasons = reason_bit(Reason::rx_missing);
  status.config_path = "/etc/csiposed/csiposed.toml";
  status.budget_ms = 50;
  status.frames_published = 1234;
  status.people = 2;
  status.windows = {{"ok", 1200}, {"gap", 34}};
  status.receivers.resize(3);
  for (std::size_t r = 0; r < 3; ++r) status.receivers[r].id = "rx" + std::to_string(r + 1);
  status.receivers[1].skew_ppm = -11.7;
  status.receivers[1].rate_hz = 299.5;
  status.receivers[1].rejected = {{"forged", 12}};
  status.stages = {{"infer", {}}};
  for (const std::uint32_t us : {900U, 12000U, 21000U}) status.stages[0].histogram.add(us);
  return status;
}

/// A frame's message as one client gets it, without the length or newline that frames it.
inline std::string message_bytes(FrameEncoder& encoder, const PoseFrame& frame, Level level, Format format,
                                 std::uint32_t dropped_before) {
  std::string body;
  encoder.encode_body(frame, level, format, body);
  const FrameEnvelope around = envelope(format, body.size(), dropped_before);
  std::string bytes(around.head.data(), around.head_size);
  bytes += body;
  bytes.append(around.tail.data(), around.tail_size);
  return format == Format::json ? bytes.substr(0, bytes.size() - 1) : bytes.substr(4);
}

}  // namespace csipose::testing
