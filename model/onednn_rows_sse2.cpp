// Row operations for sse2; its flags are in CMakeLists.txt.
#define CSIPOSE_ROW_LANES 4
#define CSIPOSE_ROW_NAME "sse2"
#define CSIPOSE_ROW_KERNELS kRowKernels_sse2
#include "model/onednn_rows_body.h"
