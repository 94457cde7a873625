// The inner loops for AVX-512 (F, VL, BW, DQ); CMakeLists.txt has the flags.
#define CSIPOSE_KERNELS kKernels_avx512
#define CSIPOSE_KERNELS_NAME "avx512"
#include "sim/fast_kernels.inc"
