#include "proto/npy.h"

#include <unistd.h>

#include <bit>
#include <cerrno>
#include <charconv>
#include <cstring>
#include <iterator>
#include <optional>

namespace csipose {
namespace {

static_assert(std::endian::native == std::endian::little, "numbers are copied as they lie in the file");

constexpr std::string_view kMagic = "\x93NUMPY";
constexpr std::size_t kAlignment = 64;  // of the numbers, so that they can be mapped
constexpr std::size_t kMaxDimensions = 32;

/// The few words of Python that a header is made of. Each parse function takes what it knows off the front.
class HeaderParser {
 public:
  explicit HeaderParser(std::string_view text) : text_(text) {}

  Result<NpyView, std::string> parse() {
    if (!take("{")) return std::string("its header is not a dictionary");
    while (!take("}")) {
      if (!parse_item()) return std::string("its header cannot be read near \"") + near() + "\"";
      if (!take(",") && !starts("}")) return std::string("its header lacks a comma near \"") + near() + "\"";
    }
    skip_blanks();
    if (!text_.empty()) return std::string("text follows its header: \"") + near() + "\"";
    if (!descr_ || !fortran_order_ || !shape_)
      return std::string("its header lacks one of descr, fortran_order and shape");
    return NpyView{*descr_, *fortran_order_, *shape_, {}};
  }

 private:
  void skip_blanks() {
    while (!text_.empty() && (text_.front() == ' ' || text_.front() == '\n')) text_.remove_prefix(1);
  }
  bool starts(std::string_view word) {
    skip_blanks();
    return text_.starts_with(word);
  }
  bool take(std::string_view word) {
    if (!starts(word)) return false;
    text_.remove_prefix(word.size());
    return true;
  }
  std::string near() const { return std::string(text_.substr(0, 24)); }

  std::optional<std::string> parse_string() {
    for (const char quote : {'\'', '"'}) {
      if (!take(std::string_view(&quote, 1))) continue;
      const std::size_t end = text_.find(quote);
      if (end == std::string_view::npos) return std::nullopt;
      std::string word(text_.substr(0, end));
      text_.remove_prefix(end + 1);
      return word;
    }
    return std::nullopt;
  }

  bool parse_item() {
    const std::optional<std::string> key = parse_string();
    if (!key || !take(":")) return false;
    if (*key == "descr" && !descr_) return (descr_ = parse_string()).has_value();
    if (*key == "fortran_order" && !fortran_order_) return (fortran_order_ = parse_bool()).has_value();
    if (*key == "shape" && !shape_) return (shape_ = parse_shape()).has_value();
    return false;
  }

  std::optional<bool> parse_bool() {
    if (take("True")) return true;
    if (take("False")) return false;
    return std::nullopt;
  }

  std::optional<NpyShape> parse_shape() {
    if (!take("(")) return std::nullopt;
    NpyShape shape;
    while (!take(")")) {
      skip_blanks();
      std::size_t size = 0;
      const auto [end, error] = std::from_chars(text_.data(), text_.data() + text_.size(), size);
      if (error != std::errc() || shape.size() == kMaxDimensions) return std::nullopt;
      text_.remove_prefix(static_cast<std::size_t>(end - text_.data()));
      shape.push_back(size);
      // Python's (5) is a number, (5,) a shape.
      if (!take(",") && (shape.size() == 1 || !starts(")"))) return std::nullopt;
    }
    return shape;
  }

  std::string_view text_;
  std::optional<std::string> descr_;
  std::optional<bool> fortran_order_;
  std::optional<NpyShape> shape_;
};

/// Bytes per number of a type that we read; nullopt for all others.
std::optional<std::size_t> number_bytes(std::string_view descr) {
  static constexpr std::string_view kTypes[] = {"<f2", "<f4", "<f8", "<c8", "|i1", "|u1",
                                                "<i2", "<u2", "<i4", "<u4", "<i8", "<u8"};
  if (descr == "<c16") return 16;
  for (const std::string_view type : kTypes)
    if (descr == type) return static_cast<std::size_t>(type[2] - '0');
  return std::nullopt;
}

/// Bytes of an array, nullopt where they cannot be counted in 63 bits.
std::optional<std::size_t> array_bytes(const NpyShape& shape, std::size_t number) {
  std::size_t bytes = number;
  for (const std::size_t size : shape)
    if (__builtin_mul_overflow(bytes, size, &bytes) || bytes > SIZE_MAX / 2) return std::nullopt;
  return bytes;
}

std::string size_refusal(std::size_t wanted, std::size_t found) {
  return "its header promises " + std::to_string(wanted) + " bytes of numbers and " + std::to_string(found) +
         " are there";
}

/// As NumPy writes it, with NumPy's room for a first size of 21 digits.
std::string make_header(std::string_view descr, const NpyShape& shape) {
  constexpr std::size_t kRoomForFirstSize = 21;
  std::string text = "{'descr': '" + std::string(descr) + "', 'fortran_order': False, 'shape': (";
  for (std::size_t i = 0; i < shape.size(); ++i) text += (i == 0 ? "" : ", ") + std::to_string(shape[i]);
  text += shape.size() == 1 ? ",), }" : "), }";
  const std::size_t prefix = kMagic.size() + 4;
  const std::size_t room = kRoomForFirstSize - std::to_string(shape.front()).size();
  const std::size_t total = (prefix + text.size() + room + 1 + kAlignment - 1) / kAlignment * kAlignment;
  text.append(total - prefix - text.size() - 1, ' ');
  text += '\n';
  std::uint8_t length[2];
  store_le(length, static_cast<std::uint16_t>(text.size()));
  return std::string(kMagic) + '\1' + '\0' + static_cast<char>(length[0]) + static_cast<char>(length[1]) +
         text;
}

NpyShape with_rows(std::size_t rows, const NpyShape& row) {
  NpyShape shape{rows};
  shape.insert(shape.end(), row.begin(), row.end());
  return shape;
}

}  // namespace

std::size_t element_count(const NpyShape& shape) {
  std::size_t count = 1;
  for (const std::size_t size : shape) count *= size;
  return count;
}

Result<NpyView, std::string> parse_npy(ByteView file) {
  const std::string_view text(reinterpret_cast<const char*>(file.data()), file.size());
  if (!text.starts_with(kMagic) || file.size() < kMagic.size() + 6)
    return std::string("it is not a NumPy array file (.npy)");
  const unsigned major = file[6];
  if (major != 1 && major != 2)
    return "it is of version " + std::to_string(major) + "; versions 1 and 2 are known";
  const std::size_t prefix = kMagic.size() + (major == 1 ? 4 : 6);
  const std::size_t length =
      major == 1 ? load_le<std::uint16_t>(file.data() + 8) : load_le<std::uint32_t>(file.data() + 8);
  if (file.size() < prefix + length) return std::string("it ends inside its header");

  Result<NpyView, std::string> view = HeaderParser(text.substr(prefix, length)).parse();
  if (!view) return view;
  const std::optional<std::size_t> number = number_bytes(view->descr);
  if (!number) return "its numbers are of type " + view->descr + ", which is not supported";
  const std::optional<std::size_t> wanted = array_bytes(view->shape, *number);
  if (!wanted) return std::string("its shape is larger than any file");
  view->data = file.sub(prefix + length);
  if (view->data.size() != *wanted) return size_refusal(*wanted, view->data.size());
  return view;
}

namespace npy_detail {

void to_c_order(ByteView fortran, const NpyShape& shape, std::size_t size, std::uint8_t* c_order) {
  const std::size_t count = fortran.size() / size;
  std::vector<std::size_t> index(shape.size(), 0);
  for (std::size_t i = 0; i < count; ++i) {
    std::size_t from = 0;
    for (std::size_t d = shape.size(); d-- > 0;) from = from * shape[d] + index[d];
    std::memcpy(c_order + i * size, fortran.data() + from * size, size);
    for (std::size_t d = shape.size(); d-- > 0 && ++index[d] == shape[d];) index[d] = 0;
  }
}

std::string type_refusal(std::string_view found, std::string_view wanted) {
  return "its numbers are of type " + std::string(found) + ", wanted " + std::string(wanted);
}

std::vector<std::uint8_t> read_whole(const std::filesystem::path& path) {
  std::ifstream file(path, std::ios::binary);
  if (!file)
    throw SetupError(ExitStatus::no_input, "cannot open " + path.string() + ": " + std::strerror(errno));
  std::vector<std::uint8_t> bytes{std::istreambuf_iterator<char>(file), std::istreambuf_iterator<char>()};
  if (file.bad())
    throw SetupError(ExitStatus::io, "cannot read " + path.string() + ": " + std::strerror(errno));
  return bytes;
}

void refuse(const std::filesystem::path& path, const std::string& why) {
  throw SetupError(ExitStatus::bad_data, "cannot use " + path.string() + ": " + why);
}

}  // namespace npy_detail

NpyFile::NpyFile(std::filesystem::path path, std::string_view descr, std::size_t number_bytes, NpyShape row)
    : path_(std::move(path)),
      temporary_(path_.string() + ".part" + std::to_string(::getpid())),
      descr_(descr),
      row_(std::move(row)),
      row_bytes_(number_bytes * element_count(row_)),
      file_(temporary_, std::ios::binary | std::ios::trunc) {
  if (!file_)
    throw SetupError(ExitStatus::cannot_create,
                     "cannot create " + path_.string() + ": " + std::strerror(errno));
  const std::string header = make_header(descr_, with_rows(0, row_));
  file_.write(header.data(), static_cast<std::streamsize>(header.size()));
  check_written();
}

NpyFile::~NpyFile() {
  if (finished_) return;
  file_.close();
  std::error_code ignored;  // nobody is left to be told
  std::filesystem::remove(temporary_, ignored);
}

void NpyFile::append(ByteView rows) {
  assert(row_bytes_ == 0 ? rows.empty() : rows.size() % row_bytes_ == 0);
  file_.write(reinterpret_cast<const char*>(rows.data()), static_cast<std::streamsize>(rows.size()));
  check_written();
  data_bytes_ += rows.size();
}

void NpyFile::finish() {
  const std::string header = make_header(descr_, with_rows(rows(), row_));
  file_.seekp(0);
  file_.write(header.data(), static_cast<std::streamsize>(header.size()));
  file_.close();
  check_written();
  std::error_code error;
  std::filesystem::rename(temporary_, path_, error);
  if (error) throw SetupError(ExitStatus::io, "cannot write " + path_.string() + ": " + error.message());
  finished_ = true;
}

void NpyFile::check_written() const {
  if (!file_)
    throw SetupError(ExitStatus::io, "cannot write " + path_.string() + ": " + std::strerror(errno));
}

}  // namespace csipose
