// tests/train/made_up_published.h - a miniature of the published data set, written here: layout, HDF5, labels.
#pragma once

#include <hdf5.h>

#include <array>
#include <complex>
#include <filesystem>
#include <fstream>
#include <string>
#include <vector>

#include "proto/npy.h"
#include "proto/pose.h"

namespace csipose::testing {

/// How a .mat file is made, by default as MATLAB makes one.
struct MatOptions {
  const char* dataset = "csi_out";
  std::vector<hsize_t> shape = {20, 30, 3, 3};
  hid_t number = H5T_IEEE_F64LE;  ///< of each part
  bool imag_first = false;
  bool compound = true;
  bool chunked = true;  ///< with deflate, behind a user block
};

/// Numbers of csi_out in the order of the file, distinct: what seed says.
inline std::vector<std::complex<double>> made_up_csi(unsigned seed) {
  std::vector<std::complex<double>> csi(20 * 30 * 3 * 3);
  for (std::size_t i = 0; i < csi.size(); ++i)
    csi[i] = std::polar(1 + static_cast<double>((i * 7 + seed) % 101) / 8,
                        static_cast<double>((i * 13 + seed) % 64) / 10);
  return csi;
}

inline void write_mat(const std::filesystem::path& path, const std::vector<std::complex<double>>& csi,
                      const MatOptions& options = {}) {
  const hid_t creation = H5Pcreate(H5P_FILE_CREATE);
  if (options.chunked) H5Pset_userblock(creation, 512);
  const hid_t file = H5Fcreate(path.c_str(), H5F_ACC_TRUNC, creation, H5P_DEFAULT);
  const std::size_t bytes = H5Tget_size(options.number);
  hid_t stored = H5Tcopy(options.number), given = H5Tcopy(H5T_NATIVE_DOUBLE);
  if (options.compound) {
    H5Tclose(stored), H5Tclose(given);
    stored = H5Tcreate(H5T_COMPOUND, 2 * bytes);
    H5Tinsert(stored, options.imag_first ? "imag" : "real", 0, options.number);
    H5Tinsert(stored, options.imag_first ? "real" : "imag", bytes, options.number);
    given = H5Tcreate(H5T_COMPOUND, sizeof(std::complex<double>));
    H5Tinsert(given, "real", 0, H5T_NATIVE_DOUBLE);
    H5Tinsert(given, "imag", sizeof(double), H5T_NATIVE_DOUBLE);
  }
  const hid_t space = H5Screate_simple(static_cast<int>(options.shape.size()), options.shape.data(), nullptr);
  const hid_t layout = H5Pcreate(H5P_DATASET_CREATE);
  if (options.chunked) {
    H5Pset_chunk(layout, static_cast<int>(options.shape.size()), options.shape.data());
    H5Pset_deflate(layout, 3);
  }
  const hid_t dataset = H5Dcreate2(file, options.dataset, stored, space, H5P_DEFAULT, layout, H5P_DEFAULT);
  H5Dwrite(dataset, given, H5S_ALL, H5S_ALL, H5P_DEFAULT, csi.data());
  H5Dclose(dataset), H5Pclose(layout), H5Sclose(space), H5Tclose(given), H5Tclose(stored);
  H5Fclose(file), H5Pclose(creation);
}

/// Numbers of `people`: joint j of person p at (p, j, 3).
inline std::vector<float> made_up_joints(std::size_t people) {
  std::vector<float> joints;
  for (std::size_t p = 0; p < people; ++p)
    for (std::size_t j = 0; j < kJoints; ++j)
      joints.insert(joints.end(), {static_cast<float>(p), static_cast<float>(j), 3});
  return joints;
}

/// root/SPLIT_data with the windows of `names`; their seeds count from 0. As many people as the names say.
inline void write_published_split(const std::filesystem::path& root, const std::string& split,
                                  const std::vector<std::string>& names) {
  const std::filesystem::path folder = root / (split + "_data");
  std::filesystem::create_directories(folder / "csi");
  std::filesystem::create_directories(folder / "keypoint");
  std::ofstream list(folder / (split + "_data_list.txt"));
  for (unsigned i = 0; i < names.size(); ++i) {
    list << names[i] << "\n";
    write_mat(folder / "csi" / (names[i] + ".mat"), made_up_csi(i));
    const auto people = static_cast<std::size_t>(names[i][2] - '0');
    write_npy<float>(folder / "keypoint" / (names[i] + ".npy"), {people, kJoints, 3}, made_up_joints(people));
  }
}

}  // namespace csipose::testing
