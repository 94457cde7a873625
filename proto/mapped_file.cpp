#include "proto/mapped_file.h"

#include <fcntl.h>
#include <sys/mman.h>
#include <sys/stat.h>

#include <cerrno>
#include <cstring>
#include <utility>

#include "proto/file_descriptor.h"
#include "proto/result.h"

namespace csipose {
namespace {

[[noreturn]] void refuse(const std::string& path) {
  const int error = errno;
  const ExitStatus status = error == ENOENT   ? ExitStatus::no_input
                            : error == EACCES ? ExitStatus::no_permission
                                              : ExitStatus::io;
  throw SetupError(status, "cannot read " + path + ": " + std::strerror(error));
}

}  // namespace

MappedFile::MappedFile(const std::string& path) {
  const FileDescriptor file(::open(path.c_str(), O_RDONLY | O_CLOEXEC));
  struct stat info {};
  if (!file || fstat(file.get(), &info) != 0) refuse(path);
  if (!S_ISREG(info.st_mode)) throw SetupError(ExitStatus::no_input, path + " is not a file");
  if (info.st_size == 0) return;
  const auto size = static_cast<std::size_t>(info.st_size);
  void* const memory = ::mmap(nullptr, size, PROT_READ, MAP_PRIVATE, file.get(), 0);
  if (memory == MAP_FAILED) refuse(path);
  bytes_ = ByteView(memory, size);
}
MappedFile::MappedFile(MappedFile&& other) noexcept : bytes_(std::exchange(other.bytes_, {})) {}
MappedFile& MappedFile::operator=(MappedFile&& other) noexcept {
  std::swap(bytes_, other.bytes_);
  return *this;
}
MappedFile::~MappedFile() {
  if (!bytes_.empty()) ::munmap(const_cast<std::uint8_t*>(bytes_.data()), bytes_.size());
}

}  // namespace csipose
