#include "daemon/snapshot.h"

#include <gtest/gtest.h>

#include <thread>

namespace csipose {
namespace {

struct Pair {
  std::array<std::uint64_t, 64> same{};
};

TEST(Snapshot, GivesTheNewestOnce) {
  Snapshot<int> snapshot;
  EXPECT_FALSE(snapshot.refresh());
  for (int i = 1; i <= 5; ++i) {
    snapshot.back() = i;
    snapshot.publish();
  }
  EXPECT_TRUE(snapshot.refresh());
  EXPECT_EQ(snapshot.front(), 5);
  EXPECT_FALSE(snapshot.refresh());
  EXPECT_EQ(snapshot.front(), 5);
}

TEST(Snapshot, IsNeverTornAndNeverGoesBack) {
  Snapshot<Pair> snapshot;
  constexpr std::uint64_t kValues = 20000;
  std::thread writer([&] {
    for (std::uint64_t value = 1; value <= kValues; ++value) {
      snapshot.back().same.fill(value);
      snapshot.publish();
    }
  });
  std::uint64_t last = 0;
  while (last < kValues) {
    if (!snapshot.refresh()) {
      std::this_thread::yield();
      continue;
    }
    const Pair& pair = snapshot.front();
    EXPECT_GT(pair.same[0], last);
    for (const std::uint64_t value : pair.same) ASSERT_EQ(value, pair.same[0]);
    last = pair.same[0];
  }
  writer.join();
}

}  // namespace
}  // namespace csipose
