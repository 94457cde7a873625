#include "sim/captured_scene.h"

#include <fmt/core.h>

#include <algorithm>
#include <cmath>

#include "proto/result.h"
#include "sim/geometry.h"
#include "sim/human_scene.h"
#include "sim/material.h"

namespace csipose::sim {
namespace {
constexpr double kLookEvery_s = 0.1, kGrid_m = 0.1;
constexpr int kTurns = 24;

using Way = std::vector<Vec3>;  // hips every kLookEvery_s

Way way_of(const CapturedMotion& person) {
  Way way;
  for (double t = 0; t < person.seconds() + kLookEvery_s; t += kLookEvery_s)
    way.push_back(person.at(t).pelvis);
  return way;
}

/// Turned to the left, and the rectangle about it moved so that its middle is the origin: what put() does.
Way turned(const Way& way, double angle_rad) {
  const double c = std::cos(angle_rad), s = std::sin(angle_rad);
  Vec3 low{1e300}, high{-1e300};
  Way result;
  for (const Vec3& p : way) {
    result.push_back({c * p.x - s * p.y, s * p.x + c * p.y, 0});
    low = glm::min(low, result.back());
    high = glm::max(high, result.back());
  }
  for (Vec3& p : result) p -= (low + high) / 2.0;
  return result;
}

/// Places of a grid over the area, from its middle outward; from the outside inward for whoever must leave room for others.
std::vector<Vec3> places_of(const Rectangle& area, bool others_follow) {
  const Vec3 middle{(area.x0 + area.x1) / 2, (area.y0 + area.y1) / 2, 0};
  const int nx = static_cast<int>((area.x1 - middle.x) / kGrid_m),
            ny = static_cast<int>((area.y1 - middle.y) / kGrid_m);
  std::vector<Vec3> places;
  for (int x = -nx; x <= nx; ++x)
    for (int y = -ny; y <= ny; ++y) places.push_back(middle + kGrid_m * Vec3{x, y, 0});
  std::stable_sort(places.begin(), places.end(), [&](const Vec3& a, const Vec3& b) {
    return glm::distance(a, middle) < glm::distance(b, middle);
  });
  if (others_follow) std::reverse(places.begin(), places.end());
  return places;
}

const Vec3& held(const Way& way, std::size_t i) { return way[std::min(i, way.size() - 1)]; }

/// Whether who goes `way`, moved by `place`, keeps off everything and everybody.
bool fits(const Stage& stage, std::span<const Way> others, const Way& way, const Vec3& place) {
  for (const Vec3& p : way)
    if (!stage.is_free(p + place)) return false;
  for (const Way& other : others)
    for (std::size_t i = 0; i < std::max(way.size(), other.size()); ++i) {
      const Vec3 off = held(way, i) + place - held(other, i);
      if (std::hypot(off.x, off.y) < kApartSpread_m) return false;
    }
  return true;
}

struct Put {
  Vec3 middle{};
  double turn_rad = 0;
};

/// Finds places for everybody from the i-th on: for each turn of one the first place that fits, then those who follow.
class Placing {
 public:
  Placing(const Stage& stage, std::vector<Way> ways)
      : stage_(stage), ways_(std::move(ways)), puts_(ways_.size()), reached_(0) {}

  bool place_from(std::size_t i) {
    if (i == ways_.size()) return true;
    reached_ = std::max(reached_, i);
    const std::vector<Vec3> places = places_of(stage_.area, i + 1 < ways_.size());
    for (int k = 0; k < kTurns; ++k) {  // 0, 15, -15, 30, ... degrees
      const double turn_rad = (k % 2 == 1 ? 1 : -1) * ((k + 1) / 2) * 2 * kPi / kTurns;
      Way way = turned(ways_[i], turn_rad);
      const auto place = std::find_if(places.begin(), places.end(),
                                      [&](const Vec3& p) { return fits(stage_, placed_, way, p); });
      if (place == places.end()) continue;
      for (Vec3& p : way) p += *place;
      placed_.push_back(std::move(way));
      puts_[i] = {*place, turn_rad};
      if (place_from(i + 1)) return true;
      placed_.pop_back();
    }
    return false;
  }
  const Put& put(std::size_t i) const { return puts_[i]; }
  /// Whoever found no place, at best.
  std::size_t reached() const { return reached_; }

 private:
  const Stage& stage_;
  std::vector<Way> ways_, placed_;
  std::vector<Put> puts_;
  std::size_t reached_;
};

}  // namespace

std::vector<std::unique_ptr<CapturedMotion>> read_captured(const CaptureSpec& spec, std::uint64_t seed) {
  const std::vector<Naming> namings = spec.namings.empty() ? built_in_namings() : read_namings(spec.namings);
  std::vector<std::unique_ptr<CapturedMotion>> people;
  for (const std::filesystem::path& file : spec.files) {
    const BvhClip clip = read_bvh(file);
    const auto sub = static_cast<std::uint16_t>(people.size());
    people.push_back(std::make_unique<CapturedMotion>(clip, find_landmarks(clip, namings), spec.part,
                                                      CounterRng(seed, Purpose::persons, sub, 0, 0)));
  }
  return people;
}

void put_into(const RoomPlan& room, std::span<const std::unique_ptr<CapturedMotion>> people,
              std::span<const std::filesystem::path> files) {
  const Stage stage = stage_of(room);
  std::vector<Way> ways;
  for (const auto& person : people) {
    person->put({0, 0, 0}, 0);
    ways.push_back(way_of(*person));
  }
  Placing placing(stage, std::move(ways));
  if (!placing.place_from(0)) {
    const Rectangle about = people[placing.reached()]->way();
    throw SetupError(
        ExitStatus::bad_data,
        fmt::format(
            "{}: the hips cover {:.2f} x {:.2f} m; there is no place for that in the area of {:.2f} x {:.2f} "
            "m "
            "of the room '{}', {} m inside it, off furniture and others. Take a part of the file with "
            "--bvh-from and --bvh-seconds, or a larger room",
            files[placing.reached()].string(), about.x1 - about.x0, about.y1 - about.y0,
            stage.area.x1 - stage.area.x0, stage.area.y1 - stage.area.y0, room.name, kInside_m));
  }
  for (std::size_t i = 0; i < people.size(); ++i)
    people[i]->put(placing.put(i).middle, placing.put(i).turn_rad);
}

CapturedScene::CapturedScene(const RoomPlan& room, const CaptureSpec& spec, std::uint64_t seed,
                             double rate_hz)
    : still_(room.still),
      people_(read_captured(spec, seed)),
      skin_{find_material("skin_dry")->permittivity(still_.carrier_hz), 0},
      rate_hz_(rate_hz) {
  put_into(room, people_, spec.files);
}

void CapturedScene::next(Snapshot& out) {
  const double now_s = static_cast<double>(number_++) / rate_hz_;
  out.bodies.clear();
  out.people.clear();
  for (const auto& person : people_) add_person(*person, now_s, skin_, out);
}

}  // namespace csipose::sim
