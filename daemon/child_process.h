// daemon/child_process.h - a program that runs beside us and ends when we do.
#pragma once

#include <sys/types.h>

#include <chrono>
#include <filesystem>
#include <optional>
#include <string>
#include <vector>

namespace csipose {

/// A folder that only we can read, gone with all that is in it. Throws SetupError when it cannot be made.
class PrivateFolder {
 public:
  PrivateFolder();
  ~PrivateFolder();
  PrivateFolder(const PrivateFolder&) = delete;
  PrivateFolder& operator=(const PrivateFolder&) = delete;
  std::filesystem::path operator/(const std::string& name) const { return path_ / name; }
  const std::filesystem::path& path() const { return path_; }

 private:
  std::filesystem::path path_;
};

/// Starts on construction; asked to stop (SIGTERM), and after three seconds made to, on destruction.
class ChildProcess {
 public:
  /// `log`: file that takes its stdout and stderr; empty = it shares ours and
  /// hears Ctrl-C. Throws SetupError when it cannot be started.
  ChildProcess(const std::string& program, const std::vector<std::string>& arguments,
               const std::filesystem::path& log);
  ~ChildProcess();
  ChildProcess(const ChildProcess&) = delete;
  ChildProcess& operator=(const ChildProcess&) = delete;

  const std::string& name() const { return name_; }
  const std::filesystem::path& log() const { return log_; }
  /// Exit status if it has ended (128 + signal when one ended it), as a shell gives it.
  std::optional<int> ended();
  int wait();
  /// For as long as `patience`; nullopt when it still runs.
  std::optional<int> wait_for(std::chrono::nanoseconds patience);
  void ask_to_stop() const;
  /// The last lines of its log.
  std::string last_words(std::size_t lines = 5) const;

 private:
  std::string name_;
  std::filesystem::path log_;
  pid_t pid_ = -1;
  std::optional<int> status_;
};

}  // namespace csipose
