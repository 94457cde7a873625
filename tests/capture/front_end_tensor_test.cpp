// Three pseudo receivers made of sixty consecutive real records, through the front end, against the tensors
// that the published network's own functions gave for them.
#include <gtest/gtest.h>

#include <fstream>
#include <iterator>
#include <numbers>

#include "capture/front_end.h"
#include "proto/npy.h"
#include "tests/capture/made_up_packets.h"
#include "tests/shared_data.h"

namespace csipose {
namespace {

struct Tensor {
  const char* recording;
  int first;
  AmplitudeMethod amplitude;
};

std::vector<std::vector<std::uint8_t>> csi_records(const std::string& recording) {
  std::ifstream file(testing::shared_data("csi5300/" + recording + ".dat"), std::ios::binary);
  const std::vector<char> bytes((std::istreambuf_iterator<char>(file)), std::istreambuf_iterator<char>());
  RecordStream stream(ByteView(bytes), RecordStream::Policy::strict);
  std::vector<std::vector<std::uint8_t>> records;
  while (const auto record = stream.next())
    if (record->code == kCsiCode) records.emplace_back(record->framed().begin(), record->framed().end());
  return records;
}

/// Frame t of receiver r is record first + 20 r + t, sent at t / 1000 s, with a counter of our own.
Window window_of(const Tensor& tensor) {
  const auto records = csi_records(tensor.recording);
  FrontEnd front_end({.grid_hz = 1000, .tx_hz = 1000, .amplitude = tensor.amplitude});
  for (std::size_t t = 0; t < kSamples; ++t)
    for (std::uint8_t r = 0; r < kReceivers; ++r) {
      auto record = records.at(static_cast<std::size_t>(tensor.first) + kSamples * r + t);
      store_le(&record[kRecordHeaderBytes], static_cast<std::uint32_t>(1000 * t));
      testing::StoredPacket packet{r, SteadyTime{std::chrono::milliseconds(5000 + t)}, testing::csip_frame(t),
                                   -1};
      packet.bytes.insert(packet.bytes.end(), record.begin(), record.end());
      front_end.add(packet.packet());
    }
  Window window;
  front_end.take(window);
  return window;
}

void expect_near_golden(const Tensor& tensor) {
  const std::string name =
      std::string("csi5300/phase/tensor_") + tensor.recording + "_b" + std::to_string(tensor.first) + "_tx0_";
  const auto golden = read_npy<float>(
      testing::shared_data(name + (tensor.amplitude == AmplitudeMethod::raw ? "raw.npy" : "scaled.npy")));
  const auto mask = read_npy<std::uint8_t>(testing::shared_data(name + "raw_mask.npy"));
  const auto stable = read_npy<std::uint8_t>(testing::shared_data(name + "raw_stable.npy"));
  ASSERT_EQ(golden.shape, (NpyShape{60, 20, 9}));
  ASSERT_EQ(mask.shape, (NpyShape{30, 20, 9}));
  ASSERT_EQ(stable.shape, (NpyShape{3, 20}));
  const Window window = window_of(tensor);
  ASSERT_TRUE(window.links.all());
  EXPECT_EQ(window.reasons, 0);
  std::size_t phases = 0;
  for (std::size_t k = 0; k < kSubcarriers; ++k)
    for (std::size_t t = 0; t < kSamples; ++t)
      for (std::size_t l = 0; l < kLinks; ++l) {
        const float amplitude = golden.data[Window::index(k, t, l)];
        EXPECT_NEAR(window.x[Window::index(k, t, l)], amplitude, 1e-6 * (1 + amplitude))
            << k << " " << t << " " << l;
        if (mask.data[Window::index(k, t, l)] == 0 || stable.data[(l / 3) * kSamples + t] == 0) continue;
        ++phases;
        const double apart = window.x[Window::index(k + 30, t, l)] - golden.data[Window::index(k + 30, t, l)];
        EXPECT_NEAR(std::remainder(apart, 2 * std::numbers::pi), 0, 1e-5) << k << " " << t << " " << l;
      }
  EXPECT_GT(phases, 3000U);
}

TEST(FrontEndTensor, EqualsThePublishedNetworksInput) {
  CSIPOSE_NEEDS_SHARED_DATA();
  for (const AmplitudeMethod amplitude : {AmplitudeMethod::raw, AmplitudeMethod::scaled}) {
    expect_near_golden({"sample_0x5_64_3000", 0, amplitude});
    expect_near_golden({"sample_0x5_64_3000", 1200, amplitude});
    expect_near_golden({"sample_0x1_ap", 0, amplitude});
  }
}

}  // namespace
}  // namespace csipose
