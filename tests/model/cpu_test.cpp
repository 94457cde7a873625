#include "model/cpu.h"

#include <gtest/gtest.h>

#include <cstdlib>
#include <limits>
#include <string>
#include <thread>

namespace csipose {
namespace {

TEST(Cpu, LargerUnitsImplySmallerOnes) {
  const CpuFeatures cpu = cpu_features();
  EXPECT_TRUE(!cpu.amx || cpu.avx512_bf16);
  EXPECT_TRUE(!cpu.avx512_bf16 || cpu.avx512_vnni);
  EXPECT_TRUE(!cpu.avx512_vnni || cpu.avx512);
  EXPECT_TRUE(!cpu.avx512 || cpu.avx2);
}

// ctest runs this program once for each limit.
TEST(Cpu, ObeysTheLimitOfTheEnvironment) {
  const char* limit = std::getenv("ONEDNN_MAX_CPU_ISA");
  if (limit == nullptr) GTEST_SKIP() << "ONEDNN_MAX_CPU_ISA is not set";
  const CpuFeatures cpu = cpu_features();
  EXPECT_FALSE(std::string(limit) == "AVX2" && cpu.avx512) << to_string(cpu);
  EXPECT_FALSE(std::string(limit) == "AVX512_CORE" && cpu.avx512_vnni) << to_string(cpu);
  EXPECT_FALSE(std::string(limit) == "AVX512_CORE_VNNI" && cpu.avx512_bf16) << to_string(cpu);
}

TEST(Cpu, DenormalsBecomeZeroInLaterThreadsToo) {
  const auto half_of_least = [] {
    volatile float least = std::numeric_limits<float>::min();
    return least / 2;
  };
  std::thread([&] {
    EXPECT_GT(half_of_least(), 0.f);
    prepare_process_for_inference();
    EXPECT_EQ(half_of_least(), 0.f);
    std::thread([&] { EXPECT_EQ(half_of_least(), 0.f); }).join();
  }).join();
}

}  // namespace
}  // namespace csipose
