// Any bytes as a NumPy file.
#include "proto/npy.h"

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  const csipose::ByteView file(data, size);
  (void)csipose::parse_npy_as<float>(file);
  (void)csipose::parse_npy_as<std::uint8_t>(file);
  (void)csipose::parse_npy_as<std::complex<double>>(file);
  return 0;
}
