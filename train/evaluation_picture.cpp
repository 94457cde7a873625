#include "train/evaluation_picture.h"

#include <fmt/format.h>

#include <algorithm>
#include <cassert>
#include <cmath>
#include <opencv2/imgproc.hpp>

#include "drawing/brush.h"

namespace csipose::train {
namespace {

constexpr int kFine = 2;  // pixels of the page per pixel of the picture, along each side
constexpr double kMargin = 24, kTop = 84;
const Ink kTrueInk(196, 190, 186), kGridInk(232, 229, 227), kPanelInk(255, 255, 255);

/// A page that becomes a picture of `size` pixels.
class Page {
 public:
  Page(double width, double height, const std::string& title)
      : size_(static_cast<int>(width), static_cast<int>(height)),
        fine_(size_ * kFine, CV_8UC3, kPaperInk),
        brush_(fine_, kFine) {
    brush_.text({kMargin, 38}, title, 13, kInk, 1.4);
  }
  Brush& brush() { return brush_; }
  void subtitle(const std::string& words) { brush_.text({kMargin, 62}, words, 9.5, kPaleInk); }
  cv::Mat picture() const {
    cv::Mat out;
    cv::resize(fine_, out, size_, 0, 0, cv::INTER_AREA);
    return out;
  }

 private:
  cv::Size size_;
  cv::Mat fine_;
  Brush brush_;
};

// ---- the sheet ----

struct Box {
  Point3 low{HUGE_VALF, HUGE_VALF, HUGE_VALF}, high{-HUGE_VALF, -HUGE_VALF, -HUGE_VALF};
  void add(const Point3& p) {
    low = {std::min(low.x, p.x), std::min(low.y, p.y), std::min(low.z, p.z)};
    high = {std::max(high.x, p.x), std::max(high.y, p.y), std::max(high.z, p.z)};
  }
};

/// Around everybody who is there, with room for those found nearby.
Box box_around(std::span<const Answer> answers) {
  constexpr float kAround_m = 0.5f, kOver_m = 0.15f;
  Box box;
  for (const Answer& answer : answers)
    for (const Skeleton& person : answer.people)
      for (const Point3& joint : person) box.add(joint);
  return {{box.low.x - kAround_m, box.low.y - kAround_m, box.low.z - kOver_m},
          {box.high.x + kAround_m, box.high.y + kAround_m, box.high.z + kOver_m}};
}

enum class View { front, above };

/// One view of one window; what lies outside is cut off.
class Panel {
 public:
  /// `at`: its left upper corner on the page.
  Panel(Brush& page, glm::dvec2 at, const Box& box, double unit_per_m, View view)
      : box_(box), unit_per_m_(unit_per_m), view_(view) {
    size_ = glm::dvec2(box.high.x - box.low.x, upward(box.high) - upward(box.low)) * unit_per_m;
    pixels_ = page.page()(page.area(at, at + size_));
    brush_.emplace(pixels_, page.unit_px());
    brush_->box({0, 0}, size_, kPanelInk);
    for (float x = std::ceil(box.low.x); x <= box.high.x; ++x)
      brush_->line(place({x, box.low.y, box.low.z}), place({x, box.high.y, box.high.z}), kGridInk, 0.8);
    for (float up = std::ceil(upward(box.low)); up <= upward(box.high); ++up)
      brush_->line(place({box.low.x, up, up}), place({box.high.x, up, up}), kGridInk, 0.8);
  }

  glm::dvec2 size() const { return size_; }
  void draw(const Answer& answer) {
    for (const Skeleton& person : answer.people) draw_bones(*brush_, places(person), kTrueInk, 5);
    for (const Detection& detection : answer.found)
      draw_skeleton(*brush_, places(detection.person.joints), 0.8);
  }

 private:
  float upward(const Point3& p) const { return view_ == View::front ? p.z : p.y; }
  glm::dvec2 place(const Point3& p) const {
    return glm::dvec2(p.x - box_.low.x, upward(box_.high) - upward(p)) * unit_per_m_;
  }
  DrawnJoints places(const Skeleton& person) const {
    DrawnJoints joints;
    for (std::size_t j = 0; j < kJoints; ++j) joints[j] = place(person[j]);
    return joints;
  }

  const Box& box_;
  double unit_per_m_;
  View view_;
  glm::dvec2 size_;
  cv::Mat pixels_;
  std::optional<Brush> brush_;
};

/// "window 120: 2 there, 1 found, 143 mm"
std::string words_of(const Answer& answer) {
  double sum = 0;
  std::size_t matched = 0;
  for (const Detection& detection : answer.found) {
    if (detection.match == kMissed) continue;
    ++matched;
    for (const float error_m : detection.error_m) sum += 1000 * static_cast<double>(error_m) / kJoints;
  }
  std::string words =
      fmt::format("window {}: {} there, {} found", answer.window, answer.people.size(), answer.found.size());
  if (matched > 0) words += fmt::format(", {:.0f} mm", sum / static_cast<double>(matched));
  return words;
}

// ---- charts ----

struct Errors {
  std::vector<double> mm;  ///< ascending
  double mean() const {
    double sum = 0;
    for (const double error : mm) sum += error;
    return sum / static_cast<double>(mm.size());
  }
  double median() const { return mm[mm.size() / 2]; }
};

Errors errors_of(std::span<const Detection> detections, std::size_t joint) {
  Errors errors;
  for (const Detection& detection : detections)
    if (detection.match != kMissed) errors.mm.push_back(1000 * static_cast<double>(detection.error_m[joint]));
  std::sort(errors.mm.begin(), errors.mm.end());
  return errors;
}

constexpr double kBin_mm = 25;
constexpr std::size_t kBins = 20;  // the last one holds all that is larger

std::array<double, kBins> shares_of(const Errors& errors) {
  std::array<double, kBins> shares{};
  for (const double error : errors.mm)
    shares[std::min(kBins - 1, static_cast<std::size_t>(error / kBin_mm))] +=
        1 / static_cast<double>(errors.mm.size());
  return shares;
}

void draw_histogram(Brush& brush, glm::dvec2 low, glm::dvec2 high, std::size_t joint, const Errors& errors,
                    double top_share) {
  std::string name(kJointNames[joint]);
  std::replace(name.begin(), name.end(), '_', ' ');
  brush.text({low.x, low.y - 21}, name, 9.5, kInk, 1.2);
  const std::string figures = fmt::format("median {:.0f}, mean {:.0f}", errors.median(), errors.mean());
  brush.text({low.x, low.y - 6}, figures, 8, kPaleInk);
  brush.box(low, high, kPanelInk);
  const auto x_of = [&](double mm) { return low.x + (high.x - low.x) * mm / (kBin_mm * kBins); };
  for (const double mm : {100., 200., 300., 400.})
    brush.line({x_of(mm), low.y}, {x_of(mm), high.y}, kGridInk, 0.8);
  const auto shares = shares_of(errors);
  for (std::size_t i = 0; i < kBins; ++i) {
    const double left = x_of(static_cast<double>(i) * kBin_mm);
    const double height = (high.y - low.y - 6) * shares[i] / top_share;
    if (shares[i] > 0)
      brush.box({left + 1, high.y - height}, {left + x_of(kBin_mm) - low.x - 1, high.y}, ink_of_joint(joint));
  }
  const double median = x_of(std::min(errors.median(), kBin_mm * kBins));
  brush.line({median, low.y}, {median, high.y}, kInk, 1.2);
  for (const double mm : {0., 200., 400.}) {
    const std::string words = fmt::format("{:.0f}", mm);
    brush.text({x_of(mm) - (mm > 0 ? brush.text_width(words, 7.5) / 2 : 0), high.y + 13}, words, 7.5,
               kPaleInk);
  }
}

/// Mean errors by number of people, and what they are of.
struct Bars {
  std::string name;
  Ink ink;
  std::map<std::size_t, double> mm;
};

std::vector<Bars> bars_of(std::span<const NamedMetrics> rows) {
  static const std::array<std::array<Ink, 2>, 3> kInks = {{{kLeftInk, Ink(225, 185, 135)},
                                                           {Ink(120, 115, 110), Ink(190, 186, 182)},
                                                           {Ink(70, 130, 60), Ink(165, 200, 160)}}};
  std::vector<Bars> bars;
  for (std::size_t r = 0; r < rows.size(); ++r) {
    Bars matched{rows[r].name + ", those matched", kInks[r % kInks.size()][0], {}};
    Bars penalised{rows[r].name + ", missed = 500 mm", kInks[r % kInks.size()][1], {}};
    for (const auto& [count, group] : rows[r].detect.by_count()) {
      if (count == 0) continue;
      matched.mm[count] = group.person_mean.mpjpe;
      penalised.mm[count] = group.penalised_500;
    }
    bars.push_back(std::move(matched));
    bars.push_back(std::move(penalised));
  }
  return bars;
}

/// A round number of millimetres above all bars.
double top_of(const std::vector<Bars>& bars) {
  double top = 100;
  for (const Bars& one : bars)
    for (const auto& [count, mm] : one.mm)
      if (mm > top) top = mm;
  return 100 * std::ceil(top / 100);
}

}  // namespace

std::vector<std::size_t> spread_windows(const WindowSource& windows, std::size_t count) {
  std::vector<std::size_t> with_people, chosen;
  for (std::size_t i = 0; i < windows.size(); ++i)
    if (!windows.people(i).empty()) with_people.push_back(i);
  count = std::min(count, with_people.size());
  for (std::size_t k = 0; k < count; ++k)
    chosen.push_back(with_people[(2 * k + 1) * with_people.size() / (2 * count)]);
  return chosen;
}

cv::Mat draw_sheet(std::span<const Answer> answers, const std::string& title) {
  constexpr std::size_t kColumns = 3;
  constexpr double kPanel = 460, kGap = 20, kWords = 24, kBetween = 6;
  const Box box = box_around(answers);
  assert(box.high.x > box.low.x);
  const double unit_per_m = kPanel / static_cast<double>(box.high.x - box.low.x);
  const double front = unit_per_m * static_cast<double>(box.high.z - box.low.z);
  const double above = unit_per_m * static_cast<double>(box.high.y - box.low.y);
  const double cell_height = kWords + front + kBetween + above + kGap;
  const std::size_t columns = std::min(kColumns, answers.size()),
                    rows = (answers.size() + columns - 1) / columns;
  Page page(std::max(2 * kMargin + static_cast<double>(columns) * (kPanel + kGap) - kGap, 900.0),
            kTop + static_cast<double>(rows) * cell_height + 8, title);
  page.subtitle(
      "above: from the front; below: from above; grid 1 m; grey: true; blue left, red right: found");
  for (std::size_t i = 0; i < answers.size(); ++i) {
    const glm::dvec2 at(kMargin + static_cast<double>(i % columns) * (kPanel + kGap),
                        kTop + static_cast<double>(i / columns) * cell_height);
    page.brush().text({at.x, at.y + kWords - 8}, words_of(answers[i]), 9, kInk);
    Panel(page.brush(), {at.x, at.y + kWords}, box, unit_per_m, View::front).draw(answers[i]);
    Panel(page.brush(), {at.x, at.y + kWords + front + kBetween}, box, unit_per_m, View::above)
        .draw(answers[i]);
  }
  return page.picture();
}

cv::Mat draw_joint_errors(std::span<const Detection> detections, const std::string& title) {
  constexpr std::size_t kColumns = 5;
  constexpr double kWidth = 210, kHeight = 110, kStepX = 238, kStepY = 184;
  Page page(2 * kMargin + kColumns * kStepX - (kStepX - kWidth), kTop + 3 * kStepY, title);
  const auto matched = std::count_if(detections.begin(), detections.end(),
                                     [](const Detection& detection) { return detection.match != kMissed; });
  page.subtitle(fmt::format(
      "errors of {} people whom detect found and matched, mm; the last bin holds all above {:.0f}", matched,
      kBin_mm * (kBins - 1)));
  if (matched == 0) return page.picture();
  std::array<Errors, kJoints> errors;
  double top_share = 0;
  for (std::size_t j = 0; j < kJoints; ++j) {
    errors[j] = errors_of(detections, j);
    const auto shares = shares_of(errors[j]);
    top_share = std::max(top_share, *std::max_element(shares.begin(), shares.end()));
  }
  for (std::size_t j = 0; j < kJoints; ++j) {
    const glm::dvec2 low(kMargin + static_cast<double>(j % kColumns) * kStepX,
                         kTop + 38 + static_cast<double>(j / kColumns) * kStepY);
    draw_histogram(page.brush(), low, low + glm::dvec2(kWidth, kHeight), j, errors[j], top_share);
  }
  return page.picture();
}

cv::Mat draw_error_by_count(std::span<const NamedMetrics> rows, const std::string& title) {
  constexpr double kHeight = 300, kBar = 46, kBetween = 70, kLeft = 70;
  const std::vector<Bars> bars = bars_of(rows);
  std::map<std::size_t, GroupMetrics> groups;
  if (!rows.empty()) groups = rows.front().detect.by_count();
  groups.erase(0);
  const double group = kBar * static_cast<double>(bars.size()) + kBetween, top_mm = top_of(bars);
  const double width = std::max(900.0, kLeft + group * static_cast<double>(groups.size()) + kMargin);
  const double legend = kTop + kHeight + 62;
  Page page(width, legend + 22 * static_cast<double>((bars.size() + 1) / 2) + 8, title);
  page.subtitle("detect, mean over people, mm");
  Brush& brush = page.brush();
  const auto y_of = [&](double mm) { return kTop + kHeight * (1 - mm / top_mm); };
  brush.box({kLeft, kTop}, {width - kMargin, y_of(0)}, kPanelInk);
  for (double mm = 0; mm <= top_mm; mm += 100) {
    brush.line({kLeft, y_of(mm)}, {width - kMargin, y_of(mm)}, kGridInk, 0.8);
    const std::string words = fmt::format("{:.0f}", mm);
    brush.text({kLeft - 8 - brush.text_width(words, 8.5), y_of(mm) + 4}, words, 8.5, kPaleInk);
  }
  double x = kLeft + kBetween / 2;
  for (const auto& [count, figures] : groups) {
    const std::string words =
        fmt::format("{} {}, {} windows", count, count == 1 ? "person" : "people", figures.frames);
    brush.text({x, y_of(0) + 22}, words, 9.5, kInk);
    for (std::size_t b = 0; b < bars.size(); ++b) {
      const auto found = bars[b].mm.find(count);
      const glm::dvec2 foot(x + kBar * static_cast<double>(b), y_of(0));
      const bool known = found != bars[b].mm.end() && !std::isnan(found->second);
      const double high = known ? y_of(found->second) : foot.y;
      if (known) brush.box({foot.x + 3, high}, {foot.x + kBar - 3, foot.y}, bars[b].ink);
      const std::string value = known ? fmt::format("{:.0f}", found->second) : "-";
      brush.text({foot.x + (kBar - brush.text_width(value, 8)) / 2, high - 5}, value, 8, kInk);
    }
    x += group;
  }
  for (std::size_t b = 0; b < bars.size(); ++b) {
    const glm::dvec2 at(kLeft + (b % 2 == 0 ? 0 : 300), legend + 22 * static_cast<double>(b / 2));
    brush.box({at.x, at.y - 10}, {at.x + 14, at.y + 2}, bars[b].ink);
    brush.text({at.x + 22, at.y}, bars[b].name, 9.5, kInk);
  }
  return page.picture();
}

}  // namespace csipose::train
