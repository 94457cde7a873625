// A scene file of any content is read or refused in words.
#include <cstddef>
#include <cstdint>

#include "proto/result.h"
#include "sim/scene_file.h"

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  try {
    csipose::sim::parse_scene({reinterpret_cast<const char*>(data), size}, "scene.json");
  } catch (const csipose::SetupError&) {
  }
  return 0;
}
