#include "sim/frame_maker.h"

namespace csipose::sim {
namespace {

template <class Number>
void append(std::vector<std::uint8_t>& row, const Number* values, std::size_t count) {
  const auto* bytes = reinterpret_cast<const std::uint8_t*>(values);
  row.insert(row.end(), bytes, bytes + count * sizeof(Number));
}

/// [subcarrier][antenna][re, im] of a record's first stream.
std::array<std::int8_t, kSubcarriers * kAntennas * 2> matrix_of(const CsiRecord& record) {
  std::array<std::int8_t, kSubcarriers * kAntennas * 2> matrix;
  std::size_t i = 0;
  for (std::size_t k = 0; k < kSubcarriers; ++k)
    for (std::size_t a = 0; a < kAntennas; ++a) {
      matrix[i++] = record.csi[CsiRecord::index(k, a, 0)];
      matrix[i++] = record.csi[CsiRecord::index(k, a, 0) + 1];
    }
  return matrix;
}

}  // namespace

std::vector<ArrayPlan> frame_arrays(Storage storage) {
  const ArrayPlan clip{"clip", "<u4", 4, {}};
  if (storage == Storage::channel)
    return {clip, {"h", "<c8", 8, {kSamples, kSubcarriers, kReceivers, kAntennas}}};
  return {clip,
          {"csi", "|i1", 1, {kSamples, kReceivers, kSubcarriers, kAntennas, 2}},
          {"received", "|u1", 1, {kSamples, kReceivers}},
          {"rssi", "|u1", 1, {kSamples, kReceivers, kAntennas}},
          {"agc", "|u1", 1, {kSamples, kReceivers}}};
}

FrameMaker::FrameMaker(const Scene& scene, Storage storage, ImpairmentLevel level, std::uint64_t seed,
                       std::uint32_t clip, double rate_hz)
    : storage_(storage), clip_(clip), bank_(level, Band{}, seed, clip, rate_hz), batch_(scene) {}

void FrameMaker::add_frame(MovingScene& scene, ClipRows& rows) {
  batch_.advance(scene);
  append(rows[0], &clip_, 1);
  if (storage_ == Storage::channel)
    append(rows[1], batch_.h().data(), batch_.h().size());
  else
    append_records(rows);
}

void FrameMaker::append_records(ClipRows& rows) {
  for (std::size_t t = 0; t < kSamples; ++t)
    for (const auto& record : bank_.hear(batch_.channel(t)).records) {
      const CsiRecord kept = record.value_or(CsiRecord{});  // lost: zeros
      const std::uint8_t received = record.has_value();
      append(rows[1], matrix_of(kept).data(), kSubcarriers * kAntennas * 2);
      append(rows[2], &received, 1);
      append(rows[3], kept.rssi.data(), kAntennas);
      append(rows[4], &kept.agc_db, 1);
    }
}

ClipRows make_clip(MovingScene& scene, Storage storage, ImpairmentLevel level, std::uint64_t seed,
                   std::uint32_t clip, std::uint32_t frames, double rate_hz) {
  FrameMaker maker(scene.still(), storage, level, seed, clip, rate_hz);
  ClipRows rows(frame_arrays(storage).size());
  for (std::uint32_t frame = 0; frame < frames; ++frame) maker.add_frame(scene, rows);
  return rows;
}

}  // namespace csipose::sim
