#include "sim/dataset.h"

#include <fcntl.h>
#include <fmt/core.h>
#include <fmt/ranges.h>
#include <sodium/crypto_hash_sha256.h>
#include <unistd.h>

#include <algorithm>
#include <atomic>
#include <cassert>
#include <cerrno>
#include <cstring>
#include <exception>
#include <fstream>
#include <mutex>
#include <nlohmann/json.hpp>
#include <numeric>
#include <system_error>
#include <thread>

#include "proto/result.h"
#include "sim/atomic_file.h"

namespace csipose::sim {
namespace {
namespace fs = std::filesystem;

constexpr const char* kManifest = "dataset.json";
constexpr const char* kProgress = "progress.bin";
constexpr const char* kPlan = "begun.json";

int open_for(const fs::path& path, int flags) {
  const int file = ::open(path.c_str(), flags | O_CLOEXEC, 0644);
  if (file < 0)
    throw SetupError(ExitStatus::cannot_create,
                     fmt::format("cannot open {} for writing: {}", path.string(), std::strerror(errno)));
  return file;
}

void write_at(int file, ByteView bytes, std::size_t offset, const fs::path& path) {
  for (std::size_t done = 0; done < bytes.size();) {
    const ssize_t n =
        ::pwrite(file, bytes.data() + done, bytes.size() - done, static_cast<off_t>(offset + done));
    if (n < 0 && errno == EINTR) continue;
    if (n <= 0)
      throw SetupError(
          ExitStatus::io,
          fmt::format(
              "cannot write to {}: {}; free some space and run the same command again: it goes on where "
              "it stopped",
              path.string(), std::strerror(errno)));
    done += static_cast<std::size_t>(n);
  }
}

/// NumPy format 1.0: magic, version, header length, then a Python literal padded to 64 bytes.
std::string npy_header(const std::string& descr, const NpyShape& shape) {
  std::string dims;
  for (const std::size_t n : shape) dims += fmt::format("{}{}", dims.empty() ? "" : ", ", n);
  if (shape.size() == 1) dims += ",";
  std::string text = fmt::format("{{'descr': '{}', 'fortran_order': False, 'shape': ({}), }}", descr, dims);
  text.resize((10 + text.size() + 1 + 63) / 64 * 64 - 10 - 1, ' ');
  text += '\n';
  std::string header("\x93NUMPY\x01\x00", 8);
  header += static_cast<char>(text.size() & 0xFF);
  header += static_cast<char>(text.size() >> 8);
  return header + text;
}

std::string read_text(const fs::path& path) {
  std::ifstream in(path, std::ios::binary);
  return {std::istreambuf_iterator<char>(in), {}};
}

std::string sha256_of(const fs::path& path) {
  crypto_hash_sha256_state state;
  crypto_hash_sha256_init(&state);
  std::ifstream in(path, std::ios::binary);
  std::vector<char> buffer(1 << 20);
  while (in.read(buffer.data(), static_cast<std::streamsize>(buffer.size())) || in.gcount() > 0)
    crypto_hash_sha256_update(&state, reinterpret_cast<const unsigned char*>(buffer.data()),
                              static_cast<unsigned long long>(in.gcount()));
  unsigned char digest[crypto_hash_sha256_BYTES];
  crypto_hash_sha256_final(&state, digest);
  std::string hex;
  for (const unsigned char byte : digest) hex += fmt::format("{:02x}", byte);
  return hex;
}

void write_text(const fs::path& path, const std::string& text) {
  AtomicFile file(path);
  file.write(text);
  file.commit();
}

nlohmann::ordered_json plan_json(const DatasetPlan& plan) {
  nlohmann::ordered_json json;
  json["format"] = "csipose-dataset 1";
  json["clips"] = plan.clip_frames.size();
  json["frames"] = std::accumulate(plan.clip_frames.begin(), plan.clip_frames.end(), std::uint64_t{0});
  json["made_by"] = plan.made_by;
  for (const auto& [array, names] : plan.names) json["names"][array] = names;
  // Runs [first, last] of clips.
  for (const auto& [split, clips] : plan.splits) {
    json["splits"][split] = nlohmann::ordered_json::array();
    for (std::size_t i = 0; i < clips.size();) {
      std::size_t end = i + 1;
      while (end < clips.size() && clips[end] == clips[end - 1] + 1) ++end;
      json["splits"][split].push_back({clips[i], clips[end - 1]});
      i = end;
    }
  }
  // Runs [clips, frames each].
  json["clip_frames"] = nlohmann::ordered_json::array();
  for (const std::uint32_t frames : plan.clip_frames) {
    auto& runs = json["clip_frames"];
    if (runs.empty() || runs.back()[1] != frames) runs.push_back({0, frames});
    runs.back()[0] = runs.back()[0].get<std::uint64_t>() + 1;
  }
  for (const ArrayPlan& array : plan.arrays)
    json["arrays"][array.name + ".npy"] = {{"dtype", array.descr}, {"row", array.row}};
  return json;
}

/// What a manifest says otherwise of how it was made: ", whose seed is 1 and not 2".
std::string other_maker(const nlohmann::ordered_json& manifest, const DatasetPlan& plan) {
  std::vector<std::string> differences;
  for (const auto& [what, ours] : plan.made_by) {
    const nlohmann::ordered_json::json_pointer place(fmt::format("/plan/made_by/{}", what));
    if (!manifest.is_structured() || !manifest.contains(place)) continue;
    const std::string theirs =
        manifest[place].is_string() ? manifest[place].get<std::string>() : manifest[place].dump();
    if (theirs != ours) differences.push_back(fmt::format("{} is {} and not {}", what, theirs, ours));
  }
  return differences.empty() ? "" : fmt::format(", whose {}", fmt::join(differences, ", "));
}

}  // namespace

Dataset::Dataset(DatasetPlan plan)
    : plan_(std::move(plan)), done_(plan_.clip_frames.size(), 0), first_frame_{0} {
  for (const std::uint32_t frames : plan_.clip_frames) first_frame_.push_back(first_frame_.back() + frames);
  make_folder(plan_.folder);
  const std::string ours = plan_json(plan_).dump(1) + "\n";
  const fs::path begun = plan_.folder / kPlan, manifest = plan_.folder / kManifest;
  if (fs::exists(manifest)) {
    const auto there = nlohmann::ordered_json::parse(read_text(manifest), nullptr, false);
    if (!there.is_object() || !there.contains("plan") || there["plan"] != plan_json(plan_))
      throw SetupError(
          ExitStatus::bad_data,
          fmt::format(
              "{} already holds another data set{}; choose another folder with --out, or delete this one",
              plan_.folder.string(), other_maker(there, plan_)));
    finished_ = true;
    std::fill(done_.begin(), done_.end(), 1);
    return;
  }
  if (fs::exists(begun)) {
    if (read_text(begun) != ours)
      throw SetupError(
          ExitStatus::bad_data,
          fmt::format(
              "{} was begun by a different command ({} says which); finish it with that one, choose another "
              "folder, or delete this one",
              plan_.folder.string(), begun.string()));
  } else {
    create_arrays();
    write_text(begun, ours);
  }
  open_arrays();
}

Dataset::~Dataset() {
  for (const int file : files_) ::close(file);
  if (progress_ >= 0) ::close(progress_);
}

fs::path Dataset::array_path(const ArrayPlan& array) const { return plan_.folder / (array.name + ".npy"); }

void Dataset::create_arrays() {
  const std::size_t frames = first_frame_.back();
  for (const ArrayPlan& array : plan_.arrays) {
    NpyShape shape{frames};
    shape.insert(shape.end(), array.row.begin(), array.row.end());
    const std::string header = npy_header(array.descr, shape);
    const int file = open_for(array_path(array), O_WRONLY | O_CREAT | O_TRUNC);
    write_at(file, header, 0, array_path(array));
    const int grown = ::ftruncate(file, static_cast<off_t>(header.size() + frames * array.row_bytes()));
    ::close(file);
    if (grown != 0)
      throw SetupError(ExitStatus::io, fmt::format("{} cannot grow to its size: {}",
                                                   array_path(array).string(), std::strerror(errno)));
  }
  const int progress = open_for(plan_.folder / kProgress, O_WRONLY | O_CREAT | O_TRUNC);
  write_at(progress, done_, 0, plan_.folder / kProgress);
  ::close(progress);
}

void Dataset::open_arrays() {
  const std::size_t frames = first_frame_.back();
  for (const ArrayPlan& array : plan_.arrays) {
    files_.push_back(open_for(array_path(array), O_WRONLY));
    data_at_.push_back(fs::file_size(array_path(array)) - frames * array.row_bytes());
  }
  const std::string progress = read_text(plan_.folder / kProgress);
  if (progress.size() != done_.size())
    throw SetupError(ExitStatus::bad_data,
                     fmt::format("{} is damaged: {} bytes where one per clip, {}, are due; delete the folder "
                                 "and begin again",
                                 (plan_.folder / kProgress).string(), progress.size(), done_.size()));
  std::copy(progress.begin(), progress.end(), done_.begin());
  progress_ = open_for(plan_.folder / kProgress, O_WRONLY);
}

void Dataset::write(std::uint32_t clip, const ClipRows& rows) {
  assert(rows.size() == plan_.arrays.size());
  for (std::size_t i = 0; i < rows.size(); ++i) {
    const std::size_t row = plan_.arrays[i].row_bytes();
    assert(rows[i].size() == row * plan_.clip_frames[clip]);
    write_at(files_[i], rows[i], data_at_[i] + first_frame_[clip] * row, array_path(plan_.arrays[i]));
  }
  done_[clip] = 1;
  write_at(progress_, ByteView("\x01", 1), clip, plan_.folder / kProgress);
}

std::string Dataset::manifest() const {
  nlohmann::ordered_json json;
  json["plan"] = plan_json(plan_);
  for (const ArrayPlan& array : plan_.arrays)
    json["sha256"][array.name + ".npy"] = sha256_of(array_path(array));
  return json.dump(1) + "\n";
}

void Dataset::finish() {
  assert(std::all_of(done_.begin(), done_.end(), [](char done) { return done != 0; }));
  if (finished_) return;
  write_text(plan_.folder / kManifest, manifest());
  fs::remove(plan_.folder / kProgress);
  fs::remove(plan_.folder / kPlan);
  finished_ = true;
}

std::map<std::string, std::vector<std::uint32_t>> usual_splits(std::uint32_t clips) {
  std::map<std::string, std::vector<std::uint32_t>> splits{{"train", {}}, {"val", {}}, {"test", {}}};
  for (std::uint32_t clip = 0; clip < clips; ++clip)
    splits[clip % 20 == 18 ? "val" : clip % 20 == 19 ? "test" : "train"].push_back(clip);
  return splits;
}

void fill(Dataset& dataset, unsigned threads, const std::function<ClipRows(std::uint32_t)>& make,
          const std::function<void(std::uint32_t, std::uint32_t)>& report) {
  const std::uint32_t clips = dataset.clips();
  std::vector<std::uint32_t> missing;
  for (std::uint32_t clip = 0; clip < clips; ++clip)
    if (!dataset.has(clip)) missing.push_back(clip);
  std::atomic<std::size_t> next{0};
  std::mutex mutex;
  std::uint32_t done = clips - static_cast<std::uint32_t>(missing.size());
  std::exception_ptr failure;
  const auto work = [&] {
    try {
      for (std::size_t i = next++; i < missing.size(); i = next++) {
        const ClipRows rows = make(missing[i]);
        dataset.write(missing[i], rows);
        const std::lock_guard lock(mutex);
        report(++done, clips);
      }
    } catch (...) {
      const std::lock_guard lock(mutex);
      if (!failure) failure = std::current_exception();
      next = missing.size();
    }
  };
  std::vector<std::thread> workers;
  for (unsigned i = 1; i < threads; ++i) workers.emplace_back(work);
  work();
  for (std::thread& worker : workers) worker.join();
  if (failure) std::rethrow_exception(failure);
}

}  // namespace csipose::sim
