#include "sim/fast_kernels.h"

#include <cstdlib>

namespace csipose::sim {

extern const FastKernels kKernels_plain, kKernels_avx2, kKernels_avx512;

const FastKernels* find_kernels(std::string_view name) {
#if defined(__x86_64__)
  const bool avx512 = __builtin_cpu_supports("avx512f") && __builtin_cpu_supports("avx512vl") &&
                      __builtin_cpu_supports("avx512bw") && __builtin_cpu_supports("avx512dq");
  if (name == "avx512" && avx512) return &kKernels_avx512;
  if (name == "avx2" && __builtin_cpu_supports("avx2") && __builtin_cpu_supports("fma"))
    return &kKernels_avx2;
#endif
  return name == "plain" ? &kKernels_plain : nullptr;
}

const FastKernels& best_kernels() {
  if (const char* lower = std::getenv("CSIPOSE_SIM_ISA"))
    if (const FastKernels* kernels = find_kernels(lower)) return *kernels;
  for (const char* name : {"avx512", "avx2"})
    if (const FastKernels* kernels = find_kernels(name)) return *kernels;
  return kKernels_plain;
}

}  // namespace csipose::sim
