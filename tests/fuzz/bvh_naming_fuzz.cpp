// A table of joints of any content is read or refused in words.
#include <cstddef>
#include <cstdint>

#include "proto/result.h"
#include "sim/bvh_naming.h"

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  try {
    csipose::sim::parse_namings({reinterpret_cast<const char*>(data), size}, "joints.json");
  } catch (const csipose::SetupError&) {
  }
  return 0;
}
