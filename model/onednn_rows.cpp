#include "model/onednn_rows.h"

#include <bit>

namespace csipose {

extern const RowKernels kRowKernels_avx512, kRowKernels_avx2, kRowKernels_sse2;

const RowKernels& row_kernels(const CpuFeatures& features) {
  if (features.avx512) return kRowKernels_avx512;
  return features.avx2 ? kRowKernels_avx2 : kRowKernels_sse2;
}

std::size_t size_of(Element element) {
  switch (element) {
    case Element::f32:
      return 4;
    case Element::bf16:
      return 2;
    case Element::s8:
      break;
  }
  return 1;
}

float from_bf16(std::uint16_t bits) { return std::bit_cast<float>(std::uint32_t{bits} << 16); }

std::uint16_t to_bf16(float value) {
  const auto bits = std::bit_cast<std::uint32_t>(value);
  if (value != value) return static_cast<std::uint16_t>(bits >> 16 | 0x40);
  return static_cast<std::uint16_t>((bits + 0x7FFF + (bits >> 16 & 1)) >> 16);
}

}  // namespace csipose
