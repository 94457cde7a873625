// A mesh file of any content is read or refused in words. The first byte chooses the format.
#include <cstddef>
#include <cstdint>

#include "proto/result.h"
#include "sim/mesh_file.h"

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  using namespace csipose::sim;
  if (size == 0) return 0;
  const std::string_view bytes{reinterpret_cast<const char*>(data) + 1, size - 1};
  try {
    (data[0] == 'o' ? parse_obj : parse_ply)(bytes, "mesh",
                                             {.scale = 1, .material = "wood", .materials = {}});
  } catch (const csipose::SetupError&) {
  }
  return 0;
}
