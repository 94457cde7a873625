#include "daemon/allocation.h"

#include <gtest/gtest.h>

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
  for (std::size_t size : {1, 16, 24, 25, 40, 104, 200, 264}) {
    objects.push_back(std::make_unique<char[]>(size));
    std::memset(objects.back().get(), 0x5a, size);
  }
  std::swap(objects[0], objects[7]);
}

TEST(LoopAllocator, ServesARepeatedPatternFromItsLists) {
  NEEDS_OUR_OPERATOR_NEW();
  make_and_free_small_objects();
  const AllocationCounts before = allocations_of_this_thread();
  for (int i = 0; i < 1000; ++i) make_and_free_small_objects();
  const AllocationCounts after = allocations_of_this_thread();
  EXPECT_EQ(after.requests - before.requests, 9000u);
  EXPECT_EQ(after.from_malloc - before.from_malloc, 0u);
}

TEST(LoopAllocator, CountsWhatItMustTakeFromMalloc) {
  NEEDS_OUR_OPERATOR_NEW();
  const std::uint64_t before = allocations_from_malloc();
  for (int i = 0; i < 10; ++i) std::make_unique<char[]>(4096);
  EXPECT_EQ(allocations_from_malloc() - before, 10u);
}

TEST(LoopAllocator, BlocksOfOneSizeAreDistinctAndKeepTheirBytes) {
  for (std::size_t size = 1; size <= 300; ++size) {
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

}  // namespace
}  // namespace csipose
