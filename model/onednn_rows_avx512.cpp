// Row operations for avx512; its flags are in CMakeLists.txt.
#define CSIPOSE_ROW_LANES 16
#define CSIPOSE_ROW_NAME "avx512"
#define CSIPOSE_ROW_KERNELS kRowKernels_avx512
#include "model/onednn_rows_body.h"
