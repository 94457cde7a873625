// daemon/live_view.h - what `csipose watch` shows: the newest frame in words, a table and two small pictures.
//
// Pure: a state in, lines out. Nobody is drawn who was not in the last frame; a stream that has stopped shows
// no one.
#pragma once

#include <optional>
#include <string>
#include <vector>

#include "daemon/error_meter.h"
#include "daemon/styled_text.h"
#include "proto/truth.h"
#include "proto/wire.h"

namespace csipose {

/// What the simulator says, and how the poses did against it.
struct TruthView {
  std::optional<TruthHello> hello;  ///< none: the room is what the daemon is configured for
  std::optional<Truth>
      shown;  ///< at the middle of the window that the poses came from; the newest when there is no pose
  double age_s = 0;         ///< of what is shown
  bool with_poses = false;  ///< shown and poses belong to the same instant
  ErrorSums poses, guess;
  std::string silence;  ///< why nothing is shown, for people
};

struct LiveState {
  Hello hello;
  std::optional<ReceivedPose> pose;      ///< none: no frame yet, or the last is too old to be true
  std::optional<ReceivedStatus> status;  ///< none: not said yet
  double frames_per_second = 0;
  std::uint64_t frames = 0, lost = 0;  ///< got; lost on the way to this client
  std::string silence;                 ///< why there is no frame, for people
  std::optional<TruthView> truth;      ///< none: nobody asked for it
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
/// What is added to it when the truth is known: " truth=2 matched=1 error_m=0.142".
std::string error_words(const FrameError& error);
/// "0.142 m on average, 55 % of people found, 90 % of claims right, count right 80 %", or "-" for what is not known.
std::string accuracy_words(const ErrorSums& sums);

}  // namespace csipose
