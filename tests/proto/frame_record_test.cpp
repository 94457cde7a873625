#include "proto/frame_record.h"

#include <gtest/gtest.h>

#include "proto/crc32.h"
#include "proto/record_stream.h"

namespace csipose {
namespace {

TEST(FrameRecord, IsOneRecordThatHoldsFrameAndFcs) {
  const auto header = injector_header(0x1234);
  const std::vector<std::uint8_t> bytes = encode_frame_record(header);
  RecordStream stream(bytes, RecordStream::Policy::strict);
  const auto record = stream.next();
  ASSERT_TRUE(record);
  EXPECT_EQ(record->code, kFrameCode);
  ASSERT_EQ(record->body.size(), kDataHeaderBytes + kFcsBytes);
  EXPECT_TRUE(std::equal(header.begin(), header.end(), record->body.begin()));
  EXPECT_EQ(load_le<std::uint32_t>(record->body.data() + kDataHeaderBytes), crc32(header));
  EXPECT_EQ(load_le<std::uint16_t>(record->body.data() + 22), 0x1234);
  EXPECT_FALSE(stream.next());
  EXPECT_EQ(stream.offset(), bytes.size());
}

TEST(FrameRecord, WritesTheInjectorsBodyByteByByte) {
  const auto bytes = encode_csip_record(
      {.session = 0x0102, .counter = 0x1112131415161718, .transmit_ns = 0x2122232425262728});
  const std::array<std::uint8_t, kCsipBodyBytes> body = {'C',  'S',  'I',  'P',  1,    0,    0x02, 0x01,
                                                         0x18, 0x17, 0x16, 0x15, 0x14, 0x13, 0x12, 0x11,
                                                         0x28, 0x27, 0x26, 0x25, 0x24, 0x23, 0x22, 0x21};
  EXPECT_TRUE(std::equal(body.begin(), body.end(), bytes.begin() + 3 + kDataHeaderBytes));
  EXPECT_EQ(load_be16(bytes.data()), bytes.size() - 2);
}

}  // namespace
}  // namespace csipose
