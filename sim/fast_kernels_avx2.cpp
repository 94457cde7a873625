// The inner loops for AVX2 with FMA; CMakeLists.txt has the flags.
#define CSIPOSE_KERNELS kKernels_avx2
#define CSIPOSE_KERNELS_NAME "avx2"
#include "sim/fast_kernels.inc"
