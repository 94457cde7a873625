// sim/lanes.h - sixteen floats at a time, in plain arithmetic.
//
// GCC's and Clang's vector extension in the widest registers that the file is compiled for: one of AVX-512, two of AVX2,
// four of SSE2. Sixteen lanes everywhere, so that sums run in the same order on every machine. Everything is in an unnamed
// namespace: a function of one instruction set must never be merged with that of another.
#pragma once

#include <cstdint>
#include <cstring>

namespace {

#if defined(__AVX512F__)
#define CSIPOSE_REGISTER_BYTES 64
#elif defined(__AVX2__)
#define CSIPOSE_REGISTER_BYTES 32
#else
#define CSIPOSE_REGISTER_BYTES 16
#endif
using Register = float __attribute__((vector_size(CSIPOSE_REGISTER_BYTES)));
using IntRegister = std::int32_t __attribute__((vector_size(CSIPOSE_REGISTER_BYTES)));
constexpr int kLanes = 16, kParts = 64 / CSIPOSE_REGISTER_BYTES;

struct Float16 {
  Register part[kParts];
};
/// Lane by lane all ones or 0, as comparisons give it.
struct Mask16 {
  IntRegister part[kParts];
};

inline Float16 splat(float x) {
  Float16 v;
  for (Register& part : v.part) part = Register{} + x;
  return v;
}
inline Float16 load16(const float* p) {
  Float16 v;
  std::memcpy(&v, p, sizeof v);
  return v;
}
inline void store16(float* p, const Float16& v) { std::memcpy(p, &v, sizeof v); }

// Arithmetic between lanes, and between lanes and one number for all.
#define CSIPOSE_OPERATOR(op, Result)                                             \
  inline Result operator op(const Float16& a, const Float16& b) {                \
    Result r;                                                                    \
    for (int i = 0; i < kParts; ++i) r.part[i] = a.part[i] op b.part[i];         \
    return r;                                                                    \
  }                                                                              \
  inline Result operator op(const Float16& a, float b) { return a op splat(b); } \
  inline Result operator op(float a, const Float16& b) { return splat(a) op b; }
CSIPOSE_OPERATOR(+, Float16)
CSIPOSE_OPERATOR(-, Float16)
CSIPOSE_OPERATOR(*, Float16)
CSIPOSE_OPERATOR(/, Float16)
CSIPOSE_OPERATOR(<, Mask16)
CSIPOSE_OPERATOR(>, Mask16)
#undef CSIPOSE_OPERATOR

inline Float16 operator-(const Float16& a) { return 0.0f - a; }
inline Float16& operator+=(Float16& a, const Float16& b) { return a = a + b; }
inline Mask16 operator&(const Mask16& a, const Mask16& b) {
  Mask16 r;
  for (int i = 0; i < kParts; ++i) r.part[i] = a.part[i] & b.part[i];
  return r;
}

/// Lane by lane: mask ? a : b.
inline Float16 select(const Mask16& mask, const Float16& a, const Float16& b) {
  Float16 r;
  for (int i = 0; i < kParts; ++i)
    r.part[i] = reinterpret_cast<Register>((reinterpret_cast<IntRegister>(a.part[i]) & mask.part[i]) |
                                           (reinterpret_cast<IntRegister>(b.part[i]) & ~mask.part[i]));
  return r;
}
inline Float16 larger(const Float16& a, const Float16& b) { return select(a > b, a, b); }
inline Float16 root(Float16 x) {
  for (Register& part : x.part)
    for (int i = 0; i < kLanes / kParts; ++i) part[i] = __builtin_sqrtf(part[i]);
  return x;
}
/// Nearest whole number, for |x| < 2^22: the sum leaves no room for a fraction.
inline Float16 nearest(const Float16& x) {
  constexpr float kMagic = 12582912.0f;  // 1.5 * 2^23
  return (x + kMagic) - kMagic;
}
/// Sum of the lanes as a tree: the same order everywhere.
inline float sum(const Float16& lanes) {
  float v[kLanes];
  store16(v, lanes);
  const float a = (v[0] + v[8]) + (v[4] + v[12]), b = (v[2] + v[10]) + (v[6] + v[14]);
  const float c = (v[1] + v[9]) + (v[5] + v[13]), d = (v[3] + v[11]) + (v[7] + v[15]);
  return (a + b) + (c + d);
}

/// cos and sin of 2 pi `turns`, |turns| < 2^22, to 4e-7: half a turn is folded to a quarter either side of 0, where
/// Taylor's series serve; cos goes by the half angle, sin's sign survives the fold.
__attribute__((always_inline)) inline void cos_sin_turns(const Float16& turns, Float16& cosine,
                                                         Float16& sine) {
  // cos 2x = 1 - 2 sin^2 x and sin 2x = 2 sin x cos x with x = pi (turns - nearest) in -pi/2 .. pi/2
  const Float16 x = (turns - nearest(turns)) * 3.14159265358979323846f;
  const Float16 x2 = x * x;
  const Float16 s =
      x * (1.0f + x2 * (-1.6666666664e-1f +
                        x2 * (8.333331876e-3f +
                              x2 * (-1.9840782426e-4f + x2 * (2.7525562e-6f + x2 * -2.38890e-8f)))));
  const Float16 c =
      1.0f + x2 * (-0.4999999963f +
                   x2 * (4.16666418e-2f + x2 * (-1.3888397e-3f + x2 * (2.47609e-5f + x2 * -2.605e-7f))));
  cosine = 1.0f - 2.0f * s * s;
  sine = 2.0f * s * c;
}

}  // namespace
