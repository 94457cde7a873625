#include "sim/object_clip.h"

#include <algorithm>
#include <cmath>

#include "sim/geometry.h"

namespace csipose::sim {
namespace {
constexpr double kDeviceClearance_m = 0.3, kFastest_m_s = 3;
constexpr int kPositionTries = 200, kShrinkEvery = 50;

const Material* pick(CounterRng& rng, std::initializer_list<const char*> names) {
  return find_material(names.begin()[rng.index(static_cast<std::uint32_t>(names.size()))]);
}

Vec3 draw_direction(CounterRng& rng) {
  const double z = rng.uniform(-1, 1), angle = rng.uniform(0, 2 * kPi), across = std::sqrt(1 - z * z);
  return {across * std::cos(angle), across * std::sin(angle), z};
}

/// Shoemake, "Uniform random rotations", Graphics Gems III (1992).
glm::dquat draw_rotation(CounterRng& rng) {
  const double a = rng.uniform(0, 1), b = rng.uniform(0, 1), c = rng.uniform(0, 1);
  const double p = std::sqrt(1 - a), q = std::sqrt(a);
  return glm::dquat(q * std::cos(2 * kPi * c), p * std::sin(2 * kPi * b), p * std::cos(2 * kPi * b),
                    q * std::sin(2 * kPi * c));
}

bool fits(const ObjectClip& clip, const FlyingObject& object) {
  for (const DevicePlace& device : clip.devices)
    if (glm::distance(device.position, object.position) < object.radius_m + kDeviceClearance_m) return false;
  for (const FlyingObject& other : clip.objects)
    if (glm::distance(other.position, object.position) < object.radius_m + other.radius_m + 0.02)
      return false;
  return true;
}

/// False when there is no room for it.
bool draw_position(CounterRng& rng, const ObjectClip& clip, FlyingObject& object) {
  for (int attempt = 1; attempt <= kPositionTries; ++attempt) {
    const double margin = object.radius_m + 0.05;
    for (int axis = 0; axis < 3; ++axis)
      object.position[axis] = rng.uniform(margin, clip.room_m[axis] - margin);
    if (fits(clip, object)) return true;
    if (attempt % kShrinkEvery == 0) object.radius_m *= 0.8;
  }
  return false;
}

FlyingObject draw_object(CounterRng& rng) {
  FlyingObject object;
  object.kind = static_cast<ObjectKind>(rng.index(4));
  object.radius_m = rng.uniform(0.1, 0.5);
  for (double& slimness : object.slimness) slimness = rng.uniform(0, 1);
  object.material = pick(rng, {"skin_dry", "skin_dry", "metal", "wood", "chipboard"});
  object.rotation = draw_rotation(rng);
  const Vec3 course = draw_direction(rng);
  object.velocity_m_s = rng.uniform(0, kFastest_m_s) * course;
  const Vec3 spin_axis = draw_direction(rng);
  object.spin_rad_s = rng.uniform(0, kPi) * spin_axis;
  if (object.kind == ObjectKind::sphere) object.spin_rad_s = Vec3{0};
  return object;
}

void bounce_off_walls(FlyingObject& object, const Vec3& room_m) {
  for (int axis = 0; axis < 3; ++axis) {
    double &p = object.position[axis], &v = object.velocity_m_s[axis];
    const double low = object.radius_m, high = room_m[axis] - object.radius_m;
    if (p < low) {
      p = 2 * low - p;
      v = std::abs(v);
    } else if (p > high) {
      p = 2 * high - p;
      v = -std::abs(v);
    }
  }
}

void bounce_off_device(FlyingObject& object, const Vec3& device) {
  const Vec3 apart = object.position - device;
  const double distance = glm::length(apart);
  if (distance >= object.radius_m + kDeviceClearance_m) return;
  const Vec3 n = apart / distance;
  const double approach = glm::dot(object.velocity_m_s, n);
  if (approach < 0) object.velocity_m_s -= 2 * approach * n;
}

void collide(FlyingObject& a, FlyingObject& b) {
  const Vec3 apart = a.position - b.position;
  const double distance = glm::length(apart);
  if (distance >= a.radius_m + b.radius_m) return;
  const Vec3 n = apart / distance;
  const double approach = glm::dot(a.velocity_m_s - b.velocity_m_s, n);
  if (approach >= 0) return;
  const double mass_a = std::pow(a.radius_m, 3), mass_b = std::pow(b.radius_m, 3);
  const double impulse = -2 * approach / (1 / mass_a + 1 / mass_b);
  a.velocity_m_s += impulse / mass_a * n;
  b.velocity_m_s -= impulse / mass_b * n;
}

void limit_speed(FlyingObject& object) {
  const double speed = glm::length(object.velocity_m_s);
  if (speed > kFastest_m_s) object.velocity_m_s *= kFastest_m_s / speed;
}

void turn(FlyingObject& object, double dt_s) {
  const double rate = glm::length(object.spin_rad_s);
  if (rate == 0) return;
  object.rotation = glm::normalize(glm::angleAxis(rate * dt_s, object.spin_rad_s / rate) * object.rotation);
}

}  // namespace

Body FlyingObject::body(const Surface& surface) const {
  Body body{Shape::ellipsoid, position, glm::mat3_cast(rotation), Vec3{radius_m}, surface};
  switch (kind) {
    case ObjectKind::sphere:
      break;
    case ObjectKind::cube:
      body.shape = Shape::box;
      body.half_m = Vec3{radius_m / std::sqrt(3.0)};
      break;
    case ObjectKind::cylinder: {
      const double part = 0.4 + 0.5 * slimness[0];
      body.shape = Shape::cylinder;
      body.half_m = {radius_m * part, radius_m * part, radius_m * std::sqrt(1 - part * part)};
      break;
    }
    case ObjectKind::ellipsoid:
      body.half_m = radius_m * Vec3{1, 0.4 + 0.6 * slimness[0], 0.4 + 0.6 * slimness[1]};
      break;
  }
  return body;
}

void ObjectClip::step(double dt_s) {
  for (FlyingObject& object : objects) {
    object.position += dt_s * object.velocity_m_s;
    bounce_off_walls(object, room_m);
    for (const DevicePlace& device : devices) bounce_off_device(object, device.position);
  }
  for (std::size_t i = 0; i < objects.size(); ++i)
    for (std::size_t j = i + 1; j < objects.size(); ++j) collide(objects[i], objects[j]);
  for (FlyingObject& object : objects) {
    limit_speed(object);
    turn(object, dt_s);
  }
}

ObjectClip sample_object_clip(std::uint64_t seed, std::uint32_t clip_number) {
  const auto stream = [&](Purpose purpose, std::size_t sub) {
    return CounterRng(seed, purpose, static_cast<std::uint16_t>(sub), clip_number, 0);
  };
  ObjectClip clip;
  CounterRng room = stream(Purpose::room, 0);
  clip.room_m.x = room.uniform(3, 8);
  clip.room_m.y = room.uniform(3, 8);
  clip.room_m.z = room.uniform(2.5, 4);
  clip.walls = draw_walls(seed, clip_number);
  clip.devices = draw_devices(seed, clip_number, clip.room_m);

  const std::uint32_t count = 1 + stream(Purpose::objects, 0).index(4);
  for (std::uint32_t j = 0; j < count; ++j) {
    CounterRng rng = stream(Purpose::objects, j + 1);
    FlyingObject object = draw_object(rng);
    if (draw_position(rng, clip, object)) clip.objects.push_back(object);
  }
  return clip;
}

namespace {

class ObjectScene final : public MovingScene {
 public:
  ObjectScene(std::uint64_t seed, std::uint32_t clip, double rate_hz, Ways ways)
      : clip_(sample_object_clip(seed, clip)),
        still_(random_room(clip_.room_m, clip_.walls, clip_.devices)),
        step_s_(1 / rate_hz) {
    set_ways(still_, ways, seed, clip);
    for (const FlyingObject& object : clip_.objects)
      surfaces_.push_back({object.material->permittivity(still_.carrier_hz), 0});
  }
  const Scene& still() const override { return still_; }
  std::size_t people() const override { return 0; }
  void next(Snapshot& out) override {
    out.bodies.resize(clip_.objects.size());
    for (std::size_t i = 0; i < clip_.objects.size(); ++i)
      out.bodies[i] = clip_.objects[i].body(surfaces_[i]);
    clip_.step(step_s_);
  }

 private:
  ObjectClip clip_;
  Scene still_;
  std::vector<Surface> surfaces_;
  double step_s_;
};

}  // namespace

std::unique_ptr<MovingScene> object_scene(std::uint64_t seed, std::uint32_t clip, double rate_hz, Ways ways) {
  return std::make_unique<ObjectScene>(seed, clip, rate_hz, ways);
}

}  // namespace csipose::sim
