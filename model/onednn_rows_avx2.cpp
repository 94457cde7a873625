// Row operations for avx2; its flags are in CMakeLists.txt.
#define CSIPOSE_ROW_LANES 8
#define CSIPOSE_ROW_NAME "avx2"
#define CSIPOSE_ROW_KERNELS kRowKernels_avx2
#include "model/onednn_rows_body.h"
