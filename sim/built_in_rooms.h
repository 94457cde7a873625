// sim/built_in_rooms.h - the files of sim/rooms/, built into the program.
#pragma once

#include <span>
#include <string_view>

namespace csipose::sim {

struct BuiltInRoom {
  std::string_view name, json;
};
std::span<const BuiltInRoom> built_in_rooms();

}  // namespace csipose::sim
