// daemon/log.h - one event, one line on stderr: a sentence, then key=value; journal priority when systemd
// reads it.
//
// Levels by need of action: error = someone must act, warn = will degrade, info = state changes only. A line
// that repeats is folded: it is said once, and how often it came when it stops or once a minute. Any thread
// but the loop's.
#pragma once

#include <atomic>
#include <cstdint>
#include <map>
#include <mutex>
#include <string>
#include <string_view>

#include "proto/time.h"

namespace csipose {

enum class LogLevel : std::uint8_t { error, warn, info, debug };
LogLevel log_level_from(std::string_view name);

class Log {
 public:
  /// `descriptor`: where lines go, 2 in the daemon.
  explicit Log(int descriptor, LogLevel level = LogLevel::info);
  ~Log();

  void set_level(LogLevel level) { level_ = level; }
  void error(const std::string& line) { say(LogLevel::error, line); }
  void warn(const std::string& line) { say(LogLevel::warn, line); }
  void info(const std::string& line) { say(LogLevel::info, line); }
  void debug(const std::string& line) { say(LogLevel::debug, line); }
  void say(LogLevel level, const std::string& line);

  /// Says what was folded and is due at `now`; called now and then by the main thread.
  void flush_repeats(SteadyTime now);

 private:
  struct Repeat {
    LogLevel level{};
    std::uint64_t count = 0;
    SteadyTime first{};
  };
  void forget_said_before(SteadyTime instant);
  void write(LogLevel level, const std::string& line) const;
  void write_repeat(const std::string& line, const Repeat& repeat) const;

  const int descriptor_;
  const bool to_journal_;
  std::atomic<LogLevel> level_;
  std::mutex mutex_;
  std::map<std::string, Repeat> recent_;  ///< lines said in the last minute
};

}  // namespace csipose
