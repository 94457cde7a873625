// model/safetensors.h - named tensors in a file: u64 length, a JSON header of that length, the numbers.
//
// Format: github.com/huggingface/safetensors. This reader is stricter than it must be: what it returns has
// been proved whole (every byte of the data belongs to exactly one tensor, every size fits its shape), and
// what it cannot prove it refuses with the file, the tensor, the reason and the remedy.
//
// Files that we write carry `content_sha256` among their metadata: SHA-256 of the header as compact JSON with
// sorted keys and without that entry, followed by the data. A changed byte anywhere is found; see
// docs/weights.md.
#pragma once

#include <cstdint>
#include <filesystem>
#include <map>
#include <string>
#include <string_view>
#include <vector>

#include "proto/bytes.h"

namespace csipose {

enum class DType : std::uint8_t { f64, f32, f16, bf16, i64, i32, i16, i8, u64, u32, u16, u8, boolean };
/// "F32", as the header spells it.
std::string_view name_of(DType dtype);
std::size_t size_of(DType dtype);
bool is_floating_point(DType dtype);

struct TensorView {
  std::string name;
  DType dtype = DType::f32;
  std::vector<std::size_t> shape;  ///< empty = a scalar
  ByteView bytes;                  ///< little-endian, C order; need not be aligned

  std::size_t elements() const { return bytes.size() / size_of(dtype); }
};

/// Numbers as float32; the tensor must be F32, F16, BF16 or F64
/// (assert). F64 rounds to nearest.
std::vector<float> to_floats(const TensorView& tensor);
/// "[64, 60, 1, 1]", as errors and listings show a shape.
std::string shape_text(const std::vector<std::size_t>& shape);

/// A read file; owns its bytes, tensors view them.
class SafetensorsFile {
 public:
  /// Throws SetupError: no_input when the file is not there, io when it cannot be read, bad_data when it is
  /// not whole.
  static SafetensorsFile read(const std::filesystem::path& path);
  /// The same for bytes in memory; `name` stands for the file in words.
  static SafetensorsFile parse(std::vector<std::uint8_t> bytes, const std::string& name);

  const std::string& name() const { return name_; }
  const std::map<std::string, std::string>& metadata() const { return metadata_; }
  const std::vector<TensorView>& tensors() const { return tensors_; }  ///< in the order of their data
  const TensorView* find(std::string_view tensor) const;
  /// SHA-256 of the whole file, 64 hex digits: what sha256sum prints.
  const std::string& digest() const { return digest_; }
  /// It carries `content_sha256` (and that is right: a wrong one is refused).
  bool sealed() const { return sealed_; }

 private:
  std::string name_, digest_;
  std::vector<std::uint8_t> bytes_;
  std::map<std::string, std::string> metadata_;
  std::vector<TensorView> tensors_;
  bool sealed_ = false;
};

/// The bytes of a file with these tensors, sealed. Names must differ and fit their sizes (assert).
std::vector<std::uint8_t> pack_safetensors(std::map<std::string, std::string> metadata,
                                           const std::vector<TensorView>& tensors);
/// Replaces `path` in one step: temporary file beside it, fsync, rename; a reader sees the old file or the
/// new one. Throws SetupError (cannot_create, io).
void write_file_atomically(const std::filesystem::path& path, ByteView bytes);

}  // namespace csipose
