// tests/capture/dat_maker.h - csitool logs made here, byte by byte, for tests of whatever reads or sends
// them.
#pragma once

#include <cstdint>
#include <filesystem>
#include <fstream>
#include <string>
#include <vector>

#include "proto/frame_record.h"
#include "tests/capture/bytes.h"

namespace csipose::testing {

/// A 1x1 CSI record (95 bytes on disk) whose payload is all zero but valid in form.
inline Bytes csi_record(std::uint32_t timestamp_us, std::uint16_t bfee_count) {
  Bytes record(3 + 20 + 72);
  store_be16(record.data(), static_cast<std::uint16_t>(record.size() - 2));
  record[2] = 0xBB;
  store_le<std::uint32_t>(record.data() + 3, timestamp_us);
  store_le<std::uint16_t>(record.data() + 7, bfee_count);
  record[11] = record[12] = 1;  // Nrx, Ntx
  store_le<std::uint16_t>(record.data() + 19, 72);
  return record;
}

/// The frame of our own injector with this transmit counter.
inline Bytes frame_record(std::uint64_t counter) {
  const auto record = encode_csip_record({1, counter, 0});
  return {record.begin(), record.end()};
}

/// A folder that is removed with its files.
class Folder {
 public:
  Folder() {
    std::string pattern = (std::filesystem::temp_directory_path() / "csipose-test-XXXXXX").string();
    path_ = mkdtemp(pattern.data());
  }
  ~Folder() { std::filesystem::remove_all(path_); }
  std::string path(const std::string& name) const { return path_ + "/" + name; }
  std::string write(const std::string& name, const Bytes& bytes) const {
    std::ofstream(path(name), std::ios::binary)
        .write(reinterpret_cast<const char*>(bytes.data()), static_cast<std::streamsize>(bytes.size()));
    return path(name);
  }

 private:
  std::string path_;
};

}  // namespace csipose::testing
