#include "daemon/allocation.h"

#include <gtest/gtest.h>

#include <cerrno>
#include <cstdint>
#include <cstdlib>
#include <cstring>
#include <memory>
#include <string>
#include <thread>
#include <vector>

namespace csipose {
namespace {

#define NEEDS_OUR_OPERATOR_NEW() \
  if (!kLoopAllocatorActive) GTEST_SKIP() << "left out: a sanitizer's own operator new is in use"

/// What one run of a primitive does: a few small objects, freed in another order.
void make_and_free_small_objects() {
  std::vector<std::unique_ptr<char[]>> objects;
  objects.reserve(8);
  for (std::size_t size : {1, 16, 24, 25, 104, 264, 304, 520}) {
    objects.push_back(std::make_unique<char[]>(size));
    std::memset(objects.back().get(), 0x5a, size);
  }
  std::swap(objects[0], objects[7]);
}

/// Done once, it asks malloc for nothing when it is done again, though it makes so many requests.
template <class Work>
void expect_served_from_lists(const Work& work, std::uint64_t requests) {
  work();
  const AllocationCounts before = allocations_of_this_thread();
  for (int i = 0; i < 1000; ++i) work();
  const AllocationCounts after = allocations_of_this_thread();
  EXPECT_EQ(after.requests - before.requests, 1000 * requests);
  EXPECT_EQ(after.from_malloc - before.from_malloc, 0u);
}

TEST(LoopAllocator, ServesARepeatedPatternFromItsLists) {
  NEEDS_OUR_OPERATOR_NEW();
  expect_served_from_lists(make_and_free_small_objects, 9);
}

TEST(LoopAllocator, CountsWhatItMustTakeFromMalloc) {
  NEEDS_OUR_OPERATOR_NEW();
  const std::uint64_t before = allocations_from_malloc();
  for (int i = 0; i < 10; ++i) std::make_unique<char[]>(4096);
  EXPECT_EQ(allocations_from_malloc() - before, 10u);
}

TEST(LoopAllocator, BlocksOfOneSizeAreDistinctAndKeepTheirBytes) {
  for (std::size_t size = 1; size <= 600; ++size) {
    std::vector<std::string> texts;
    for (char c = 'a'; c <= 'z'; ++c) texts.push_back(std::string(size, c));
    for (char c = 'a'; c <= 'z'; ++c)
      EXPECT_EQ(texts[static_cast<std::size_t>(c - 'a')], std::string(size, c));
  }
}

TEST(LoopAllocator, BlocksMayBeFreedByAnotherThread) {
  std::vector<std::unique_ptr<int>> made;
  std::thread([&] {
    for (int i = 0; i < 1000; ++i) made.push_back(std::make_unique<int>(i));
  }).join();
  for (int i = 0; i < 1000; ++i) EXPECT_EQ(*made[static_cast<std::size_t>(i)], i);
  made.clear();
}

/// Freed with what frees any block.
std::unique_ptr<void, decltype(&std::free)> page_aligned(std::size_t size) {
  void* memory = nullptr;
  EXPECT_EQ(posix_memalign(&memory, 4096, size), 0);
  EXPECT_EQ(reinterpret_cast<std::uintptr_t>(memory) % 4096, 0u);
  std::memset(memory, 0x5a, size);
  return {memory, &std::free};
}

TEST(LoopAllocator, ServesPageAlignedBlocksAgain) {
  NEEDS_OUR_OPERATOR_NEW();
  expect_served_from_lists(
      [] {
        const auto large = page_aligned(300'000), small = page_aligned(16'640);
        EXPECT_NE(large, small);
      },
      2);
}

TEST(LoopAllocator, KeepsFewPageAlignedBlocksTheLargestButNoneThatIsHuge) {
  NEEDS_OUR_OPERATOR_NEW();
  std::vector<std::unique_ptr<void, decltype(&std::free)>> blocks;
  blocks.reserve(40);
  const auto taken_from_malloc = [&](int count, std::size_t size) {
    const std::uint64_t before = allocations_of_this_thread().from_malloc;
    for (int i = 0; i < count; ++i) blocks.push_back(page_aligned(size));
    const std::uint64_t taken = allocations_of_this_thread().from_malloc - before;
    blocks.clear();
    return taken;
  };
  taken_from_malloc(20, 400'000);
  EXPECT_EQ(taken_from_malloc(20, 400'000), 12u);
  taken_from_malloc(20, 8192);  // are not kept where larger ones are
  EXPECT_EQ(taken_from_malloc(20, 400'000), 12u);
  EXPECT_EQ(taken_from_malloc(1, 2 << 20), 1u);
  EXPECT_EQ(taken_from_malloc(1, 2 << 20), 1u);
}

TEST(LoopAllocator, OtherAlignmentsAreGivenToo) {
  NEEDS_OUR_OPERATOR_NEW();
  for (std::size_t alignment = sizeof(void*); alignment <= 65536; alignment *= 2) {
    void* memory = nullptr;
    ASSERT_EQ(posix_memalign(&memory, alignment, 100), 0);
    EXPECT_EQ(reinterpret_cast<std::uintptr_t>(memory) % alignment, 0u);
    std::free(memory);
  }
  void* memory = nullptr;
  EXPECT_EQ(posix_memalign(&memory, 24, 100), EINVAL);
}

TEST(LoopAllocator, PageAlignedBlocksMayBeFreedByAnotherThread) {
  for (int i = 0; i < 100; ++i) {
    auto block = page_aligned(5000);
    std::thread([&] { block.reset(); }).join();
  }
}

}  // namespace
}  // namespace csipose
