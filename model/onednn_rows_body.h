// The body of model/onednn_rows.h, compiled once for each instruction set by a file that names it and its
// flags.
//
// Nothing of the standard library but <cstring>: an inline function of it, compiled here for AVX-512, could
// be the copy that the linker keeps for the whole program, and stop it on an older processor.
#include <cstring>

#include "model/onednn_rows.h"

#if !defined(CSIPOSE_ROW_LANES) || !defined(CSIPOSE_ROW_KERNELS)
#error "to be included by the files for one instruction set"
#endif

namespace csipose {
namespace {

constexpr std::size_t kLanes = CSIPOSE_ROW_LANES;
constexpr float kInfinity = __builtin_inff();
typedef float Float __attribute__((vector_size(kLanes * 4)));
typedef std::int32_t Int __attribute__((vector_size(kLanes * 4)));
typedef std::int16_t Half __attribute__((vector_size(kLanes * 2)));
typedef std::int8_t Byte __attribute__((vector_size(kLanes)));

inline Float all(float value) { return value - Float{}; }
inline Float load(const float* from) {
  Float v;
  std::memcpy(&v, from, sizeof v);
  return v;
}
/// The first `count` lanes; the others are `rest`.
inline Float load_part(const float* from, std::size_t count, float rest) {
  Float v = all(rest);
  for (std::size_t i = 0; i < count; ++i) v[i] = from[i];
  return v;
}

inline Float larger(Float a, Float b) {
  return a > b ? a : b;  // NaN in a gives b
}
inline Float smaller(Float a, Float b) { return a < b ? a : b; }
inline float sum_of(Float v) {
  float sum = 0;
  for (std::size_t i = 0; i < kLanes; ++i) sum += v[i];
  return sum;
}
inline float max_of(Float v) {
  float most = v[0];
  for (std::size_t i = 1; i < kLanes; ++i) most = v[i] > most ? v[i] : most;
  return most;
}

/// Nearest whole number as integers, ties to even; |x| < 2^22.
inline Int to_int(Float x) {
  constexpr float kMagic = 12582912.f;  // 1.5 * 2^23: adding it leaves no room for a fraction
  const Float shifted = x + kMagic;
  Int bits;
  std::memcpy(&bits, &shifted, sizeof bits);
  return bits - 0x4B400000;  // the bits of kMagic
}

/// e^x for x <= 0, relative error below 3e-7; 0 below -87. e^x = 2^n e^r with |r| <= ln 2 / 2, e^r by its
/// series up to r^7 / 7! (the first term left out is 1.2e-8 there).
inline Float exp_negative(Float x) {
  const Float clamped = larger(x, all(-88.f));
  const Int n = to_int(clamped * 1.44269504f);
  const Float whole = __builtin_convertvector(n, Float);
  const Float r = (clamped - whole * 0.693359375f) + whole * 2.12194440e-4f;  // ln 2 in two parts
  Float p = all(1.f / 5040);
  p = p * r + 1.f / 720;
  p = p * r + 1.f / 120;
  p = p * r + 1.f / 24;
  p = p * r + 1.f / 6;
  p = p * r + 0.5f;
  p = p * r + 1.f;
  p = p * r + 1.f;
  const Int exponent = (n + 127) << 23;
  Float power;
  std::memcpy(&power, &exponent, sizeof power);
  return x < -87.f ? all(0.f) : p * power;
}

inline Half to_half(Float v) {
  Int bits;
  std::memcpy(&bits, &v, sizeof bits);
  const Int rounded = bits + 0x7FFF + ((bits >> 16) & 1);
  const Int quiet = bits | 0x400000;
  const Int kept = v == v ? rounded : quiet;
  return __builtin_convertvector(kept >> 16, Half);
}
inline Byte to_byte(Float v) {
  const Float clamped = smaller(larger(v, all(-127.f)), all(127.f));
  return __builtin_convertvector(to_int(clamped), Byte);
}

template <class Vector>
inline void put(void* base, std::size_t offset_bytes, const Vector& v, std::size_t bytes) {
  std::memcpy(static_cast<char*>(base) + offset_bytes, &v, bytes);
}

/// Stores the first `count` lanes of v at element `index` of the sink.
inline void store(const RowSink& sink, std::size_t index, Float v, std::size_t count) {
  switch (sink.element) {
    case Element::f32:
      return put(sink.data, index * 4, v, count * 4);
    case Element::bf16:
      return put(sink.data, index * 2, to_half(v), count * 2);
    case Element::s8:
      return put(sink.data, index, to_byte(v * sink.inverse_scale), count);
  }
}

/// body(vector, column, lanes) for each vector of a row; lanes behind the row's end are `rest`. The common
/// case, all lanes, is a constant for the compiler.
template <class Body>
inline void for_vectors(const float* row, std::size_t width, float rest, const Body& body) {
  std::size_t c = 0;
  for (; c + kLanes <= width; c += kLanes) body(load(row + c), c, kLanes);
  if (c < width) body(load_part(row + c, width - c, rest), c, width - c);
}

inline Float at(const float* row, std::size_t c, std::size_t count) {
  return count == kLanes ? load(row + c) : load_part(row + c, count, 0);
}

struct Moments {
  float mean, inverse_deviation;
};
inline Moments moments_of(const float* row, std::size_t width, float epsilon) {
  Float sum{};
  for_vectors(row, width, 0, [&](Float v, std::size_t, std::size_t) { sum += v; });
  const float mean = sum_of(sum) / static_cast<float>(width);
  Float squares{};
  for_vectors(row, width, mean,
              [&](Float v, std::size_t, std::size_t) { squares += (v - mean) * (v - mean); });
  const float variance = sum_of(squares) / static_cast<float>(width);
  return {mean, 1 / __builtin_sqrtf(variance + epsilon)};
}

inline void norm_rows(const NormRows& op, std::size_t first, std::size_t last) {
  const RowSink copy = {op.copy, Element::f32, 1};
  for (std::size_t r = first; r < last; ++r) {
    const float* row = op.x + r * op.width;
    const Moments m = moments_of(row, op.width, op.epsilon);
    for_vectors(row, op.width, 0, [&](Float v, std::size_t c, std::size_t count) {
      const Float y = (v - m.mean) * m.inverse_deviation * at(op.gain, c, count) + at(op.bias, c, count);
      const std::size_t index = r * op.width + c;
      if (copy.data) store(copy, index, y, count);
      if (op.out.data) store(op.out, index, y, count);
      if (op.out_with_position.data)
        store(op.out_with_position, index, y + at(op.position, index, count), count);
    });
  }
}

inline void softmax_rows(const SoftmaxRows& op, std::size_t first, std::size_t last) {
  float* numerators = static_cast<float*>(__builtin_alloca((op.width + kLanes) * sizeof(float)));
  const RowSink scratch = {numerators, Element::f32, 1};
  for (std::size_t r = first; r < last; ++r) {
    const float* row = op.x + r * op.width;
    Float most = all(-kInfinity), sum{};
    for_vectors(row, op.width, -kInfinity,
                [&](Float v, std::size_t, std::size_t) { most = larger(v, most); });
    const float peak = max_of(most);
    for_vectors(row, op.width, -kInfinity, [&](Float v, std::size_t c, std::size_t) {
      const Float e = exp_negative((v - peak) * op.factor);
      sum += e;
      store(scratch, c, e, kLanes);
    });
    const float scale = 1 / sum_of(sum);
    for_vectors(numerators, op.width, 0, [&](Float v, std::size_t c, std::size_t count) {
      store(op.out, r * op.width + c, v * scale, count);
    });
  }
}

inline void store_rows(const StoreRows& op, std::size_t first, std::size_t last) {
  for (std::size_t r = first; r < last; ++r)
    for_vectors(op.x + r * op.width, op.width, 0, [&](Float v, std::size_t c, std::size_t count) {
      const std::size_t index = r * op.width + c;
      store(op.out, index, op.position ? v + at(op.position, index, count) : v, count);
    });
}

}  // namespace

extern const RowKernels CSIPOSE_ROW_KERNELS;
const RowKernels CSIPOSE_ROW_KERNELS = {CSIPOSE_ROW_NAME, norm_rows, softmax_rows, store_rows};

}  // namespace csipose
