#include "capture/frame_pairer.h"

#include <gtest/gtest.h>

#include "tests/capture/bytes.h"

namespace csipose {
namespace {

using testing::Bytes;
using testing::copy;
using testing::joined;

Bytes record(std::uint8_t code, std::uint8_t mark) { return {0, 2, code, mark}; }

TEST(FramePairer, JoinsAFrameWithTheCsiAfterIt) {
  FramePairer pairer;
  EXPECT_TRUE(pairer.add(record(0xC1, 1)).empty());
  EXPECT_EQ(copy(pairer.add(record(0xBB, 2))), joined(record(0xC1, 1), record(0xBB, 2)));
  EXPECT_TRUE(pairer.flush().empty());
}

TEST(FramePairer, CsiWithoutFrameComesAtOnce) {
  FramePairer pairer;
  EXPECT_EQ(copy(pairer.add(record(0xBB, 1))), record(0xBB, 1));
  EXPECT_EQ(copy(pairer.add(record(0xBB, 2))), record(0xBB, 2));
}

TEST(FramePairer, AFrameWithoutCsiComesAlone) {
  FramePairer pairer;
  EXPECT_TRUE(pairer.add(record(0xC1, 1)).empty());
  EXPECT_EQ(copy(pairer.add(record(0xC1, 2))), record(0xC1, 1));
  EXPECT_EQ(copy(pairer.add(record(0xBB, 3))), joined(record(0xC1, 2), record(0xBB, 3)));
  EXPECT_TRUE(pairer.add(record(0xC1, 4)).empty());
  EXPECT_EQ(copy(pairer.flush()), record(0xC1, 4));
}

TEST(FramePairer, OtherCodesDoNotComeBetween) {
  FramePairer pairer;
  pairer.add(record(0xC1, 1));
  EXPECT_TRUE(pairer.add(record(0xD0, 9)).empty());
  EXPECT_EQ(copy(pairer.add(record(0xBB, 2))), joined(record(0xC1, 1), record(0xBB, 2)));
}

}  // namespace
}  // namespace csipose
