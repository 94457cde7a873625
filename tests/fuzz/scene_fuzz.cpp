// A scene or room file of any content is read or refused in words.
#include <cstddef>
#include <cstdint>

#include "proto/result.h"
#include "sim/scene_file.h"

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  const std::string_view text(reinterpret_cast<const char*>(data), size);
  try {
    csipose::sim::parse_room(text, "room.json");
  } catch (const csipose::SetupError&) {
  }
  try {
    csipose::sim::parse_scene(text, "scene.json");
  } catch (const csipose::SetupError&) {
  }
  return 0;
}
