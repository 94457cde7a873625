// sim/dataset.h - a folder of NumPy arrays that is written clip by clip, by many threads, and can be taken up again.
//
// Arrays have their full size from the start; a clip's rows have one place in them, so the bytes do not depend on who
// wrote what when. progress.bin holds one byte per clip that is done; dataset.json, which makes the folder a data set,
// is written last, and progress.bin goes. docs/simulator-dataset.md has the arrays.
#pragma once

#include <cstdint>
#include <filesystem>
#include <functional>
#include <map>
#include <string>
#include <vector>

#include "proto/bytes.h"
#include "proto/npy.h"

namespace csipose::sim {

/// One array: rows of `row` numbers of type `descr` (NumPy's name, `number_bytes` long each), one per frame.
struct ArrayPlan {
  std::string name, descr;
  std::size_t number_bytes = 1;
  NpyShape row;

  std::size_t row_bytes() const { return element_count(row) * number_bytes; }
};

struct DatasetPlan {
  std::filesystem::path folder;
  std::vector<std::uint32_t> clip_frames;  ///< how many frames each clip has
  std::vector<ArrayPlan> arrays;
  std::map<std::string, std::vector<std::uint32_t>> splits;  ///< clips of "train", "val", "test", ascending
  /// More for dataset.json: what the numbers of an array stand for.
  std::map<std::string, std::vector<std::string>> names;
  /// All that decides the bytes, for dataset.json; a folder begun with other words is not taken up.
  std::map<std::string, std::string> made_by;
};

/// A clip's rows, array by array, in the plan's order.
using ClipRows = std::vector<std::vector<std::uint8_t>>;

/// Adds numbers to a row, as they lie in memory.
template <class Number>
void append(std::vector<std::uint8_t>& row, const Number* values, std::size_t count) {
  const auto* bytes = reinterpret_cast<const std::uint8_t*>(values);
  row.insert(row.end(), bytes, bytes + count * sizeof(Number));
}

/// Whole clips: one in twenty for validation, one for test.
std::map<std::string, std::vector<std::uint32_t>> usual_splits(std::uint32_t clips);

class Dataset {
 public:
  /// Begins, or takes up what lies in the folder. Throws SetupError: cannot_create; bad_data when the folder holds something
  /// else or was begun differently.
  explicit Dataset(DatasetPlan plan);
  ~Dataset();
  Dataset(const Dataset&) = delete;
  Dataset& operator=(const Dataset&) = delete;

  /// Whole already: nothing is left to do.
  bool finished() const { return finished_; }
  std::uint32_t clips() const { return static_cast<std::uint32_t>(done_.size()); }
  bool has(std::uint32_t clip) const { return done_[clip] != 0; }
  /// Safe from several threads, each clip once. Throws SetupError (io), for example when the disk is full.
  void write(std::uint32_t clip, const ClipRows& rows);
  /// When all clips are there: digests, dataset.json.
  void finish();

 private:
  void create_arrays();
  void open_arrays();
  std::filesystem::path array_path(const ArrayPlan& array) const;
  std::string manifest() const;

  DatasetPlan plan_;
  std::vector<int> files_;
  std::vector<std::size_t> data_at_;
  std::vector<char> done_;
  std::vector<std::size_t> first_frame_;  ///< of each clip; at the end, of all
  int progress_ = -1;
  bool finished_ = false;
};

/// Calls make(clip) for each clip that is missing, on `threads` threads, and writes what it gives; `report(done, clips)`
/// with clips after each, one call at a time. The first exception ends all and is thrown on.
void fill(Dataset& dataset, unsigned threads, const std::function<ClipRows(std::uint32_t)>& make,
          const std::function<void(std::uint32_t, std::uint32_t)>& report);

}  // namespace csipose::sim
