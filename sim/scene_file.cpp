#include "sim/scene_file.h"

#include <fmt/core.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <cmath>
#include <glm/gtc/quaternion.hpp>

#include "proto/result.h"
#include "sim/built_in_rooms.h"
#include "sim/json_file.h"
#include "sim/material.h"

namespace csipose::sim {
namespace {
const Material& material_at(const JsonNode& node) {
  const std::string name = node.text();
  if (const Material* found = find_material(name)) return *found;
  std::vector<std::string_view> known;
  for (const Material& material : materials()) known.push_back(material.name);
  node.refuse(fmt::format("there is no material '{}'; there are {}", name, fmt::join(known, ", ")));
}

Surface wall_at(const JsonNode& node, double carrier_hz) {
  node.allow_only({"name", "thickness"});
  const Material& material = material_at(node.at("name"));
  const double thickness_m = node.has("thickness") ? node.at("thickness").number_in(0, 10) : material.slab_m;
  return {material.permittivity(carrier_hz), thickness_m};
}

void read_room(const JsonNode& root, Scene& scene) {
  scene.walls = root.has("L");
  if (!scene.walls) {
    if (root.has("materials")) root.refuse("has materials of walls but no room size 'L'");
    return;
  }
  scene.room.size_m = root.at("L").vec3();
  if (glm::any(glm::lessThan(scene.room.size_m, Vec3{0.1})))
    root.at("L").refuse("each side must be at least 0.1 m");
  const JsonNode walls = root.at("materials");
  walls.allow_only({"x0", "x1", "y0", "y1", "z0", "z1"});
  for (std::size_t w = 0; w < kWalls; ++w)
    scene.room.walls[w] = wall_at(walls.at(std::string(kWallNames[w]).c_str()), scene.carrier_hz);
}

/// `margin_m`: how far the thing at `p` reaches.
void check_inside(const JsonNode& node, const Scene& scene, const Vec3& p, const Vec3& margin_m,
                  const char* what) {
  if (!scene.walls) return;
  if (glm::any(glm::lessThan(p, margin_m)) || glm::any(glm::greaterThan(p, scene.room.size_m - margin_m)))
    node.refuse(fmt::format("{} at ({:.3f}, {:.3f}, {:.3f}) is not inside the room of {} x {} x {} m", what,
                            p.x, p.y, p.z, scene.room.size_m.x, scene.room.size_m.y, scene.room.size_m.z));
}

void read_antennas(const JsonNode& root, Scene& scene) {
  const std::string pattern_name = root.has("pattern") ? root.at("pattern").text() : "hw_dipole";
  const auto pattern = find_pattern(pattern_name);
  if (!pattern)
    root.at("pattern").refuse(
        fmt::format("there is no pattern '{}'; there are iso, dipole, hw_dipole", pattern_name));
  const double spacing_m =
      root.has("spacing") ? root.at("spacing").number_in(0, 1) : scene.wavelength_m() / 2;
  const int antennas =
      root.has("antennas") ? root.at("antennas").integer_in(1, 64) : static_cast<int>(kAntennas);
  const Vec3 tx_axis = root.has("tx_axis") ? root.at("tx_axis").direction() : Vec3{0, 0, 1};
  scene.transmitter = {root.at("tx").vec3(), tx_axis, *pattern};
  check_inside(root.at("tx"), scene, scene.transmitter.position, Vec3{1e-6}, "the transmitter");
  for (const JsonNode& rx : root.at("rx").list()) {
    rx.allow_only({"center", "axis"});
    const Vec3 centre = rx.at("center").vec3(), along = antennas > 1 ? rx.at("axis").direction() : Vec3{0};
    scene.receivers.emplace_back();
    for (int a = 0; a < antennas; ++a) {
      const Vec3 position = centre + (a - (antennas - 1) / 2.0) * spacing_m * along;
      check_inside(rx, scene, position, Vec3{1e-6}, "an antenna");
      scene.receivers.back().push_back({position, {0, 0, 1}, *pattern});
    }
  }
  if (scene.receivers.empty()) root.at("rx").refuse("needs at least one receiver");
}

/// Unit quaternion x, y, z, w; need not be normalised in the file.
Mat3 rotation_at(const JsonNode& node) {
  const auto q = node.list();
  if (q.size() != 4) node.refuse("must have four numbers x, y, z, w");
  const glm::dquat quaternion(q[3].number(), q[0].number(), q[1].number(), q[2].number());
  if (glm::length(quaternion) < 1e-9) node.refuse("must not be zero: it is a rotation");
  return glm::mat3_cast(glm::normalize(quaternion));
}

void read_shape(const JsonNode& node, Body& body) {
  const std::string kind = node.at("kind").text();
  const auto metres = [&](const char* key) { return node.at(key).number_in(0.005, 20); };
  const auto three_metres = [&](const char* key) {
    const Vec3 half = node.at(key).vec3();
    if (glm::any(glm::lessThan(half, Vec3{0.005}))) node.at(key).refuse("each must be at least 0.005 m");
    return half;
  };
  if (kind == "sphere") {
    node.allow_only({"kind", "c", "r", "q", "mat", "v", "name"});
    body.half_m = Vec3{metres("r")};
  } else if (kind == "ellipsoid") {
    node.allow_only({"kind", "c", "axes", "q", "mat", "v", "name"});
    body.half_m = three_metres("axes");
  } else if (kind == "box") {
    node.allow_only({"kind", "c", "h", "q", "mat", "v", "name"});
    body.shape = Shape::box;
    body.half_m = three_metres("h");
  } else if (kind == "cylinder") {
    node.allow_only({"kind", "c", "r", "hh", "q", "mat", "v", "name"});
    body.shape = Shape::cylinder;
    body.half_m = {metres("r"), metres("r"), metres("hh")};
  } else {
    node.at("kind").refuse(
        fmt::format("there is no kind '{}'; there are sphere, ellipsoid, box, cylinder, mesh", kind));
  }
}

Body still_body_at(const JsonNode& node, const Scene& scene) {
  Body body;
  read_shape(node, body);
  body.centre = node.at("c").vec3();
  if (node.has("q")) body.axes = rotation_at(node.at("q"));
  body.surface = {material_at(node.at("mat")).permittivity(scene.carrier_hz), 0};
  return body;
}
Vec3 reach_of(const Body& body) {
  return {body.support_m({1, 0, 0}), body.support_m({0, 1, 0}), body.support_m({0, 0, 1})};
}

MeshUse mesh_use_at(const JsonNode& node) {
  MeshUse use{node.at("file").text(), {}};
  if (node.has("scale")) use.import.scale = node.at("scale").number_in(1e-6, 1e3);
  if (node.has("mat")) use.import.material = std::string(material_at(node.at("mat")).name);
  return use;
}

/// A room or furniture: walls as thick as their materials usually are.
void read_still_mesh(const JsonNode& node, Scene& scene) {
  node.allow_only({"file", "scale", "mat", "materials", "name"});
  MeshUse use = mesh_use_at(node);
  if (node.has("materials"))
    for (const auto& [theirs, ours] : node.at("materials").items())
      use.import.materials[theirs] = std::string(material_at(ours).name);
  scene.mesh_uses.push_back(use);
}

void read_mesh_body(const JsonNode& node, Scene& scene) {
  node.allow_only({"kind", "file", "scale", "c", "q", "mat", "v", "name"});
  MeshBody body;
  body.use = mesh_use_at(node);
  body.use.import.only_material = true;
  body.surface = {material_at(node.at("mat")).permittivity(scene.carrier_hz), 0};
  body.origin = node.at("c").vec3();
  if (node.has("q")) body.axes = rotation_at(node.at("q"));
  if (node.has("v")) body.velocity_m_s = node.at("v").vec3();
  scene.mesh_bodies.push_back(body);
}

void read_body(const JsonNode& node, Scene& scene) {
  if (node.has("kind") && node.at("kind").text() == "mesh") return read_mesh_body(node, scene);
  MovingBody moving{still_body_at(node, scene)};
  if (node.has("v")) moving.velocity_m_s = node.at("v").vec3();
  for (const int snapshot : {0, scene.snapshots - 1})
    check_inside(node, scene, moving.at(snapshot * scene.step_s).centre, reach_of(moving.start),
                 fmt::format("the body in snapshot {}", snapshot).c_str());
  scene.bodies.push_back(moving);
}

/// Whether p lies in the box around the body, or nearer to it than `margin_m`.
bool is_near(const Body& body, const Vec3& p, double margin_m) {
  const Vec3 off = glm::abs(p - body.centre), reach = reach_of(body) + margin_m;
  return off.x < reach.x && off.y < reach.y && off.z < reach.z;
}

void read_furniture(const JsonNode& node, Scene& scene) {
  if (node.has("v")) node.refuse("has a velocity 'v'; furniture stands still");
  const Body body = still_body_at(node, scene);
  check_inside(node, scene, body.centre, reach_of(body), "this piece of furniture");
  constexpr double kClear_m = 0.02;
  if (is_near(body, scene.transmitter.position, kClear_m)) node.refuse("the transmitter stands in it");
  for (std::size_t r = 0; r < scene.receivers.size(); ++r)
    for (const Antenna& antenna : scene.receivers[r])
      if (is_near(body, antenna.position, kClear_m))
        node.refuse(fmt::format("receiver {} stands in it", r + 1));
  scene.furniture.push_back(body);
}

Rectangle area_at(const JsonNode& node, const Scene& scene) {
  const auto sides = node.list();
  if (sides.size() != 4) node.refuse("must have four numbers x0, y0, x1, y1");
  const Rectangle area{sides[0].number(), sides[1].number(), sides[2].number(), sides[3].number()};
  const Vec3& room = scene.room.size_m;
  if (area.x0 < 0 || area.y0 < 0 || area.x1 > room.x || area.y1 > room.y)
    node.refuse(fmt::format("reaches beyond the room of {} x {} m", room.x, room.y));
  constexpr double kLeast_m = 1.5;
  if (area.x1 - area.x0 < kLeast_m || area.y1 - area.y0 < kLeast_m)
    node.refuse(
        fmt::format("must be at least {} x {} m: people keep {} m inside it", kLeast_m, kLeast_m, kInside_m));
  return area;
}

void read_tones(const JsonNode& root, Scene& scene) {
  scene.tones = intel5300_tones();
  if (!root.has("subcarriers")) return;
  scene.tones.clear();
  for (const JsonNode& tone : root.at("subcarriers").list()) scene.tones.push_back(tone.number_in(-1e4, 1e4));
  if (scene.tones.empty()) root.at("subcarriers").refuse("needs at least one number");
}

void read_time(const JsonNode& root, Scene& scene) {
  if (root.has("rate") && root.has("dt")) root.refuse("has both 'rate' and 'dt'; give one");
  if (root.has("rate")) scene.step_s = 1 / root.at("rate").number_in(0.1, 1e6);
  if (root.has("dt")) scene.step_s = root.at("dt").number_in(1e-6, 10);
  scene.snapshots =
      root.has("snapshots") ? root.at("snapshots").integer_in(1, 100'000) : static_cast<int>(kSamples);
}

void read_orders(const JsonNode& root, Scene& scene) {
  if (root.has("order")) scene.wall_order = root.at("order").integer_in(0, 8);
  if (root.has("pairs") && root.has("object_wall_order"))
    root.refuse("has both 'pairs' and 'object_wall_order'; give one");
  if (root.has("object_wall_order")) {
    constexpr std::array<int, 3> kPairs{1, 13, 49};
    scene.pairs = kPairs[static_cast<std::size_t>(root.at("object_wall_order").integer_in(0, 2))];
  }
  if (root.has("pairs")) {
    scene.pairs = root.at("pairs").integer_in(1, 49);
    if (scene.pairs != 1 && scene.pairs != 13 && scene.pairs != 49)
      root.at("pairs").refuse("must be 1, 13 or 49");
  }
}

void read_clutter(const JsonNode& root, Scene& scene) {
  if (!root.has("clutter")) return;
  const JsonNode node = root.at("clutter");
  node.allow_only({"s", "pattern", "alpha", "alpha_back", "lambda", "seed"});
  if (!scene.walls) node.refuse("needs walls: give the room's size 'L'");
  Clutter clutter;
  clutter.scattering = node.at("s").number_in(0, 1);
  const std::string pattern = node.has("pattern") ? node.at("pattern").text() : "directive";
  if (pattern == "lambertian")
    clutter.pattern = ScatterPattern::lambertian;
  else if (pattern == "backscatter")
    clutter.pattern = ScatterPattern::backscatter;
  else if (pattern != "directive")
    node.at("pattern").refuse(
        fmt::format("there is no pattern '{}'; there are lambertian, directive, backscatter", pattern));
  if (node.has("alpha")) clutter.forward_exponent = node.at("alpha").integer_in(1, 20);
  if (node.has("alpha_back")) clutter.backward_exponent = node.at("alpha_back").integer_in(1, 20);
  if (node.has("lambda")) clutter.forward_share = node.at("lambda").number_in(0, 1);
  if (node.has("seed"))
    clutter.seed = static_cast<std::uint64_t>(node.at("seed").integer_in(0, 1'000'000'000));
  scene.set_clutter(clutter);
}

}  // namespace

Scene parse_scene(std::string_view text, const std::string& file_name) {
  const JsonFile file(text, file_name);
  const JsonNode root = file.root();
  root.allow_only({"name", "fc", "dt", "rate", "snapshots", "order", "object_wall_order", "pairs", "pattern",
                   "spacing", "antennas", "subcarriers", "L", "materials", "tx", "tx_axis", "rx", "bodies",
                   "meshes", "clutter",
                   // results that a scene may carry with it; not read
                   "rms", "dynamic_rms", "paths_t0_rx0_ant0"});
  Scene scene;
  if (root.has("fc")) scene.carrier_hz = root.at("fc").number_in(1e9, 1e11);
  read_time(root, scene);
  read_orders(root, scene);
  read_tones(root, scene);
  read_room(root, scene);
  read_clutter(root, scene);
  read_antennas(root, scene);
  if (root.has("bodies"))
    for (const JsonNode& body : root.at("bodies").list()) read_body(body, scene);
  if (root.has("meshes"))
    for (const JsonNode& mesh : root.at("meshes").list()) read_still_mesh(mesh, scene);
  return scene;
}

Scene read_scene(const std::filesystem::path& file) {
  return parse_scene(read_text_file(file, "scene"), file.string());
}

RoomPlan parse_room(std::string_view text, const std::string& file_name) {
  const JsonFile file(text, file_name);
  const JsonNode root = file.root();
  root.allow_only({"name", "what", "fc", "pattern", "spacing", "L", "materials", "tx", "tx_axis", "rx",
                   "area", "clutter", "furniture"});
  RoomPlan plan;
  plan.name = root.at("name").text();
  Scene& scene = plan.still;
  if (root.has("fc")) scene.carrier_hz = root.at("fc").number_in(1e9, 1e11);
  scene.tones = intel5300_tones();
  root.at("L");  // a room has walls
  read_room(root, scene);
  read_antennas(root, scene);
  if (scene.receivers.size() != kReceivers)
    root.at("rx").refuse(
        fmt::format("has {} receivers; the system has {}", scene.receivers.size(), kReceivers));
  read_clutter(root, scene);
  plan.area = area_at(root.at("area"), scene);
  if (root.has("furniture"))
    for (const JsonNode& piece : root.at("furniture").list()) read_furniture(piece, scene);
  return plan;
}

RoomPlan read_room_plan(const std::string& name_or_file) {
  for (const BuiltInRoom& room : built_in_rooms())
    if (room.name == name_or_file) return parse_room(room.json, "the room '" + name_or_file + "'");
  if (name_or_file.find_first_of("./") == std::string::npos && !std::filesystem::exists(name_or_file)) {
    std::vector<std::string_view> known;
    for (const BuiltInRoom& room : built_in_rooms()) known.push_back(room.name);
    throw SetupError(ExitStatus::no_input,
                     fmt::format("there is no room '{}'; there are {}, or give a room's file", name_or_file,
                                 fmt::join(known, ", ")));
  }
  return parse_room(read_text_file(name_or_file, "room"), name_or_file);
}

}  // namespace csipose::sim
