#include "model/safetensors.h"

#include <fcntl.h>
#include <fmt/format.h>
#include <sodium.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <cassert>
#include <cerrno>
#include <cmath>
#include <cstring>
#include <limits>
#include <nlohmann/json.hpp>
#include <set>
#include <utility>

#include "model/json_words.h"
#include "proto/result.h"

namespace csipose {
namespace {

using nlohmann::json;

constexpr std::size_t kLengthBytes = 8;
constexpr std::uint64_t kMaxHeaderBytes = 16 << 20;  // the largest preset's takes 40 KB
constexpr const char* kSealKey = "content_sha256";

struct DTypeInfo {
  std::string_view name;
  std::size_t size;
};
constexpr std::array<DTypeInfo, 13> kDTypes = {{{"F64", 8},
                                                {"F32", 4},
                                                {"F16", 2},
                                                {"BF16", 2},
                                                {"I64", 8},
                                                {"I32", 4},
                                                {"I16", 2},
                                                {"I8", 1},
                                                {"U64", 8},
                                                {"U32", 4},
                                                {"U16", 2},
                                                {"U8", 1},
                                                {"BOOL", 1}}};

[[noreturn]] void refuse(const std::string& file, const std::string& reason) {
  throw SetupError(
      ExitStatus::bad_data,
      fmt::format("weights file {}: {}; the file is damaged or not of this format: take it from its origin "
                  "again and compare the digest",
                  file, reason));
}

std::string hex(const unsigned char* hash) {
  std::array<char, 2 * crypto_hash_sha256_BYTES + 1> text{};
  sodium_bin2hex(text.data(), text.size(), hash, crypto_hash_sha256_BYTES);
  return text.data();
}

/// SHA-256 of two pieces one after the other.
std::string sha256(ByteView first, ByteView second) {
  crypto_hash_sha256_state state;
  crypto_hash_sha256_init(&state);
  crypto_hash_sha256_update(&state, first.data(), first.size());
  crypto_hash_sha256_update(&state, second.data(), second.size());
  std::array<unsigned char, crypto_hash_sha256_BYTES> hash{};
  crypto_hash_sha256_final(&state, hash.data());
  return hex(hash.data());
}

std::string seal(json header, ByteView data) {
  header["__metadata__"].erase(kSealKey);
  return sha256(header.dump(), data);
}

/// JSON as nlohmann reads it, less two liberties: keys that occur twice, and a NUL byte as the end of text.
json parse_header(const std::string& file, std::string_view text) {
  if (text.find('\0') != std::string_view::npos) refuse(file, "its header holds a NUL byte");
  if (text.empty() || text.front() != '{') refuse(file, "its header does not start with '{'");
  std::vector<std::set<std::string>> keys;
  std::string twice;
  const auto watch = [&](int, json::parse_event_t event, json& parsed) {
    if (event == json::parse_event_t::object_start) keys.emplace_back();
    if (event == json::parse_event_t::object_end) keys.pop_back();
    if (event == json::parse_event_t::key && !keys.back().insert(parsed.get<std::string>()).second)
      twice = parsed.get<std::string>();
    return true;
  };
  json header = json::parse(text, watch, /*allow_exceptions=*/false);
  if (!header.is_object()) refuse(file, "its header is no JSON object");
  if (!twice.empty()) refuse(file, fmt::format("its header names '{}' twice", twice));
  return header;
}

std::map<std::string, std::string> read_metadata(const std::string& file, const json& header) {
  std::map<std::string, std::string> metadata;
  const auto found = header.find("__metadata__");
  if (found == header.end()) return metadata;
  if (!found->is_object()) refuse(file, "its __metadata__ is no JSON object");
  for (const auto& [key, value] : found->items()) {
    if (!value.is_string()) refuse(file, fmt::format("metadata '{}' is no text", key));
    metadata[key] = value.get<std::string>();
  }
  return metadata;
}

/// Reads one tensor's entry; every refusal names the tensor.
class EntryReader {
 public:
  EntryReader(const std::string& file, const std::string& tensor) : file_(file), tensor_(tensor) {}

  TensorView read(const json& entry, ByteView data) const {
    if (!entry.is_object() || entry.size() != 3 || !entry.contains("dtype") || !entry.contains("shape") ||
        !entry.contains("data_offsets"))
      complain("has an entry other than dtype, shape and data_offsets");
    TensorView view;
    view.name = tensor_;
    view.dtype = dtype(entry["dtype"]);
    view.shape = shape(entry["shape"]);
    view.bytes = bytes(entry["data_offsets"], data);
    const std::size_t wanted = byte_count(view);
    if (view.bytes.size() != wanted)
      complain(fmt::format("has {} bytes, but {} of shape {} takes {}", view.bytes.size(),
                           name_of(view.dtype), shape_text(view.shape), wanted));
    return view;
  }

 private:
  [[noreturn]] void complain(const std::string& words) const {
    refuse(file_, fmt::format("tensor '{}' {}", tensor_, words));
  }

  DType dtype(const json& value) const {
    for (std::size_t i = 0; i < kDTypes.size(); ++i)
      if (value.is_string() && value.get_ref<const std::string&>() == kDTypes[i].name)
        return static_cast<DType>(i);
    complain(fmt::format("has the number type {}, which is not known here", brief(value)));
  }

  std::vector<std::size_t> shape(const json& value) const {
    if (!value.is_array()) complain("has a shape that is no list");
    std::vector<std::size_t> shape;
    for (const json& extent : value) {
      if (!extent.is_number_unsigned())
        complain(fmt::format("has the extent {} in its shape", brief(extent)));
      shape.push_back(extent.get<std::size_t>());
    }
    return shape;
  }

  ByteView bytes(const json& value, ByteView data) const {
    if (!value.is_array() || value.size() != 2 || !value[0].is_number_unsigned() ||
        !value[1].is_number_unsigned())
      complain("has data_offsets that are not two whole numbers");
    const auto begin = value[0].get<std::uint64_t>(), end = value[1].get<std::uint64_t>();
    if (begin > end || end > data.size())
      complain(fmt::format("lies at bytes {} to {} of {}", begin, end, data.size()));
    return data.sub(begin, end - begin);
  }

  std::size_t byte_count(const TensorView& view) const {
    std::size_t count = size_of(view.dtype);
    for (const std::size_t extent : view.shape)
      if (__builtin_mul_overflow(count, extent, &count))
        complain(fmt::format("has shape {}, larger than memory", shape_text(view.shape)));
    return count;
  }

  const std::string& file_;
  const std::string& tensor_;
};

/// Tensors sorted by place; they must fill the data from end to end.
void check_coverage(const std::string& file, std::vector<TensorView>& tensors, ByteView data) {
  std::sort(tensors.begin(), tensors.end(), [](const TensorView& a, const TensorView& b) {
    return std::pair(a.bytes.data(), a.bytes.size()) < std::pair(b.bytes.data(), b.bytes.size());
  });
  const std::uint8_t* reached = data.begin();
  for (const TensorView& tensor : tensors) {
    if (tensor.bytes.data() != reached)
      refuse(file,
             fmt::format("tensor '{}' {}", tensor.name,
                         tensor.bytes.data() < reached ? "overlaps another one" : "leaves a hole before it"));
    reached = tensor.bytes.end();
  }
  if (reached != data.end())
    refuse(file, fmt::format("its last {} bytes belong to no tensor", data.end() - reached));
}

std::string_view header_text(const std::string& file, ByteView bytes) {
  if (bytes.size() < kLengthBytes)
    refuse(file, fmt::format("it has {} bytes, too few for a header", bytes.size()));
  const auto length = load_le<std::uint64_t>(bytes.data());
  if (length > kMaxHeaderBytes || length > bytes.size() - kLengthBytes)
    refuse(file, fmt::format("its header claims {} bytes, but the file has {}", length, bytes.size()));
  return {reinterpret_cast<const char*>(bytes.data()) + kLengthBytes, static_cast<std::size_t>(length)};
}

float from_f16(std::uint16_t half) {
  const int exponent = half >> 10 & 0x1f, mantissa = half & 0x3ff;
  const float sign = half & 0x8000 ? -1.f : 1.f;
  if (exponent == 0) return sign * std::ldexp(static_cast<float>(mantissa), -24);
  if (exponent == 31) return mantissa == 0 ? sign * HUGE_VALF : std::numeric_limits<float>::quiet_NaN();
  return sign * std::ldexp(static_cast<float>(mantissa + 1024), exponent - 25);
}

template <class To, class From>
To bit_cast(From from) {
  static_assert(sizeof(To) == sizeof(From));
  To to;
  std::memcpy(&to, &from, sizeof(to));
  return to;
}

float number_at(const TensorView& tensor, std::size_t i) {
  const std::uint8_t* p = tensor.bytes.data() + i * size_of(tensor.dtype);
  switch (tensor.dtype) {
    case DType::f32:
      return bit_cast<float>(load_le<std::uint32_t>(p));
    case DType::f64:
      return static_cast<float>(bit_cast<double>(load_le<std::uint64_t>(p)));
    case DType::bf16:
      return bit_cast<float>(std::uint32_t{load_le<std::uint16_t>(p)} << 16);
    default:
      return from_f16(load_le<std::uint16_t>(p));
  }
}

/// Owns a file descriptor.
class File {
 public:
  File(const std::filesystem::path& path, int flags) : fd_(::open(path.c_str(), flags | O_CLOEXEC, 0644)) {}
  ~File() { close(); }
  File(const File&) = delete;
  File& operator=(const File&) = delete;
  int fd() const { return fd_; }
  bool close() { return fd_ < 0 || ::close(std::exchange(fd_, -1)) == 0; }

 private:
  int fd_;
};

std::vector<std::uint8_t> read_whole(const std::filesystem::path& path) {
  const File file(path, O_RDONLY);
  if (file.fd() < 0)
    throw SetupError(
        errno == EACCES ? ExitStatus::no_permission : ExitStatus::no_input,
        fmt::format(
            "cannot open the weights file {}: {}; name a .safetensors file that is there, or make one "
            "with 'csipose model init'",
            path.string(), std::strerror(errno)));
  std::error_code failure;
  const std::uintmax_t size = std::filesystem::file_size(path, failure);
  if (failure)
    throw SetupError(ExitStatus::no_input,
                     fmt::format("{} is no weights file: {}", path.string(), failure.message()));
  std::vector<std::uint8_t> bytes(size);
  std::size_t have = 0;
  while (have < bytes.size()) {
    const ssize_t got = ::read(file.fd(), bytes.data() + have, bytes.size() - have);
    if (got < 0 && errno == EINTR) continue;
    if (got <= 0)
      throw SetupError(
          ExitStatus::io,
          fmt::format("reading the weights file {} stopped after {} of {} bytes: {}", path.string(), have,
                      size, got < 0 ? std::strerror(errno) : "it became shorter"));
    have += static_cast<std::size_t>(got);
  }
  return bytes;
}

bool write_all(int fd, ByteView bytes) {
  while (!bytes.empty()) {
    const ssize_t put = ::write(fd, bytes.data(), bytes.size());
    if (put < 0 && errno == EINTR) continue;
    if (put < 0) return false;
    bytes = bytes.sub(static_cast<std::size_t>(put));
  }
  return ::fsync(fd) == 0;
}

json header_of(const std::map<std::string, std::string>& metadata, const std::vector<TensorView>& tensors) {
  json header;
  header["__metadata__"] = metadata;
  std::size_t offset = 0;
  for (const TensorView& tensor : tensors) {
    assert(!header.contains(tensor.name));
    header[tensor.name] = {{"dtype", name_of(tensor.dtype)},
                           {"shape", tensor.shape},
                           {"data_offsets", {offset, offset + tensor.bytes.size()}}};
    offset += tensor.bytes.size();
  }
  return header;
}

}  // namespace

std::string_view name_of(DType dtype) { return kDTypes[static_cast<std::size_t>(dtype)].name; }
std::size_t size_of(DType dtype) { return kDTypes[static_cast<std::size_t>(dtype)].size; }
bool is_floating_point(DType dtype) {
  return dtype == DType::f64 || dtype == DType::f32 || dtype == DType::f16 || dtype == DType::bf16;
}
std::string shape_text(const std::vector<std::size_t>& shape) {
  return fmt::format("[{}]", fmt::join(shape, ", "));
}

std::vector<float> to_floats(const TensorView& tensor) {
  assert(is_floating_point(tensor.dtype));
  std::vector<float> numbers(tensor.elements());
  for (std::size_t i = 0; i < numbers.size(); ++i) numbers[i] = number_at(tensor, i);
  return numbers;
}

SafetensorsFile SafetensorsFile::read(const std::filesystem::path& path) {
  return parse(read_whole(path), path.string());
}

SafetensorsFile SafetensorsFile::parse(std::vector<std::uint8_t> bytes, const std::string& name) {
  SafetensorsFile file;
  file.name_ = name;
  file.bytes_ = std::move(bytes);
  const ByteView whole(file.bytes_);
  const std::string_view text = header_text(name, whole);
  const ByteView data = whole.sub(kLengthBytes + text.size());
  const json header = parse_header(name, text);
  file.metadata_ = read_metadata(name, header);
  for (const auto& [key, entry] : header.items())
    if (key != "__metadata__") file.tensors_.push_back(EntryReader(name, key).read(entry, data));
  check_coverage(name, file.tensors_, data);
  file.digest_ = sha256(whole, {});
  const auto claimed = file.metadata_.find(kSealKey);
  file.sealed_ = claimed != file.metadata_.end();
  if (file.sealed_ && claimed->second != seal(header, data))
    refuse(name, "its content does not have the SHA-256 that it carries");
  return file;
}

const TensorView* SafetensorsFile::find(std::string_view tensor) const {
  const auto found = std::find_if(tensors_.begin(), tensors_.end(),
                                  [&](const TensorView& view) { return view.name == tensor; });
  return found == tensors_.end() ? nullptr : &*found;
}

std::vector<std::uint8_t> pack_safetensors(std::map<std::string, std::string> metadata,
                                           const std::vector<TensorView>& tensors) {
  metadata.erase(kSealKey);
  json header = header_of(metadata, tensors);
  std::vector<std::uint8_t> data;
  for (const TensorView& tensor : tensors) data.insert(data.end(), tensor.bytes.begin(), tensor.bytes.end());
  header["__metadata__"][kSealKey] = seal(header, data);
  std::string text = header.dump();
  text.append((8 - text.size() % 8) % 8, ' ');  // the numbers start at a multiple of 8
  std::vector<std::uint8_t> file(kLengthBytes + text.size() + data.size());
  store_le<std::uint64_t>(file.data(), text.size());
  const auto after_text = std::copy(text.begin(), text.end(), file.begin() + kLengthBytes);
  std::copy(data.begin(), data.end(), after_text);
  return file;
}

void write_file_atomically(const std::filesystem::path& path, ByteView bytes) {
  const std::filesystem::path temporary = path.string() + fmt::format(".{}.tmp", ::getpid());
  File file(temporary, O_WRONLY | O_CREAT | O_TRUNC);
  if (file.fd() < 0)
    throw SetupError(
        ExitStatus::cannot_create,
        fmt::format("cannot create {}: {}; choose a folder that exists and that you may write to",
                    temporary.string(), std::strerror(errno)));
  if (!write_all(file.fd(), bytes) || !file.close() || ::rename(temporary.c_str(), path.c_str()) != 0) {
    const int cause = errno;
    ::unlink(temporary.c_str());
    throw SetupError(ExitStatus::io, fmt::format("writing {} did not end well: {}; nothing was changed",
                                                 path.string(), std::strerror(cause)));
  }
  const std::filesystem::path folder = path.has_parent_path() ? path.parent_path() : ".";
  const File directory(folder, O_RDONLY | O_DIRECTORY);
  if (directory.fd() >= 0)
    ::fsync(directory.fd());  // makes the rename durable where the file system needs telling
}

}  // namespace csipose
