// daemon/live_view.h - what `csipose watch` shows: the newest frame in words, a table and two small pictures.
//
// Pure: a state in, lines out. Nobody is drawn who was not in the last frame; a stream that has stopped shows
// no one.
#pragma once

#include <optional>
#include <string>
#include <vector>

#include "daemon/styled_text.h"
#include "proto/wire.h"

namespace csipose {

struct LiveState {
  Hello hello;
  std::optional<ReceivedPose> pose;      ///< none: no frame yet, or the last is too old to be true
  std::optional<ReceivedStatus> status;  ///< none: not said yet
  double frames_per_second = 0;
  std::uint64_t frames = 0, lost = 0;  ///< got; lost on the way to this client
  std::string silence;                 ///< why there is no frame, for people
};

/// The whole screen, at most `rows` lines; the pictures take what the words leave and are left out when that
/// is little.
std::vector<Line> render_live(const LiveState& state, std::size_t width, std::size_t rows);

/// The badges at the top: LIVE, REPLAY or SIMULATED; UNTRAINED; the state; reasons in words.
Line state_bar(const Hello& hello, const PoseFrame* frame);
/// "a receiver is missing"; for people, not for programs.
std::string words_for(Reason reason);

/// One frame as one line of text, for pipes and logs.
std::string frame_line(const ReceivedPose& pose);

}  // namespace csipose
