// model/onednn_rows.h - what happens between the matrix products, row by row: LayerNorm, softmax, change of
// number format.
//
// All of it is computed in float32 and stored in the format that the next product reads, in one pass.
// oneDNN 2.6 has no LayerNorm with mixed formats, and writing the format directly is what makes these passes
// cheap.
//
// One source, compiled for several instruction sets (attributes, not compiler flags, so that the program
// still starts on an older processor); row_kernels() picks. Rows are independent: any split over threads
// gives the same bits. Results of different instruction sets differ in the last bits, because sums are taken
// in another order.
#pragma once

#include <cstddef>
#include <cstdint>
#include <string>

#include "model/cpu.h"

namespace csipose {

/// Format of a number in memory. s8: value = number * scale, clamped to +-127.
enum class Element : std::uint8_t { f32, bf16, s8 };
std::size_t size_of(Element element);

/// Where the rows of a result go: row r starts at data + r * width * size_of(element).
struct RowSink {
  void* data = nullptr;  ///< nullptr: not wanted
  Element element = Element::f32;
  float inverse_scale = 1;  ///< s8 only: number = value * inverse_scale
};

/// y = (x - mean) / sqrt(variance + epsilon) * gain + bias, per row of `width`.
struct NormRows {
  const float* x;
  std::size_t width;
  const float* gain;
  const float* bias;
  float epsilon;
  float* copy;            ///< float32 result too, may be x itself; nullptr: not wanted
  RowSink out;            ///< y
  const float* position;  ///< row r of it is added for out_with_position; may be nullptr
  RowSink out_with_position;
};
/// softmax(factor * x) per row. `out` may be x itself when it is float32.
struct SoftmaxRows {
  const float* x;
  std::size_t width;
  float factor;
  RowSink out;
};
/// x, or x + position, in another format.
struct StoreRows {
  const float* x;
  std::size_t width;
  const float* position;  ///< added row by row; may be nullptr
  RowSink out;
};

/// The operations on rows [first, last).
struct RowKernels {
  const char* name;  ///< "avx512", "avx2", "sse2"
  void (*norm)(const NormRows&, std::size_t first, std::size_t last);
  void (*softmax)(const SoftmaxRows&, std::size_t first, std::size_t last);
  void (*store)(const StoreRows&, std::size_t first, std::size_t last);
};
const RowKernels& row_kernels(const CpuFeatures& features);

float from_bf16(std::uint16_t bits);
std::uint16_t to_bf16(float value);  ///< nearest, ties to even; NaN stays NaN

}  // namespace csipose
