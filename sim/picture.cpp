#include "sim/picture.h"

#include <fmt/core.h>

#include <algorithm>
#include <cmath>
#include <opencv2/imgproc.hpp>

#include "drawing/brush.h"
#include "proto/pose.h"
#include "sim/reference_solver.h"

namespace csipose::sim {
namespace {

constexpr int kFine = 2;          // pixels of the page per pixel of the picture, along each side
constexpr double kRange_db = 40;  // of colours, below the greatest
constexpr int kColumn = 500;      // width of the channel's side, in units of a page 1600 wide
constexpr double kMargin = 28, kTop = 84, kBottom = 62;

constexpr Colour kPaper{0.955f, 0.955f, 0.945f};
const Ink kSenderInk(60, 40, 200), kReceiverInk(120, 80, 20);

double decibel(double amplitude) { return 20 * std::log10(std::max(amplitude, 1e-12)); }

Ink colour_of_level(double level, int colours) {
  const cv::Mat grey(1, 1, CV_8UC1, cv::Scalar(255 * std::clamp(level, 0.0, 1.0)));
  cv::Mat colour;
  cv::applyColorMap(grey, colour, colours);
  const auto& c = colour.at<cv::Vec3b>(0, 0);
  return {double(c[0]), double(c[1]), double(c[2])};
}

/// Clothes, so that people can be told apart and their limbs too; bodies in the order of bodies_of() (human.h).
Colour colour_of_person(std::size_t person, std::size_t part) {
  constexpr Colour kSkin{0.76f, 0.50f, 0.38f}, kShoe{0.10f, 0.10f, 0.11f};
  constexpr std::array<Colour, 3> kShirts{
      {{0.16f, 0.36f, 0.46f}, {0.55f, 0.24f, 0.14f}, {0.30f, 0.40f, 0.18f}}};
  constexpr std::array<Colour, 3> kTrousers{
      {{0.13f, 0.15f, 0.22f}, {0.24f, 0.22f, 0.20f}, {0.12f, 0.20f, 0.28f}}};
  if (part < 2) return kSkin;
  if (part == 2) return kShirts[person % 3];
  if (part == 3) return kTrousers[person % 3];
  switch ((part - 4) % 6) {
    case 0:
    case 1:
      return kShirts[person % 3];
    case 2:
      return kSkin;
    case 5:
      return kShoe;
    default:
      return kTrousers[person % 3];
  }
}
constexpr std::size_t kPersonParts = 16;

std::vector<Colour> colours_of(const std::vector<Body>& bodies, std::size_t people, double carrier_hz) {
  std::vector<Colour> colours;
  for (std::size_t i = 0; i < bodies.size(); ++i)
    colours.push_back(i < kPersonParts * people ? colour_of_person(i / kPersonParts, i % kPersonParts)
                                                : colour_of(bodies[i].surface, carrier_hz));
  return colours;
}

struct DrawnPath {
  double level_db;
  std::vector<Vec3> points;
  bool by_body;
};

}  // namespace

/// One picture in the making.
class Picture::Page {
 public:
  Page(const Picture& picture, const ScenePlayer& now)
      : picture_(picture),
        options_(picture.options_),
        now_(now),
        unit_px_(kFine * options_.width / 1600.0),
        height_(1600.0 * options_.height / options_.width),
        page_(options_.height * kFine, options_.width * kFine, CV_8UC3, kPaperInk),
        brush_(page_, unit_px_),
        low_{kMargin, kTop},
        high_{1600 - kColumn - 2 * kMargin, height_ - kBottom - 10} {
    const Extent extent = picture.view_.extent(now.bodies());
    camera_ =
        camera_around(extent, options_.azimuth_deg * 3.14159265358979 / 180,
                      options_.elevation_deg * 3.14159265358979 / 180, low_ * unit_px_, high_ * unit_px_);
    floor_m_ = extent.low.z;
  }

  cv::Mat draw() {
    draw_room();
    if (options_.paths > 0) draw_paths();
    if (options_.skeletons)
      for (const Joints& person : now_.people()) draw_person(person);
    draw_devices();
    draw_titles();
    draw_legend();
    draw_channel();
    cv::Mat out;
    cv::resize(page_, out, {options_.width, options_.height}, 0, 0, cv::INTER_AREA);
    return out;
  }

 private:
  std::optional<glm::dvec2> at(const Vec3& p) const {
    const auto px = camera_.project(p);
    if (!px) return std::nullopt;
    return *px / unit_px_;
  }
  void line_between(const Vec3& a, const Vec3& b, const Ink& ink, double width) {
    const auto from = at(a), to = at(b);
    if (from && to) brush_.line(*from, *to, ink, width);
  }

  void draw_room() {
    const double right = 1600 - kColumn - kMargin;
    const int width = static_cast<int>(right * unit_px_), height = page_.rows;
    static const std::vector<Body> kNobody;
    const auto& bodies = options_.bodies ? now_.bodies() : kNobody;
    const Pixels seen =
        picture_.view_.draw(camera_, width, height, bodies,
                            colours_of(bodies, picture_.people_, now_.still().carrier_hz), kPaper);
    for (int y = 0; y < height; ++y)
      for (int x = 0; x < width; ++x) {
        const std::uint8_t* rgb = &seen.rgb[(static_cast<std::size_t>(y) * static_cast<std::size_t>(width) +
                                             static_cast<std::size_t>(x)) *
                                            3];
        page_.at<cv::Vec3b>(y, x) = {rgb[2], rgb[1], rgb[0]};
      }
  }

  /// Of each receiver's middle antenna, the strongest over all of them.
  std::vector<DrawnPath> strongest_paths() const {
    Scene scene = now_.still();
    for (const Body& body : now_.bodies()) scene.bodies.push_back({body});
    std::vector<DrawnPath> paths;
    for (const auto& receiver : scene.receivers)
      for (const Path& path : reference_paths(scene, receiver[receiver.size() / 2], 0)) {
        DrawnPath drawn{decibel(std::abs(path.amplitude * path.shadow)), {path.legs[0].from}, path.body >= 0};
        for (const Leg& leg : path.legs) drawn.points.push_back(leg.to);
        paths.push_back(drawn);
      }
    std::stable_sort(paths.begin(), paths.end(),
                     [](const DrawnPath& a, const DrawnPath& b) { return a.level_db > b.level_db; });
    paths.resize(std::min(paths.size(), static_cast<std::size_t>(options_.paths)));
    return paths;
  }
  void draw_paths() {
    auto paths = strongest_paths();
    if (paths.empty()) return;
    paths_top_db_ = paths[0].level_db;
    const cv::Mat before = page_.clone();
    for (auto path = paths.rbegin(); path != paths.rend(); ++path) {
      const double level = 1 + (path->level_db - paths_top_db_) / kRange_db;
      const Ink ink = colour_of_level(level, cv::COLORMAP_PLASMA);
      for (std::size_t i = 0; i + 1 < path->points.size(); ++i)
        line_between(path->points[i], path->points[i + 1], ink, 0.8 + 1.6 * std::clamp(level, 0.0, 1.0));
      for (std::size_t i = 1; i + 1 < path->points.size(); ++i)
        if (const auto corner = at(path->points[i])) brush_.dot(*corner, 2.2, ink);
    }
    cv::addWeighted(page_, 0.75, before, 0.25, 0, page_);
  }

  void draw_person(const Joints& person) {
    DrawnJoints joints;
    for (std::size_t j = 0; j < kJoints; ++j) joints[j] = at(person[j]);
    draw_skeleton(brush_, joints);
  }

  void draw_devices() {
    const Scene& scene = now_.still();
    draw_device({scene.transmitter.position}, "Tx", kSenderInk);
    for (std::size_t r = 0; r < scene.receivers.size(); ++r) {
      std::vector<Vec3> antennas;
      for (const Antenna& antenna : scene.receivers[r]) antennas.push_back(antenna.position);
      draw_device(antennas, fmt::format("Rx {}", r + 1), kReceiverInk);
    }
  }
  void draw_device(const std::vector<Vec3>& antennas, const std::string& name, const Ink& ink) {
    constexpr double kMast_m = 0.11;
    Vec3 middle{0};
    for (const Vec3& antenna : antennas) middle += antenna / static_cast<double>(antennas.size());
    const Vec3 foot{middle.x, middle.y, floor_m_};
    constexpr int kDashes = 24;
    for (int i = 0; i < kDashes; i += 2)
      line_between(middle + (i + 0.0) / kDashes * (foot - middle),
                   middle + (i + 1.0) / kDashes * (foot - middle), ink, 1);
    if (const auto p = at(foot)) brush_.dot(*p, 2.4, ink);
    for (const Vec3& antenna : antennas)
      line_between(antenna - Vec3{0, 0, 0.03}, antenna + Vec3{0, 0, kMast_m}, ink, 2.4);
    line_between(antennas.front(), antennas.back(), ink, 3);
    const auto p = at(middle), top = at(middle + Vec3{0, 0, kMast_m});
    if (!p || !top) return;
    brush_.dot(*p, 5.5, kWhiteInk);
    brush_.dot(*p, 4.2, ink);
    draw_tag(*top + glm::dvec2{0, -12}, name, ink);
  }
  /// Above `at`, higher where another tag is.
  void draw_tag(glm::dvec2 foot, const std::string& words, const Ink& ink) {
    constexpr double kHeight = 10, kPad = 6;
    const double half = brush_.text_width(words, kHeight) / 2 + kPad;
    foot.x = std::clamp(foot.x, low_.x + half - kMargin / 2, high_.x - half + kMargin / 2);
    const auto overlaps = [&](const glm::dvec4& other) {
      return foot.x - half < other.z && foot.x + half > other.x && foot.y - kHeight - 2 * kPad < other.w &&
             foot.y > other.y;
    };
    while (std::any_of(tags_.begin(), tags_.end(), overlaps)) foot.y -= 4;
    const glm::dvec2 low{foot.x - half, foot.y - kHeight - 2 * kPad}, high{foot.x + half, foot.y};
    tags_.push_back({low.x, low.y, high.x, high.y});
    brush_.box(low, high, ink);
    brush_.text({low.x + kPad, high.y - kPad}, words, kHeight, kWhiteInk, 1.3);
  }

  void draw_titles() {
    brush_.text({kMargin, 42}, options_.title, 14, kInk, 1.5);
    const Scene& scene = now_.still();
    std::string words = fmt::format("t = {:.2f} s", now_.time_s());
    if (scene.walls && !scene.meshes)
      words += fmt::format("     room {:.1f} x {:.1f} x {:.1f} m, floor grid 1 m", scene.room.size_m.x,
                           scene.room.size_m.y, scene.room.size_m.z);
    words += fmt::format("     {:.2f} GHz, {:.0f} packets/s", scene.carrier_hz / 1e9, 1 / now_.step_s());
    brush_.text({kMargin, 68}, words, 9.5, kPaleInk);
  }

  void draw_legend() {
    const double y = height_ - 28;
    double x = kMargin;
    const auto entry = [&](const Ink& ink, const std::string& words) {
      brush_.line({x, y - 5}, {x + 24, y - 5}, ink, 3);
      brush_.dot({x + 12, y - 5}, 4, ink);
      brush_.text({x + 32, y}, words, 9.5, kInk);
      x += 32 + brush_.text_width(words, 9.5) + 26;
    };
    if (options_.skeletons && !now_.people().empty()) {
      entry(kLeftInk, "left limbs");
      entry(kRightInk, "right limbs");
    }
    if (options_.paths > 0) {
      brush_.text({x, y}, fmt::format("{} strongest paths", options_.paths), 9.5, kInk);
      x += brush_.text_width(fmt::format("{} strongest paths", options_.paths), 9.5) + 14;
      draw_scale({x, y - 10}, {x + 150, y}, cv::COLORMAP_PLASMA, paths_top_db_);
    }
  }
  /// Colours from kRange_db below `top_db` to it, with the two ends' numbers beside it.
  void draw_scale(glm::dvec2 low, glm::dvec2 high, int colours, double top_db) {
    const std::string from = fmt::format("{:.0f}", top_db - kRange_db), to = fmt::format("{:.0f} dB", top_db);
    const double shift = brush_.text_width(from, 9) + 8;
    brush_.text({low.x, high.y}, from, 9, kPaleInk);
    low.x += shift, high.x += shift;
    const cv::Rect area = brush_.area(low, high);
    cv::Mat ramp(1, 256, CV_8UC1), coloured;
    for (int i = 0; i < 256; ++i) ramp.at<std::uint8_t>(0, i) = static_cast<std::uint8_t>(i);
    cv::applyColorMap(ramp, coloured, colours);
    cv::resize(coloured, page_(area), area.size(), 0, 0, cv::INTER_LINEAR);
    brush_.text({high.x + 8, high.y}, to, 9, kPaleInk);
  }

  // The channel's past, time to the right.

  double top_level_db() const {
    double top = 0;
    for (const auto& h : now_.channel())
      for (const auto& x : h) top = std::max(top, double{std::abs(x)});
    return std::ceil(decibel(top));
  }
  /// Level 0..255 over tones and time of one link; blank where there is no past yet.
  cv::Mat link_levels(std::size_t receiver, std::size_t antenna, double top_db, cv::Mat& known) const {
    const Scene& scene = now_.still();
    const auto columns = static_cast<int>(std::lround(now_.past_s() / now_.step_s()));
    const auto tones = static_cast<int>(scene.tones.size());
    const std::size_t antennas = scene.receivers[0].size(), links = scene.receivers.size() * antennas;
    cv::Mat levels(tones, columns, CV_8UC1, cv::Scalar(0));
    known = cv::Mat(1, columns, CV_8UC1, cv::Scalar(0));
    const auto& past = now_.channel();
    for (std::size_t i = 0; i < past.size(); ++i) {
      const int column = columns - static_cast<int>(past.size()) + static_cast<int>(i);
      if (column < 0) continue;
      known.at<std::uint8_t>(0, column) = 255;
      for (int k = 0; k < tones; ++k) {
        const auto& x = past[i][static_cast<std::size_t>(k) * links + receiver * antennas + antenna];
        levels.at<std::uint8_t>(tones - 1 - k, column) =
            cv::saturate_cast<std::uint8_t>(255 * (1 + (decibel(std::abs(x)) - top_db) / kRange_db));
      }
    }
    // The colours of the first column blend with what is known, not with nothing.
    const int first = columns - static_cast<int>(past.size());
    for (int column = 0; column < first; ++column) levels.col(first).copyTo(levels.col(column));
    return levels;
  }
  void draw_link(glm::dvec2 low, glm::dvec2 high, std::size_t receiver, std::size_t antenna, double top_db) {
    cv::Mat known, coloured, large, mask;
    const cv::Mat levels = link_levels(receiver, antenna, top_db, known);
    const cv::Rect area = brush_.area(low, high);
    cv::applyColorMap(levels, coloured, cv::COLORMAP_VIRIDIS);
    cv::resize(coloured, large, area.size(), 0, 0, cv::INTER_LINEAR);
    cv::resize(known, mask, area.size(), 0, 0, cv::INTER_NEAREST);
    page_(area).setTo(cv::Scalar(232, 232, 233));
    large.copyTo(page_(area), mask);
  }
  void draw_channel() {
    const Scene& scene = now_.still();
    const double left = 1600 - kColumn + 4, right = 1600 - kMargin, top_db = top_level_db();
    brush_.text({left - 22, 42}, "Channel |H|, subcarriers over time", 11.5, kInk, 1.2);
    brush_.text({left - 22, 68}, "three antennas A, B, C of each receiver", 9.5, kPaleInk);
    const double block = (height_ - kBottom - kTop) / static_cast<double>(scene.receivers.size());
    for (std::size_t r = 0; r < scene.receivers.size(); ++r) {
      const double y = kTop + static_cast<double>(r) * block;
      brush_.text({left - 22, y + 13}, fmt::format("Rx {}", r + 1), 9.5, kReceiverInk, 1.3);
      const auto antennas = scene.receivers[r].size();
      const double strip = (block - 20) / static_cast<double>(antennas);
      for (std::size_t a = 0; a < antennas; ++a) {
        const double strip_y = y + 20 + static_cast<double>(a) * strip;
        draw_link({left, strip_y}, {right, strip_y + strip - 4}, r, a, top_db);
        brush_.text({left - 20, strip_y + strip / 2 + 3}, std::string(1, static_cast<char>('A' + a)), 9,
                    kPaleInk);
      }
    }
    draw_time_axis(left, right);
    draw_scale({right - 236, height_ - 24}, {right - 96, height_ - 14}, cv::COLORMAP_VIRIDIS, top_db);
  }
  void draw_time_axis(double left, double right) {
    const double y = height_ - kBottom + 4;
    const int digits = now_.past_s() < 1 ? 2 : 1;
    const std::string now = fmt::format("{:.{}f} s", now_.time_s(), digits),
                      then = fmt::format("{:.{}f} s", now_.time_s() - now_.past_s(), digits);
    brush_.text({left, y + 12}, then, 9, kPaleInk);
    brush_.text({right - brush_.text_width(now, 9), y + 12}, now, 9, kPaleInk);
  }

  const Picture& picture_;
  const PictureOptions& options_;
  const ScenePlayer& now_;
  double unit_px_, height_;
  cv::Mat page_;
  Brush brush_;
  glm::dvec2 low_, high_;  ///< where the room goes
  Camera camera_;
  double floor_m_ = 0, paths_top_db_ = 0;
  std::vector<glm::dvec4> tags_;
};

Picture::Picture(const Scene& still, std::size_t people, const PictureOptions& options)
    : view_(still), people_(people), options_(options) {}
Picture::~Picture() = default;

cv::Mat Picture::draw(const ScenePlayer& now) const { return Page(*this, now).draw(); }

ScenePlayer::ScenePlayer(std::unique_ptr<MovingScene> scene, double step_s, double past_s)
    : scene_(std::move(scene)), solver_(scene_->still()), step_s_(step_s), past_s_(past_s) {
  solve_next_batch();
  run_to(0);
}

void ScenePlayer::solve_next_batch() {
  const Scene& scene = still();
  std::vector<std::vector<Body>> bodies;
  for (auto& snapshot : batch_) {
    scene_->next(snapshot);
    bodies.push_back(snapshot.bodies);
  }
  h_.resize(kSamples * scene.tones.size() * scene.receivers.size() * scene.receivers[0].size());
  solver_.solve(bodies, h_);
  solved_ += kSamples;
}

void ScenePlayer::run_to(std::size_t snapshot) {
  const std::size_t row = h_.size() / kSamples;
  const auto keep = static_cast<std::size_t>(std::lround(past_s_ / step_s_));
  const auto take = [&](std::size_t i) {
    const auto from = h_.begin() + static_cast<std::ptrdiff_t>(i % kSamples * row);
    channel_.emplace_back(from, from + static_cast<std::ptrdiff_t>(row));
    if (channel_.size() > keep) channel_.pop_front();
  };
  if (channel_.empty()) take(0);
  while (now_ < snapshot) {
    if (++now_ == solved_) solve_next_batch();
    take(now_);
  }
}

namespace {

class StatedScene final : public MovingScene {
 public:
  explicit StatedScene(const Scene& scene) : bodies_(scene.bodies), still_(scene) { still_.bodies.clear(); }
  const Scene& still() const override { return still_; }
  std::size_t people() const override { return 0; }
  void next(Snapshot& out) override {
    out.bodies.clear();
    out.people.clear();
    for (const MovingBody& body : bodies_)
      out.bodies.push_back(body.at(static_cast<double>(number_) * still_.step_s));
    ++number_;
  }

 private:
  std::vector<MovingBody> bodies_;
  Scene still_;
  std::uint64_t number_ = 0;
};

}  // namespace

std::unique_ptr<MovingScene> stated_scene(const Scene& scene) { return std::make_unique<StatedScene>(scene); }

}  // namespace csipose::sim
