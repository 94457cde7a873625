#include "sim/atomic_file.h"

#include <fmt/core.h>

#include <cerrno>
#include <cstring>
#include <system_error>

#include "proto/result.h"

namespace csipose::sim {

AtomicFile::AtomicFile(std::filesystem::path target) : target_(std::move(target)), part_(target_) {
  part_ += ".part";
  errno = 0;
  out_.open(part_, std::ios::binary | std::ios::trunc);
  if (!out_)
    throw SetupError(ExitStatus::cannot_create,
                     fmt::format("cannot write {}: {}; choose a folder that you may write to", part_.string(),
                                 std::strerror(errno)));
}

AtomicFile::~AtomicFile() {
  if (committed_) return;
  out_.close();
  std::error_code ignored;
  std::filesystem::remove(part_, ignored);
}

void AtomicFile::write(ByteView bytes) {
  out_.write(reinterpret_cast<const char*>(bytes.data()), static_cast<std::streamsize>(bytes.size()));
}

void AtomicFile::commit() {
  errno = 0;
  out_.close();  // flushes; any earlier failed write shows here too
  if (!out_)
    throw SetupError(ExitStatus::io, fmt::format("{} could not be written whole: {}; nothing is left of it",
                                                 target_.string(), std::strerror(errno)));
  std::error_code error;
  std::filesystem::rename(part_, target_, error);
  if (error)
    throw SetupError(ExitStatus::cannot_create, fmt::format("{} is written but cannot take its name: {}",
                                                            part_.string(), error.message()));
  committed_ = true;
}

void make_folder(const std::filesystem::path& folder) {
  std::error_code error;
  std::filesystem::create_directories(folder, error);
  if (error)
    throw SetupError(ExitStatus::cannot_create,
                     fmt::format("cannot make the folder {}: {}; choose another with --out", folder.string(),
                                 error.message()));
}

}  // namespace csipose::sim
