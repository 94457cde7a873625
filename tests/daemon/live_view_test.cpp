#include "daemon/live_view.h"

#include <gtest/gtest.h>

#include "daemon/braille_canvas.h"
#include "tests/daemon/pose_frames.h"

namespace csipose {
namespace {

std::string text_of(const std::vector<Line>& lines, std::size_t width = SIZE_MAX) {
  std::string text;
  for (const Line& line : lines) text += to_text(line, width, false) + '\n';
  return text;
}

bool has(const std::string& text, const std::string& part) { return text.find(part) != std::string::npos; }

LiveState state_with(std::uint32_t people) {
  LiveState state;
  state.hello.name = "kitchen";
  state.hello.room = {
      {4, 3.5F, 2.6F}, {0, 1.75F, 1}, {{"rx1", {4, 0.5F, 1}}, {"rx2", {4, 3, 1}}, {"rx3", {2, 3.5F, 1}}}};
  ReceivedPose pose;
  pose.frame = testing::frame_with(people);
  pose.people_described = people;
  for (std::size_t p = 0; p < people; ++p) pose.root_m[p] = pose.frame.people[p].root();
  state.pose = pose;
  return state;
}

/// Braille patterns are E2 A0..A3 xx.
bool draws_anything(const Line& line) {
  for (const Span& span : line)
    if (has(span.text, "\xe2\xa0") || has(span.text, "\xe2\xa1") || has(span.text, "\xe2\xa2") ||
        has(span.text, "\xe2\xa3"))
      return true;
  return false;
}

/// Spans in the tone of some person, that is, somebody's bones, id or row of the table.
bool shows_somebody(const std::vector<Line>& lines) {
  for (const Line& line : lines)
    for (const Span& span : line)
      if (span.tone >= Tone::person_0) return true;
  return false;
}

TEST(BrailleCanvas, EachDotHasItsBit) {
  const std::array<std::array<const char*, 2>, 4> glyphs = {{{"⠁", "⠈"}, {"⠂", "⠐"}, {"⠄", "⠠"}, {"⡀", "⢀"}}};
  for (int y = 0; y < 4; ++y)
    for (int x = 0; x < 2; ++x) {
      BrailleCanvas canvas(1, 1);
      canvas.dot(x, y, Tone::plain);
      EXPECT_EQ(text_of(canvas.lines()),
                std::string(glyphs[static_cast<std::size_t>(y)][static_cast<std::size_t>(x)]) + "\n");
    }
}

TEST(BrailleCanvas, LinesReachTheirEndsAndStayInside) {
  BrailleCanvas canvas(3, 2);
  canvas.line(0, 0, canvas.width() - 1, 0, Tone::plain);
  canvas.line(-50, 3, 200, 3, Tone::plain);
  canvas.line(2, -9, 2, -5, Tone::plain);
  EXPECT_EQ(text_of(canvas.lines()), "⣉⣉⣉\n   \n");
}

TEST(StyledText, ClipsByColumnsNotBytes) {
  EXPECT_EQ(to_text({{"a⡇b"}, {"cd"}}, 4, false), "a⡇bc");
  EXPECT_EQ(to_text({{"LIVE", Tone::badge}}, 80, false), "[LIVE]");
  EXPECT_EQ(to_text({{"LIVE", Tone::badge}}, 80, true), "\x1b[7m LIVE \x1b[0m");
  EXPECT_EQ(columns("a⡇b"), 3U);
}

TEST(LiveView, SaysInWordsWhatMustBeKnown) {
  const std::string text = text_of(render_live(state_with(2), 120, 50));
  for (const char* part : {"[REPLAY]", "[UNTRAINED]", "[DEGRADED]", "a receiver is missing",
                           "poses mean nothing", "2 people", "rx2", "kitchen", "From above", "300.2 Hz"})
    EXPECT_TRUE(has(text, part)) << part << "\n" << text;
}

TEST(LiveView, DrawsNobodyWhoIsNotInTheLastFrame) {
  EXPECT_TRUE(shows_somebody(render_live(state_with(1), 120, 50)));
  EXPECT_FALSE(shows_somebody(render_live(state_with(0), 120, 50)));
  LiveState silent = state_with(2);
  silent.pose.reset();
  silent.silence = "the stream has stopped";
  EXPECT_FALSE(shows_somebody(render_live(silent, 120, 50)));
  EXPECT_TRUE(has(text_of(render_live(silent, 120, 50)), "Nobody is shown: the stream has stopped"));
}

TEST(LiveView, FitsTheTerminal) {
  for (const std::size_t rows : {1U, 5U, 20U, 24U, 48U, 200U})
    for (const std::size_t width : {1U, 20U, 80U, 300U}) {
      const auto lines = render_live(state_with(5), width, rows);
      EXPECT_LE(lines.size(), rows);
      for (const Line& line : lines) EXPECT_LE(columns(to_text(line, width, false)), width);
    }
}

TEST(LiveView, PicturesKeepTheirPlaceWhenPeopleComeAndGo) {
  const auto first_picture_row = [](std::uint32_t people) {
    const auto lines = render_live(state_with(people), 120, 50);
    std::size_t row = 0;
    while (row < lines.size() && !draws_anything(lines[row])) ++row;
    return row;
  };
  EXPECT_EQ(first_picture_row(0), first_picture_row(3));
  EXPECT_LT(first_picture_row(0), 20U);
}

// A walker to the right and deeper in the room is drawn to the right and further up.
TEST(LiveView, RoomAxesPointTheRightWay) {
  const auto where = [](float x, float y) {
    LiveState state = state_with(1);
    for (Point3& joint : state.pose->frame.people[0].joints) joint = {x, y, 1};
    const auto lines = render_live(state, 120, 50);
    for (std::size_t row = 17; row < lines.size(); ++row) {
      std::size_t column = 0;
      for (const Span& span : lines[row]) {
        if (span.tone == Tone::person_0 && column < 57) return std::pair(row, column);  // the left picture
        column += columns(span.text);
      }
    }
    return std::pair(std::size_t{0}, std::size_t{0});
  };
  const auto near_left = where(0.5F, 0.5F), far_right = where(3.0F, 3.0F);
  EXPECT_GT(near_left.first, far_right.first);
  EXPECT_LT(near_left.second, far_right.second);
}

TruthView truth_with(std::uint32_t people) {
  TruthView view;
  Truth shown;
  for (std::uint32_t id = 1; id <= people; ++id)
    shown.people.push_back({id, testing::standing_person(id, static_cast<float>(id), 1).joints});
  view.shown = shown;
  view.age_s = 0.0921;
  view.with_poses = true;
  view.poses = {200, 150, 400, 380, 300, 42.6};
  view.guess = {199, 199, 400, 400, 20, 9};
  return view;
}

std::size_t spans_of(Tone tone, const std::vector<Line>& lines) {
  std::size_t count = 0;
  for (const Line& line : lines)
    for (const Span& span : line) count += span.tone == tone;
  return count;
}

TEST(LiveView, ShowsTheTruthForWhatItIsAndTheErrorBesideAGuess) {
  LiveState state = state_with(2);
  state.hello.untrained = false;
  state.truth = truth_with(2);
  const auto lines = render_live(state, 80, 24);
  const std::string text = text_of(lines, 80);
  for (const char* part :
       {"2 people (dotted), 92 ms ago as the poses: the simulator's, no result",
        "poses     0.142 m off,  75 % found, count right  75 % of 200",
        "mean pose 0.450 m off,   5 % found, count right 100 % (constant guess)", "t1", "t2"})
    EXPECT_TRUE(has(text, part)) << part << "\n" << text;
  EXPECT_TRUE(has(text, "From above")) << "there is room for pictures in the smallest usual terminal";
  EXPECT_GT(spans_of(Tone::truth, lines), 4U);
}

TEST(LiveView, TruthIsDrawnWhenNobodyIsClaimedAndNotTakenForAResult) {
  LiveState state = state_with(0);
  state.hello.untrained = true;
  state.truth = truth_with(1);
  state.truth->poses = {10, 0, 10, 0, 0, 0};
  const auto lines = render_live(state, 120, 50);
  EXPECT_FALSE(shows_somebody(lines));
  EXPECT_GT(spans_of(Tone::truth, lines), 2U);
  EXPECT_TRUE(has(text_of(lines), "nobody is claimed: the weights are random (UNTRAINED)")) << text_of(lines);
  EXPECT_TRUE(has(text_of(lines), "1 person (dotted)"));
}

TEST(LiveView, SaysWhenTheRoomIsNotTheSimulators) {
  LiveState state = state_with(1);
  state.truth = truth_with(1);
  state.truth->hello = TruthHello();
  state.truth->hello->size_m = {4, 3.5F, 2.6F};
  EXPECT_FALSE(has(text_of(render_live(state, 80, 24)), "room not as simulated"));
  state.truth->hello->size_m = {5.6F, 4.8F, 2.8F};
  EXPECT_TRUE(has(text_of(render_live(state, 80, 24), 80), "room not as simulated"));
  state.truth->hello.reset();  // a recording does not say
  EXPECT_FALSE(has(text_of(render_live(state, 80, 24)), "room not as simulated"));
}

TEST(LiveView, WhatIsNotMeasuredIsADash) {
  LiveState state = state_with(1);
  state.pose.reset();
  EXPECT_TRUE(has(text_of(render_live(state, 80, 24)), "RSSI     -     -     - dBm"));
}

TEST(LiveView, ATruthThatIsOldIsNotDrawn) {
  LiveState state = state_with(1);
  state.truth = truth_with(1);
  state.truth->shown.reset();
  state.truth->silence = "the simulator has ended";
  const auto lines = render_live(state, 120, 50);
  EXPECT_EQ(spans_of(Tone::truth, lines), 0U);
  EXPECT_TRUE(has(text_of(lines), "the simulator has ended"));
}

TEST(LiveView, TruthFitsTheTerminalToo) {
  LiveState state = state_with(5);
  state.truth = truth_with(3);
  for (const std::size_t rows : {1U, 14U, 24U, 29U, 30U, 48U})
    for (const std::size_t width : {20U, 80U, 200U}) {
      const auto lines = render_live(state, width, rows);
      EXPECT_LE(lines.size(), rows);
      for (const Line& line : lines) EXPECT_LE(columns(to_text(line, width, false)), width);
    }
}

TEST(LiveView, NumbersThatAreNoneAreHarmless) {
  LiveState state = state_with(2);
  for (Point3& joint : state.pose->frame.people[0].joints) joint = {kUnknown, kUnknown, kUnknown};
  for (Point3& joint : state.pose->frame.people[1].joints) joint = {1e30F, -1e30F, 1e30F};
  state.pose->root_m[0] = {kUnknown, kUnknown, kUnknown};
  EXPECT_FALSE(render_live(state, 120, 50).empty());
  state.hello.room.size_m = {0, 0, 0};
  EXPECT_FALSE(has(text_of(render_live(state, 120, 50)), "From above"));
}

TEST(LiveView, OneLinePerFrameForPipes) {
  ReceivedPose pose = *state_with(1).pose;
  pose.dropped_before = 3;
  const std::string line = frame_line(pose);
  EXPECT_EQ(line.find('\n'), std::string::npos);
  for (const char* part : {"2026-09-21T14:13:20.000Z", "seq=7", "REPLAY UNTRAINED DEGRADED", "people=1",
                           "dropped_before=3", "reasons=rx_missing, untrained", "#1 0.76 at ("})
    EXPECT_TRUE(has(line, part)) << part << "\n" << line;
}

}  // namespace
}  // namespace csipose
