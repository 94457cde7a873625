// proto/npy.h - NumPy's array files (.npy, versions 1.0 and 2.0): little-endian numbers, strictly read.
//
//   "\x93NUMPY" major minor header_length (LE, 16 or 32 bits)
//   {'descr': '<f4', 'fortran_order': False, 'shape': (60, 20, 9), }    padded with spaces, '\n', to 64 bytes
//   the numbers
//
// Source: NumPy enhancement proposal 1 and numpy.lib.format. Refused, in words: objects, structures,
// big-endian numbers, a type other than the one asked for, missing or surplus bytes.
#pragma once

#include <complex>
#include <cstdint>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "proto/bytes.h"
#include "proto/result.h"

namespace csipose {

/// NumPy's name of a C++ type.
template <class T>
inline constexpr std::string_view kNpyType = "";
template <>
inline constexpr std::string_view kNpyType<float> = "<f4";
template <>
inline constexpr std::string_view kNpyType<double> = "<f8";
template <>
inline constexpr std::string_view kNpyType<std::complex<float>> = "<c8";
template <>
inline constexpr std::string_view kNpyType<std::complex<double>> = "<c16";
template <>
inline constexpr std::string_view kNpyType<std::int8_t> = "|i1";
template <>
inline constexpr std::string_view kNpyType<std::uint8_t> = "|u1";
template <>
inline constexpr std::string_view kNpyType<std::int16_t> = "<i2";
template <>
inline constexpr std::string_view kNpyType<std::uint16_t> = "<u2";
template <>
inline constexpr std::string_view kNpyType<std::int32_t> = "<i4";
template <>
inline constexpr std::string_view kNpyType<std::uint32_t> = "<u4";
template <>
inline constexpr std::string_view kNpyType<std::int64_t> = "<i8";
template <>
inline constexpr std::string_view kNpyType<std::uint64_t> = "<u8";

using NpyShape = std::vector<std::size_t>;
/// Product of the sizes; 1 for a scalar's ().
std::size_t element_count(const NpyShape& shape);

/// A file's header, and its numbers as bytes in the order that they have in the file.
struct NpyView {
  std::string descr;  ///< as written: "<f4"
  bool fortran_order = false;
  NpyShape shape;
  ByteView data;  ///< exactly element_count(shape) numbers
};
/// Reads header and checks sizes. Error: what is wrong, in words, without the file's name.
Result<NpyView, std::string> parse_npy(ByteView file);

template <class T>
struct NpyArray {
  NpyShape shape;
  std::vector<T> data;  ///< C order, whatever the file had
};

namespace npy_detail {
/// Copies numbers of `size` bytes each from Fortran order to C order.
void to_c_order(ByteView fortran, const NpyShape& shape, std::size_t size, std::uint8_t* c_order);
std::string type_refusal(std::string_view found, std::string_view wanted);
std::vector<std::uint8_t> read_whole(const std::filesystem::path& path);
[[noreturn]] void refuse(const std::filesystem::path& path, const std::string& why);
}  // namespace npy_detail

/// The array in `file`, which must be of type T.
template <class T>
Result<NpyArray<T>, std::string> parse_npy_as(ByteView file) {
  static_assert(!kNpyType<T>.empty(), "a type that NumPy files of ours do not have");
  const Result<NpyView, std::string> view = parse_npy(file);
  if (!view) return view.error();
  if (view->descr != kNpyType<T>) return npy_detail::type_refusal(view->descr, kNpyType<T>);
  NpyArray<T> array{view->shape, std::vector<T>(element_count(view->shape))};
  auto* bytes = reinterpret_cast<std::uint8_t*>(array.data.data());
  if (view->fortran_order)
    npy_detail::to_c_order(view->data, view->shape, sizeof(T), bytes);
  else if (!view->data.empty())
    std::memcpy(bytes, view->data.data(), view->data.size());
  return array;
}

/// The array in the file at `path`. Throws SetupError (no_input, bad_data) with the file's name and what is
/// wrong.
template <class T>
NpyArray<T> read_npy(const std::filesystem::path& path) {
  const std::vector<std::uint8_t> file = npy_detail::read_whole(path);
  Result<NpyArray<T>, std::string> array = parse_npy_as<T>(file);
  if (!array) npy_detail::refuse(path, array.error());
  return std::move(*array);
}

/// Writes an array row by row without knowing how many rows will come. The file appears under its name at
/// finish(), whole; an unfinished writer leaves nothing behind.
class NpyFile {
 public:
  /// `row`: shape of one row; the file's shape is (rows, row...). Throws SetupError(cannot_create).
  NpyFile(std::filesystem::path path, std::string_view descr, std::size_t number_bytes, NpyShape row);
  ~NpyFile();
  NpyFile(const NpyFile&) = delete;
  NpyFile& operator=(const NpyFile&) = delete;
  /// Whole rows, C order. Throws SetupError(io), for example when the disk is full.
  void append(ByteView rows);
  /// Writes the final shape and renames. Throws SetupError(io).
  void finish();
  std::size_t rows() const { return row_bytes_ == 0 ? 0 : data_bytes_ / row_bytes_; }

 private:
  void check_written() const;
  std::filesystem::path path_, temporary_;
  std::string descr_;
  NpyShape row_;
  std::size_t row_bytes_, data_bytes_ = 0;
  std::ofstream file_;
  bool finished_ = false;
};

template <class T>
class NpyWriter {
 public:
  NpyWriter(std::filesystem::path path, NpyShape row)
      : file_(std::move(path), kNpyType<T>, sizeof(T), std::move(row)) {
    static_assert(!kNpyType<T>.empty(), "a type that NumPy files of ours do not have");
  }
  void append(std::span<const T> rows) { file_.append(ByteView(rows.data(), rows.size_bytes())); }
  void finish() { file_.finish(); }
  std::size_t rows() const { return file_.rows(); }

 private:
  NpyFile file_;
};

/// Writes a whole array of at least one dimension.
template <class T>
void write_npy(const std::filesystem::path& path, const NpyShape& shape, std::span<const T> data) {
  assert(!shape.empty() && data.size() == element_count(shape));
  NpyWriter<T> writer(path, NpyShape(shape.begin() + 1, shape.end()));
  writer.append(data);
  writer.finish();
}

}  // namespace csipose
