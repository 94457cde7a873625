// sim/mesh_scene.h - stated scenes whose rooms, furniture or bodies are meshes.
#pragma once

#include <filesystem>

#include "sim/mesh_paths.h"
#include "sim/scene.h"

namespace csipose::sim {

/// Bodies' faces are cut to this: what physical optics needs at a radius of 0.3 m.
inline constexpr double kBodyFacet_m = 0.03;

/// Reads every mesh that the scene names, relative to `folder`, and makes of rooms and furniture the surfaces that solvers take;
/// walls of a shoebox, if it has any, are among them. Throws SetupError (bad_data) for what mesh_file.h refuses, for a body
/// that is not closed, for a device that is not indoors, and for more chains of polygons than kMostChains.
void read_meshes(Scene& scene, const std::filesystem::path& folder);

/// read_scene() with its meshes.
Scene read_scene_with_meshes(const std::filesystem::path& file);

}  // namespace csipose::sim
