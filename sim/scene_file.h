// sim/scene_file.h - stated scenes and rooms as JSON; docs/simulator-scene.md and docs/simulator-rooms.md have every key.
#pragma once

#include <filesystem>
#include <string_view>

#include "sim/people.h"
#include "sim/scene.h"

namespace csipose::sim {

/// Throws SetupError (bad_data) that names the file, the place in it ("bodies[2].mat") and what would be
/// right: unknown keys and names, wrong types, devices outside the room, bodies that reach through a wall.
Scene parse_scene(std::string_view text, const std::string& file_name);
/// The same from a file; SetupError (no_input) when it cannot be read.
Scene read_scene(const std::filesystem::path& file);

/// A room that people walk about in.
struct RoomPlan {
  std::string name;
  Scene still;     ///< walls, devices, furniture
  Rectangle area;  ///< where people may be
};
/// Throws SetupError as above; also for furniture in a device's place and for an area that reaches through a wall.
RoomPlan parse_room(std::string_view text, const std::string& file_name);
/// One of the rooms that come with the program, by name, or a file.
RoomPlan read_room_plan(const std::string& name_or_file);

}  // namespace csipose::sim
