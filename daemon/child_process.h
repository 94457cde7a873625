// daemon/child_process.h - a program that runs beside us and ends when we do.
#pragma once

#include <sys/types.h>

#include <chrono>
#include <filesystem>
#include <optional>
#include <string>
#include <vector>

namespace csipose {

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
  void ask_to_stop() const;

 private:
  std::string name_;
  std::filesystem::path log_;
  pid_t pid_ = -1;
  std::optional<int> status_;
};

}  // namespace csipose
