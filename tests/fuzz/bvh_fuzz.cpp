// A motion capture file of any content is a person who moves, or is refused in words.
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <cstdlib>

#include "proto/result.h"
#include "sim/captured_motion.h"

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  using namespace csipose::sim;
  try {
    const BvhClip clip = parse_bvh({reinterpret_cast<const char*>(data), size}, "motion.bvh");
    const Landmarks landmarks = find_landmarks(clip, built_in_namings());
    const CapturedMotion person(clip, landmarks, {}, CounterRng(1, Purpose::persons, 0, 0, 0));
    for (const double t : {0.0, person.seconds() / 3, 1e9})
      for (const Vec3& joint : joints_of(person.figure(), person.at(t)))
        if (!std::isfinite(joint.x + joint.y + joint.z)) std::abort();
  } catch (const csipose::SetupError&) {
  }
  return 0;
}
