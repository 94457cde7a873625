// The inner loops for any processor; CMakeLists.txt has the flags.
#define CSIPOSE_KERNELS kKernels_plain
#define CSIPOSE_KERNELS_NAME "plain"
#include "sim/fast_kernels.inc"
