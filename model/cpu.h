// model/cpu.h - what this processor offers to inference, and how a process must be set up before it infers.
#pragma once

#include <string>

namespace csipose {

/// Units that the engine makes use of. What the kernel or ONEDNN_MAX_CPU_ISA keeps from oneDNN counts as
/// absent, so that the engine and the library always speak of the same machine.
struct CpuFeatures {
  bool avx2 = false;
  bool avx512 = false;       ///< F, BW, VL, DQ: oneDNN's avx512_core
  bool avx512_vnni = false;  ///< int8 dot products that do not saturate
  bool avx512_bf16 = false;  ///< bf16 dot products
  bool amx = false;          ///< tiles, bf16 and int8
  /// The processor has AMX but the kernel (or a too small alternate signal stack) keeps it from this process.
  bool amx_refused = false;
};
CpuFeatures cpu_features();
/// "avx2 avx512 avx512_vnni", for people.
std::string to_string(const CpuFeatures& features);

/// Makes the calling thread treat denormal numbers as zero (a product of denormals costs a hundred times a
/// normal one). Threads inherit this from the thread that starts them and existing ones do not: call it first
/// in main().
void prepare_process_for_inference();

/// Lets threads of OpenMP that wait for each other spin for microseconds only, then sleep. libgomp's own bound is a hundred times
/// as long, and where other programs want the processors too, a thread that spins keeps the one that it waits for from running
/// (docs/performance.md). libgomp reads its settings when it is loaded: the program starts once more, with GOMP_SPINCOUNT in its
/// environment, unless that or OMP_WAIT_POLICY is there already. To be called before anything is open or begun; where the
/// program cannot start again, nothing changes.
void bound_spinning();

}  // namespace csipose
