#include "daemon/live_view.h"

#include <fmt/chrono.h>
#include <fmt/format.h>

#include <algorithm>
#include <cctype>
#include <cmath>

#include "daemon/braille_canvas.h"

namespace csipose {
namespace {

constexpr std::size_t kLeastPictureRows = 6, kLeastPictureColumns = 24, kMostPictureRows = 30;
constexpr std::size_t kWordRows = 16;  // words above the pictures when three people are there
constexpr std::size_t kTruthRows = 3, kAiryRows = 30;

std::string upper(std::string_view word) {
  std::string text(word);
  for (char& c : text) c = static_cast<char>(std::toupper(static_cast<unsigned char>(c)));
  return text;
}

Tone badge_for(State state) {
  switch (state) {
    case State::degraded:
    case State::warmup:
    case State::paused:
      return Tone::badge_warning;
    case State::stale:
    case State::fault:
      return Tone::badge_alarm;
    case State::empty:
    case State::tracking:
      break;
  }
  return Tone::badge;
}

std::string number_or_dash(double value, const char* form) {
  return std::isfinite(value) ? fmt::format(fmt::runtime(form), value) : "-";
}

// ---- Words ----

Line receiver_line(const std::string& id, const ReceiverQuality& quality, const ReceiverStatus* status) {
  const bool heard = quality.missing_ratio < 1;
  Line line = {{fmt::format("  {:<8}", id), Tone::strong},
               {fmt::format("{:7.1f} Hz", quality.rate_hz), heard ? Tone::plain : Tone::alarm},
               {fmt::format("   missing {:5.1f} %", quality.missing_ratio * 100),
                quality.missing_ratio > 0.1F ? Tone::warning : Tone::plain},
               {"   RSSI", Tone::dim}};
  for (const float dbm : quality.rssi_dbm)
    line.push_back({fmt::format("{:>6}", number_or_dash(dbm, "{:.0f}"))});
  line.push_back({" dBm", Tone::dim});
  if (status != nullptr && status->usable + status->lost > 0) {
    const double lost =
        100.0 * static_cast<double>(status->lost) / static_cast<double>(status->usable + status->lost);
    line.push_back({fmt::format("   lost {:.1f} %", lost), lost > 5 ? Tone::warning : Tone::plain});
  }
  return line;
}

ReceiverQuality nothing_measured() {
  ReceiverQuality quality;
  quality.rssi_dbm.fill(kUnknown);
  return quality;
}

void add_receivers(const LiveState& state, std::vector<Line>& lines) {
  lines.push_back({{"Receivers", Tone::dim}});
  for (std::size_t r = 0; r < state.hello.room.receivers.size() && r < kReceivers; ++r) {
    const bool told = state.status && r < state.status->status.receivers.size();
    lines.push_back(receiver_line(state.hello.room.receivers[r].id,
                                  state.pose ? state.pose->frame.receivers[r] : nothing_measured(),
                                  told ? &state.status->status.receivers[r] : nullptr));
  }
}

const ReceivedStatus::Latency* latency_of(const LiveState& state, const char* stage) {
  if (!state.status) return nullptr;
  const auto& all = state.status->latency;
  const auto found =
      std::find_if(all.begin(), all.end(), [&](const auto& latency) { return latency.stage == stage; });
  return found == all.end() || found->count == 0 ? nullptr : &*found;
}

void add_timing(const LiveState& state, std::vector<Line>& lines) {
  Line line = {{"Delay   ", Tone::dim}, {fmt::format("{:.0f} ms budget", state.hello.budget_ms)}};
  if (const auto* all = latency_of(state, "end_to_end")) {
    const bool late = all->p99_ms > static_cast<double>(state.hello.budget_ms) * 1.1;
    line.push_back({fmt::format(", {:.1f} ms median, {:.1f} ms p99", all->p50_ms, all->p99_ms),
                    late ? Tone::warning : Tone::plain});
  }
  if (const auto* infer = latency_of(state, "infer"))
    line.push_back({fmt::format("; network {:.1f} ms", infer->p50_ms)});
  if (state.hello.clock == "recording") line.push_back({" (clock of the recording)", Tone::dim});
  if (state.status && state.status->status.deadline_misses > 0)
    line.push_back({fmt::format("; {} late", state.status->status.deadline_misses), Tone::warning});
  lines.push_back(std::move(line));
  Line frames = {{"Frames  ", Tone::dim},
                 {fmt::format("{:.1f} a second here, {} so far", state.frames_per_second, state.frames)}};
  if (state.lost > 0) frames.push_back({fmt::format(", {} lost on the way here", state.lost), Tone::warning});
  lines.push_back(std::move(frames));
}

Line person_line(const Person& person, const Point3& root, std::size_t number) {
  const auto& c = person.confidence;
  const float confidence = std::isnan(c[0]) ? kUnknown : *std::min_element(c.begin(), c.end());
  return {{fmt::format("  {:>4}", person.id), person_tone(number)},
          {fmt::format("   {:5.2f}   {:6.2f} {:6.2f} {:6.2f}   {:>9}   {:>6.1f} s", person.score, root.x,
                       root.y, root.z, number_or_dash(confidence, "{:.2f}"), person.age_ms / 1000.0)}};
}

void add_people(const LiveState& state, std::vector<Line>& lines) {
  const std::uint32_t count = state.pose ? state.pose->frame.people_count : 0;
  if (!state.pose) return lines.push_back({{"Nobody is shown: ", Tone::strong}, {state.silence}});
  lines.push_back({{count == 0   ? "Nobody"
                    : count == 1 ? "1 person"
                                 : fmt::format("{} people", count),
                    Tone::strong}});
  if (state.pose->people_described == 0) return;
  lines.push_back({{"    id   score      x      y      z m   least sure   seen for", Tone::dim}});
  for (std::size_t p = 0; p < state.pose->people_described; ++p)
    lines.push_back(person_line(state.pose->frame.people[p], state.pose->root_m[p], p));
}

// ---- The simulator's truth ----

/// Poses and truth share the room's corner, so errors hold; but what is configured is not what is simulated.
bool is_another_room(const LiveState& state) {
  if (!state.truth || !state.truth->hello) return false;
  const Point3& size = state.truth->hello->size_m;
  const auto& configured = state.hello.room.size_m;
  constexpr float kSame_m = 0.01F;
  return std::abs(size.x - configured[0]) > kSame_m || std::abs(size.y - configured[1]) > kSame_m ||
         std::abs(size.z - configured[2]) > kSame_m;
}

/// So large that both rooms fit.
std::array<float, 3> drawn_size_m(const LiveState& state) {
  std::array<float, 3> size = state.hello.room.size_m;
  if (!state.truth || !state.truth->hello) return size;
  const Point3& simulated = state.truth->hello->size_m;
  return {std::max(size[0], simulated.x), std::max(size[1], simulated.y), std::max(size[2], simulated.z)};
}

std::string percent_or_dash(double ratio) { return number_or_dash(100 * ratio, "{:.0f}"); }

Line truth_line(const TruthView& truth) {
  Line line = {{"Truth   ", Tone::dim}};
  if (!truth.shown) {
    line.push_back({truth.silence, Tone::warning});
    return line;
  }
  const std::size_t people = truth.shown->people.size();
  line.push_back({fmt::format("{} {} (dotted), {:.0f} ms ago{}", people, people == 1 ? "person" : "people",
                              truth.age_s * 1000, truth.with_poses ? " as the poses" : ""),
                  Tone::truth});
  line.push_back({": the simulator's, no result"});
  return line;
}

Line score_line(const char* first, const char* who, const ErrorSums& sums, const std::string& remark) {
  return {{first, Tone::dim},
          {fmt::format("{:<9} {:>5} m off, {:>3} % found, count right {:>3} %", who,
                       number_or_dash(sums.mean_error_m(), "{:.3f}"), percent_or_dash(sums.found_ratio()),
                       percent_or_dash(sums.count_right_ratio()))},
          {remark, Tone::dim}};
}

void add_truth(const LiveState& state, std::vector<Line>& lines) {
  if (!state.truth) return;
  const TruthView& truth = *state.truth;
  lines.push_back(truth_line(truth));
  if (state.hello.untrained && truth.poses.claimed == 0)
    lines.push_back(
        {{"Error   ", Tone::dim}, {"poses     nobody is claimed: the weights are random (UNTRAINED)"}});
  else
    lines.push_back(score_line("Error   ", "poses", truth.poses, fmt::format(" of {}", truth.poses.frames)));
  lines.push_back(score_line("        ", "mean pose", truth.guess, " (constant guess)"));
}

// ---- Pictures ----

/// A plane of the room on a canvas: across to the right, up to the top.
class Picture {
 public:
  /// `up_m` and `across_m`: the room's size along these axes.
  Picture(std::size_t columns, std::size_t rows, float across_m, float up_m)
      : canvas_(columns, rows), up_m_(up_m) {
    const auto width = static_cast<float>(canvas_.width() - 1),
               height = static_cast<float>(canvas_.height() - 1);
    dots_per_m_ = std::min(width / across_m, height / up_m);
    const int right = x(across_m), top = y(up_m), bottom = y(0);
    for (const auto& [x0, y0, x1, y1] :
         {std::array{0, top, right, top}, std::array{0, bottom, right, bottom}, std::array{0, top, 0, bottom},
          std::array{right, top, right, bottom}})
      canvas_.line(x0, y0, x1, y1, Tone::dim);
  }
  void bone(float across0, float up0, float across1, float up1, Tone tone) {
    if (fits(across0, up0) && fits(across1, up1)) canvas_.line(x(across0), y(up0), x(across1), y(up1), tone);
  }
  void dotted_bone(float across0, float up0, float across1, float up1, Tone tone) {
    if (fits(across0, up0) && fits(across1, up1))
      canvas_.dotted_line(x(across0), y(up0), x(across1), y(up1), tone);
  }
  void mark(float across, float up, const std::string& letters, Tone tone) {
    if (!fits(across, up)) return;
    const int last = canvas_.width() - 2 * static_cast<int>(letters.size());
    canvas_.text(std::clamp(x(across), 0, last), std::clamp(y(up), 0, canvas_.height() - 1), letters, tone);
  }
  std::vector<Line> lines() const { return canvas_.lines(); }

 private:
  static bool fits(float across, float up) {
    return std::abs(across) < 100 && std::abs(up) < 100;
  }  // false for NaN
  int x(float across) const { return static_cast<int>(std::lround(across * dots_per_m_)); }
  int y(float up) const { return static_cast<int>(std::lround((up_m_ - up) * dots_per_m_)); }

  BrailleCanvas canvas_;
  float up_m_, dots_per_m_ = 1;
};

/// Which coordinate goes up: y seen from above, z seen from the front.
using Up = float Point3::*;

void draw_people(const ReceivedPose& pose, Up up, Picture& picture) {
  for (std::size_t p = 0; p < pose.people_described; ++p) {
    const Skeleton& joints = pose.frame.people[p].joints;
    for (const auto& [a, b] : kBones)
      picture.bone(joints[a].x, joints[a].*up, joints[b].x, joints[b].*up, person_tone(p));
    const Point3& at =
        std::isnan(joints[0].x) ? pose.root_m[p] : joints[1];  // beside the head, or where they are
    picture.mark(at.x + 0.1F, at.*up, fmt::format("{}", pose.frame.people[p].id), person_tone(p));
  }
}

void draw_truth(const Truth& truth, Up up, Picture& picture) {
  for (const TruePerson& person : truth.people) {
    for (const auto& [a, b] : kBones)
      picture.dotted_bone(person.joints[a].x, person.joints[a].*up, person.joints[b].x, person.joints[b].*up,
                          Tone::truth);
    picture.mark(person.joints[1].x - 0.1F, person.joints[1].*up, fmt::format("t{}", person.id), Tone::truth);
  }
}

void draw_devices(const RoomDescription& room, std::size_t up, Picture& picture) {
  picture.mark(room.transmitter_m[0], room.transmitter_m[up], "T", Tone::strong);
  for (std::size_t r = 0; r < room.receivers.size(); ++r) {
    const auto& at = room.receivers[r].position_m;
    picture.mark(at[0], at[up], fmt::format("{}", r + 1), Tone::strong);
  }
}

Picture make_picture(const LiveState& state, std::size_t up, std::size_t columns, std::size_t rows) {
  const RoomDescription& room = state.hello.room;
  const auto size_m = drawn_size_m(state);
  Picture picture(columns, rows, size_m[0], size_m[up]);
  const Up axis = up == 1 ? &Point3::y : &Point3::z;
  draw_devices(room, up, picture);
  if (state.truth && state.truth->shown) draw_truth(*state.truth->shown, axis, picture);
  if (state.pose) draw_people(*state.pose, axis, picture);
  return picture;
}

/// No picture is wider than it must be to be as high as it may.
std::size_t picture_columns(float across_m, float up_m, std::size_t rows, std::size_t most) {
  return std::min(most,
                  static_cast<std::size_t>(std::ceil(2 * static_cast<float>(rows) * across_m / up_m)) + 1);
}

void add_pictures(const LiveState& state, std::size_t width, std::size_t rows, std::vector<Line>& lines) {
  const auto size = drawn_size_m(state);
  if (rows < kLeastPictureRows + 1 || width < 2 * kLeastPictureColumns ||
      *std::min_element(size.begin(), size.end()) <= 0)
    return;
  const std::size_t high = std::min(rows - 1, kMostPictureRows), half = (width - 3) / 2;
  const std::size_t left_columns = picture_columns(size[0], size[1], high, half);
  const std::size_t right_columns = picture_columns(size[0], size[2], high, half);
  const auto left = make_picture(state, 1, left_columns, high).lines();
  const auto right = make_picture(state, 2, right_columns, high).lines();
  lines.push_back({{fmt::format("{:<{}}   {}", "From above (x right, y up)", left_columns,
                                "From the front (x right, z up)"),
                    Tone::dim}});
  for (std::size_t row = 0; row < high; ++row) {
    Line line = left[row];
    line.push_back({"   "});
    line.insert(line.end(), right[row].begin(), right[row].end());
    lines.push_back(std::move(line));
  }
}

}  // namespace

std::string words_for(Reason reason) {
  switch (reason) {
    case Reason::rx_missing:
      return "a receiver is missing";
    case Reason::gap:
      return "packets were lost";
    case Reason::skew:
      return "receivers disagree about time";
    case Reason::nan_input:
      return "CSI that is no number was left out";
    case Reason::deadline:
      return "the result was late";
    case Reason::no_model:
      return "there is no model";
    case Reason::untrained:
      return "the weights are random: poses mean nothing";
    case Reason::too_few_links:
      return "too few links for this model";
    case Reason::mixed_width:
      return "20 and 40 MHz were mixed";
    case Reason::no_data:
      return "no packets come";
    case Reason::clock_unknown:
      return "the host's clock is not known to be right";
    case Reason::unknown_installation:
      return "the weights do not know this room, or not its cards since they were powered up";
  }
  return "a reason that this version does not know";
}

Line state_bar(const Hello& hello, const PoseFrame* frame) {
  const Source source = frame != nullptr ? frame->source : hello.source;
  const State state = frame != nullptr ? frame->state : hello.state;
  Line line = {{upper(name_of(source)), source == Source::live ? Tone::badge : Tone::badge_warning}, {" "}};
  if (frame != nullptr ? frame->untrained : hello.untrained) {
    line.push_back({"UNTRAINED", Tone::badge_alarm});
    line.push_back({" "});
  }
  line.push_back({upper(name_of(state)), badge_for(state)});
  std::string words;
  for (int i = 1; frame != nullptr && i <= static_cast<int>(Reason::unknown_installation); ++i)
    if (frame->reasons >> i & 1U) words += (words.empty() ? "  " : "; ") + words_for(static_cast<Reason>(i));
  line.push_back({words});
  return line;
}

std::vector<Line> render_live(const LiveState& state, std::size_t width, std::size_t rows) {
  std::vector<Line> lines;
  lines.push_back(state_bar(state.hello, state.pose ? &state.pose->frame : nullptr));
  lines.push_back({{fmt::format("{}   model {}   session {:016x}", state.hello.name, state.hello.model,
                                state.hello.session),
                    Tone::dim}});
  if (is_another_room(state)) lines.back().push_back({"   room not as simulated", Tone::warning});
  const bool airy = !state.truth || rows >= kAiryRows;
  const auto pause = [&] {
    if (airy) lines.push_back({});
  };
  pause();
  add_receivers(state, lines);
  add_timing(state, lines);
  add_truth(state, lines);
  pause();
  add_people(state, lines);
  pause();
  // Pictures keep their place when people come and go.
  const std::size_t used = std::max(lines.size(), state.truth && airy ? kWordRows + kTruthRows : kWordRows);
  if (used < rows) {
    lines.resize(used);
    add_pictures(state, width, rows - used, lines);
  }
  if (lines.size() > rows) lines.resize(rows);
  return lines;
}

std::string frame_line(const ReceivedPose& pose) {
  const PoseFrame& frame = pose.frame;
  // A frame that only tells a state has no window: then the time that it was published.
  const UtcTime time = frame.window_end > UtcTime{} ? frame.window_end : frame.published;
  const auto second = std::chrono::floor<std::chrono::seconds>(time);
  std::string line =
      fmt::format("{:%Y-%m-%dT%H:%M:%S}.{:03}Z seq={} {}{} {} people={}", second,
                  (time - second) / std::chrono::milliseconds(1), frame.seq, upper(name_of(frame.source)),
                  frame.untrained ? " UNTRAINED" : "", upper(name_of(frame.state)), frame.people_count);
  if (frame.reasons != 0) line += " reasons=" + names_of(frame.reasons);
  if (pose.dropped_before > 0) line += fmt::format(" dropped_before={}", pose.dropped_before);
  for (std::size_t p = 0; p < pose.people_described; ++p)
    line += fmt::format("  #{} {:.2f} at ({:.2f}, {:.2f}, {:.2f})", frame.people[p].id, frame.people[p].score,
                        pose.root_m[p].x, pose.root_m[p].y, pose.root_m[p].z);
  return line;
}

std::string error_words(const FrameError& error) {
  return fmt::format(" truth={} matched={}{}", error.people, error.matched,
                     error.matched > 0
                         ? fmt::format(" error_m={:.3f}", error.error_m / static_cast<double>(error.matched))
                         : "");
}

std::string accuracy_words(const ErrorSums& sums) {
  return fmt::format("{} m off on average, {} % of people found, {} % of claims right, count right {} %",
                     number_or_dash(sums.mean_error_m(), "{:.3f}"), percent_or_dash(sums.found_ratio()),
                     percent_or_dash(sums.claimed_rightly_ratio()),
                     percent_or_dash(sums.count_right_ratio()));
}

}  // namespace csipose
