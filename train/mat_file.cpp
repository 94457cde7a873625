#include "train/mat_file.h"

#include <fmt/format.h>
#include <fmt/ranges.h>
#include <hdf5.h>

#include <cmath>
#include <span>
#include <system_error>

#include "train/refuse.h"

namespace csipose::train {
namespace {

namespace fs = std::filesystem;

constexpr const char* kDataset = "csi_out";
constexpr const char* kMembers[] = {"real", "imag"};
constexpr std::array<hsize_t, 4> kShape = {kSamples, kSubcarriers, kAntennas, kReceivers};

/// Something that the library has opened.
class Handle {
 public:
  Handle(hid_t id, herr_t (*close)(hid_t)) : id_(id), close_(close) {}
  ~Handle() {
    if (id_ >= 0) close_(id_);
  }
  Handle(const Handle&) = delete;
  Handle& operator=(const Handle&) = delete;
  explicit operator bool() const { return id_ >= 0; }
  hid_t get() const { return id_; }

 private:
  hid_t id_;
  herr_t (*close_)(hid_t);
};

/// The library neither prints its own errors nor loads filters that a file asks for.
void prepare_library() {
  static const bool prepared = [] {
    H5Eset_auto2(H5E_DEFAULT, nullptr, nullptr);
    H5PLset_loading_state(0);
    return true;
  }();
  (void)prepared;
}

/// For reading, without a lock: the disk may be read-only.
Handle open_file(const fs::path& path) {
  const Handle access(H5Pcreate(H5P_FILE_ACCESS), H5Pclose);
  H5Pset_file_locking(access.get(), false, true);
  return {H5Fopen(path.c_str(), H5F_ACC_RDONLY, access.get()), H5Fclose};
}

[[noreturn]] void refuse_file(const fs::path& path) {
  std::error_code error;
  const bool is_file = fs::is_regular_file(path, error);
  if (error || !is_file) refuse(path, error ? error.message() : "is no file", ExitStatus::no_input);
  if (H5Fis_hdf5(path.c_str()) > 0) refuse(path, "is damaged or cut short");
  refuse(path, "is no MATLAB v7.3 (HDF5) file");
}

void check_shape(const fs::path& path, hid_t dataset) {
  const Handle space(H5Dget_space(dataset), H5Sclose);
  std::array<hsize_t, H5S_MAX_RANK> sizes{};
  const int rank = H5Sget_simple_extent_dims(space.get(), sizes.data(), nullptr);
  const std::span<const hsize_t> shape(sizes.data(), static_cast<std::size_t>(std::max(rank, 0)));
  if (!std::equal(shape.begin(), shape.end(), kShape.begin(), kShape.end()))
    refuse(path, fmt::format("{} has the shape ({}), wanted ({})", kDataset, fmt::join(shape, ", "),
                             fmt::join(kShape, ", ")));
}

bool is_float(hid_t compound, const char* member) {
  const int index = H5Tget_member_index(compound, member);
  if (index < 0) return false;
  const Handle type(H5Tget_member_type(compound, static_cast<unsigned>(index)), H5Tclose);
  return H5Tget_class(type.get()) == H5T_FLOAT &&
         (H5Tget_size(type.get()) == 4 || H5Tget_size(type.get()) == 8);
}

void check_type(const fs::path& path, hid_t dataset) {
  const Handle type(H5Dget_type(dataset), H5Tclose);
  if (H5Tget_class(type.get()) != H5T_COMPOUND || !is_float(type.get(), kMembers[0]) ||
      !is_float(type.get(), kMembers[1]))
    refuse(path, fmt::format("{} is no compound of real and imag in float64 or float32", kDataset));
}

/// In the order of the file.
std::vector<std::complex<double>> read_numbers(const fs::path& path, hid_t dataset) {
  const Handle type(H5Tcreate(H5T_COMPOUND, sizeof(std::complex<double>)), H5Tclose);
  H5Tinsert(type.get(), kMembers[0], 0, H5T_NATIVE_DOUBLE);
  H5Tinsert(type.get(), kMembers[1], sizeof(double), H5T_NATIVE_DOUBLE);
  std::vector<std::complex<double>> numbers(kSamples * kSubcarriers * kAntennas * kReceivers);
  if (H5Dread(dataset, type.get(), H5S_ALL, H5S_ALL, H5P_DEFAULT, numbers.data()) < 0)
    refuse(path, fmt::format("{} cannot be read: the file is damaged or cut short", kDataset));
  return numbers;
}

}  // namespace

std::vector<StreamCsi> read_mat(const fs::path& path) {
  prepare_library();
  const Handle file = open_file(path);
  if (!file) refuse_file(path);
  const Handle dataset(H5Dopen2(file.get(), kDataset, H5P_DEFAULT), H5Dclose);
  if (!dataset) refuse(path, fmt::format("holds no array {}", kDataset));
  check_shape(path, dataset.get());
  check_type(path, dataset.get());
  const std::vector<std::complex<double>> numbers = read_numbers(path, dataset.get());

  std::vector<StreamCsi> csi(kSamples * kReceivers);
  const std::complex<double>* next = numbers.data();
  for (std::size_t t = 0; t < kSamples; ++t)
    for (std::size_t k = 0; k < kSubcarriers; ++k)
      for (std::size_t a = 0; a < kAntennas; ++a)
        for (std::size_t r = 0; r < kReceivers; ++r, ++next) {
          if (!std::isfinite(next->real()) || !std::isfinite(next->imag()))
            refuse(path, fmt::format("{} holds a number that is not finite", kDataset));
          csi[t * kReceivers + r][a][k] = *next;
        }
  return csi;
}

}  // namespace csipose::train
