#include "sim/frame_maker.h"

#include <cmath>
#include <glm/gtc/packing.hpp>

namespace csipose::sim {
namespace {

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

std::optional<Storage> find_storage(std::string_view name) {
  if (name == "int8") return Storage::records;
  if (name == "complex64") return Storage::channel;
  if (name == "float16") return Storage::half;
  return std::nullopt;
}

std::vector<ArrayPlan> frame_arrays(const FrameFormat& format) {
  const ArrayPlan clip{"clip", "<u4", 4, {}};
  const std::size_t t = format.snapshots;
  if (format.storage == Storage::channel)
    return {clip, {"h", "<c8", 8, {t, kSubcarriers, kReceivers, kAntennas}}};
  if (format.storage == Storage::half)
    return {clip, {"h", "<f2", 2, {t, kSubcarriers, kReceivers, kAntennas, 2}}, {"h_rms", "<f4", 4, {}}};
  return {clip,
          {"csi", "|i1", 1, {t, kReceivers, kSubcarriers, kAntennas, 2}},
          {"received", "|u1", 1, {t, kReceivers}},
          {"rssi", "|u1", 1, {t, kReceivers, kAntennas}},
          {"agc", "|u1", 1, {t, kReceivers}}};
}

FrameMaker::FrameMaker(FastSolver solver, const FrameFormat& format, const Impairments& on,
                       std::uint64_t seed, std::uint32_t clip, double rate_hz)
    : format_(format),
      clip_(clip),
      bank_(on, Band{}, seed, clip, rate_hz),
      batch_(std::move(solver), format.snapshots) {}

void FrameMaker::add_frame(MovingScene& scene, ClipRows& rows) {
  batch_.advance(scene);
  append(rows[0], &clip_, 1);
  if (format_.storage == Storage::channel)
    append(rows[1], batch_.h().data(), batch_.h().size());
  else if (format_.storage == Storage::half)
    append_half(rows);
  else
    append_records(rows);
}

/// Over the rms, since |H| is about what float16 has for its least.
void FrameMaker::append_half(ClipRows& rows) const {
  double power = 0;
  for (const auto& h : batch_.h()) power += std::norm(std::complex<double>(h));
  const float rms = static_cast<float>(std::sqrt(power / static_cast<double>(batch_.h().size())));
  for (const auto& h : batch_.h()) {
    const std::array<std::uint16_t, 2> pair{glm::packHalf1x16(h.real() / rms),
                                            glm::packHalf1x16(h.imag() / rms)};
    append(rows[1], pair.data(), 2);
  }
  append(rows[2], &rms, 1);
}

void FrameMaker::append_records(ClipRows& rows) {
  for (std::size_t t = 0; t < format_.snapshots; ++t)
    for (const auto& record : bank_.hear(batch_.channel(t)).records) {
      const CsiRecord kept = record.value_or(CsiRecord{});  // lost: zeros
      const std::uint8_t received = record.has_value();
      append(rows[1], matrix_of(kept).data(), kSubcarriers * kAntennas * 2);
      append(rows[2], &received, 1);
      append(rows[3], kept.rssi.data(), kAntennas);
      append(rows[4], &kept.agc_db, 1);
    }
}

ClipRows make_clip(MovingScene& scene, const FrameFormat& format, const Impairments& on, std::uint64_t seed,
                   std::uint32_t clip, std::uint32_t frames, double rate_hz) {
  FrameMaker maker(FastSolver(scene.still()), format, on, seed, clip, rate_hz);
  ClipRows rows(frame_arrays(format).size());
  for (std::uint32_t frame = 0; frame < frames; ++frame) maker.add_frame(scene, rows);
  return rows;
}

}  // namespace csipose::sim
