// sim/scene_file.h - one stated scene as JSON; docs/simulator-scene.md has every key.
#pragma once

#include <filesystem>
#include <string_view>

#include "sim/scene.h"

namespace csipose::sim {

/// Throws SetupError (bad_data) that names the file, the place in it ("bodies[2].mat") and what would be
/// right: unknown keys and names, wrong types, devices outside the room, bodies that reach through a wall.
Scene parse_scene(std::string_view text, const std::string& file_name);
/// The same from a file; SetupError (no_input) when it cannot be read.
Scene read_scene(const std::filesystem::path& file);

}  // namespace csipose::sim
