// tests/sim/golden_scene.h - rooms, bodies and scenes as the golden files state them.
#pragma once

#include <glm/gtc/quaternion.hpp>

#include "sim/material.h"
#include "sim/scene.h"
#include "tests/sim/golden.h"

namespace csipose::sim {

inline Vec3 vec3(const nlohmann::json& j) {
  return {j[0].get<double>(), j[1].get<double>(), j[2].get<double>()};
}

/// As a wall of `thickness_m`, or as a body where that is 0.
inline Surface surface_of(const std::string& material, double thickness_m = 0) {
  return {find_material(material)->permittivity(5.64e9), thickness_m};
}

inline Room room_of(const nlohmann::json& j) {
  Room room;
  room.size_m = vec3(j["L"]);
  for (std::size_t w = 0; w < kWalls; ++w) {
    const auto& wall = j["materials"][std::string(kWallNames[w])];
    room.walls[w] = surface_of(wall["name"].get<std::string>(), wall["thickness"].get<double>());
  }
  return room;
}

/// A body of bodies.json: rot holds the rows of the matrix whose columns are the body's axes.
inline Body body_of(const nlohmann::json& j) {
  Body body;
  body.centre = vec3(j["c"]);
  for (int row = 0; row < 3; ++row)
    for (int column = 0; column < 3; ++column) body.axes[column][row] = j["rot"][row][column].get<double>();
  body.surface = surface_of(j["material"].get<std::string>());
  const std::string kind = j["kind"].get<std::string>();
  if (kind == "ellipsoid") body.shape = Shape::ellipsoid, body.half_m = vec3(j["axes"]);
  if (kind == "box") body.shape = Shape::box, body.half_m = vec3(j["half"]);
  if (kind == "cylinder") {
    body.shape = Shape::cylinder;
    body.half_m = {j["r"].get<double>(), j["r"].get<double>(), j["hh"].get<double>()};
  }
  return body;
}

inline Body sphere(const Vec3& centre, double radius_m, const std::string& material) {
  return {Shape::ellipsoid, centre, Mat3{1}, Vec3{radius_m}, surface_of(material)};
}

}  // namespace csipose::sim
