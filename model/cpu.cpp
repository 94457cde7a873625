#include "model/cpu.h"

#include <cpuid.h>
#include <immintrin.h>
#include <oneapi/dnnl/dnnl.h>
#include <unistd.h>

#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <vector>

namespace csipose {
namespace {

constexpr const char* kSpins = "2000";  // some microseconds: longer than between two regions of a window
constexpr unsigned kFlushToZero = 1u << 15,
                   kDenormalsAreZero = 1u << 6;  // MXCSR; source: Intel SDM vol. 1, 10.2.3

bool has(dnnl_cpu_isa_t offered, dnnl_cpu_isa_t wanted) { return (offered & wanted) == wanted; }

bool processor_has_amx() {
  constexpr unsigned kAmxTile = 1u << 24;  // CPUID leaf 7, EDX; source: Intel SDM vol. 2A, CPUID
  unsigned eax = 0, ebx = 0, ecx = 0, edx = 0;
  return __get_cpuid_count(7, 0, &eax, &ebx, &ecx, &edx) != 0 && (edx & kAmxTile) != 0;
}

/// The person limited oneDNN to less than AMX.
bool amx_switched_off(dnnl_cpu_isa_t offered) { return !has(offered, dnnl_cpu_isa_avx512_core_bf16); }

}  // namespace

CpuFeatures cpu_features() {
  const dnnl_cpu_isa_t offered = dnnl_get_effective_cpu_isa();
  CpuFeatures features;
  features.avx2 = has(offered, dnnl_cpu_isa_avx2);
  features.avx512 = has(offered, dnnl_cpu_isa_avx512_core);
  features.avx512_vnni = has(offered, dnnl_cpu_isa_avx512_core_vnni);
  features.avx512_bf16 = has(offered, dnnl_cpu_isa_avx512_core_bf16);
  features.amx = has(offered, dnnl_cpu_isa_avx512_core_amx);
  features.amx_refused = processor_has_amx() && !features.amx && !amx_switched_off(offered);
  return features;
}

std::string to_string(const CpuFeatures& features) {
  std::string words;
  const auto add = [&](bool there, const char* name) {
    if (there) words.append(words.empty() ? "" : " ").append(name);
  };
  add(features.avx2, "avx2");
  add(features.avx512, "avx512");
  add(features.avx512_vnni, "avx512_vnni");
  add(features.avx512_bf16, "avx512_bf16");
  add(features.amx, "amx");
  add(features.amx_refused, "(amx present but refused)");
  return words.empty() ? "sse" : words;
}

void bound_spinning() {
  if (std::getenv("GOMP_SPINCOUNT") != nullptr || std::getenv("OMP_WAIT_POLICY") != nullptr) return;
  std::error_code unreadable;
  const std::string program = std::filesystem::read_symlink("/proc/self/exe", unreadable).string();
  std::ifstream command_line("/proc/self/cmdline", std::ios::binary);
  std::vector<std::string> words;
  for (std::string word; std::getline(command_line, word, '\0');) words.push_back(word);
  if (unreadable || words.empty()) return;
  std::vector<char*> arguments;
  for (std::string& word : words) arguments.push_back(word.data());
  arguments.push_back(nullptr);
  setenv("GOMP_SPINCOUNT", kSpins, 1);
  execv(program.c_str(), arguments.data());
}

void prepare_process_for_inference() { _mm_setcsr(_mm_getcsr() | kFlushToZero | kDenormalsAreZero); }

}  // namespace csipose
