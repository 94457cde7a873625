#include "train/mapped_file.h"

#include <fcntl.h>
#include <fmt/format.h>
#include <sys/mman.h>
#include <sys/stat.h>
#include <unistd.h>

#include <cerrno>
#include <cstring>

#include "proto/result.h"

namespace csipose::train {

MappedFile::MappedFile(const std::filesystem::path& path) : begin_(MAP_FAILED) {
  const int file = ::open(path.c_str(), O_RDONLY | O_CLOEXEC);
  struct stat status {};
  if (file >= 0 && ::fstat(file, &status) == 0 && status.st_size > 0) {
    size_ = static_cast<std::size_t>(status.st_size);
    begin_ = ::mmap(nullptr, size_, PROT_READ, MAP_SHARED, file, 0);
  }
  const int reason = errno;
  if (file >= 0) ::close(file);
  if (begin_ == MAP_FAILED)
    throw SetupError(ExitStatus::no_input,
                     fmt::format("{} cannot be read: {}", path.string(),
                                 file >= 0 && size_ == 0 ? "it is empty" : std::strerror(reason)));
}

MappedFile::~MappedFile() { ::munmap(begin_, size_); }

}  // namespace csipose::train
