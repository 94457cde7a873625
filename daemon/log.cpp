#include "daemon/log.h"

#include <fmt/chrono.h>
#include <fmt/format.h>
#include <unistd.h>

#include <array>
#include <cstdlib>

#include "proto/time.h"

namespace csipose {
namespace {

constexpr auto kFoldFor = std::chrono::minutes(1);
constexpr std::size_t kMostRecent = 256;  // distinct lines that are remembered for folding
constexpr std::array<std::string_view, 4> kNames = {"error", "warn", "info", "debug"};
constexpr std::array<int, 4> kJournalPriority = {3, 4, 6, 7};  // sd-daemon(3)

}  // namespace

LogLevel log_level_from(std::string_view name) {
  for (std::size_t i = 0; i < kNames.size(); ++i)
    if (kNames[i] == name) return static_cast<LogLevel>(i);
  return LogLevel::info;
}

Log::Log(int descriptor, LogLevel level)
    : descriptor_(descriptor), to_journal_(std::getenv("JOURNAL_STREAM") != nullptr), level_(level) {}

Log::~Log() { flush_repeats(SteadyTime::max()); }

void Log::say(LogLevel level, const std::string& line) {
  if (level > level_) return;
  const std::lock_guard lock(mutex_);
  if (recent_.size() >= kMostRecent) forget_said_before(SteadyTime::max());
  const auto [repeat, is_new] = recent_.try_emplace(line, Repeat{level, 0, steady_now()});
  if (is_new)
    write(level, line);
  else
    ++repeat->second.count;
}

void Log::flush_repeats(SteadyTime now) {
  const std::lock_guard lock(mutex_);
  forget_said_before(now - kFoldFor);
}

void Log::forget_said_before(SteadyTime instant) {
  std::erase_if(recent_, [&](const auto& entry) {
    if (entry.second.first > instant) return false;
    write_repeat(entry.first, entry.second);
    return true;
  });
}

void Log::write_repeat(const std::string& line, const Repeat& repeat) const {
  if (repeat.count > 0)
    write(repeat.level, fmt::format("{} (said {} more times in a minute)", line, repeat.count));
}

void Log::write(LogLevel level, const std::string& line) const {
  const auto index = static_cast<std::size_t>(level);
  const std::string head =
      to_journal_
          ? fmt::format("<{}>", kJournalPriority[index])
          : fmt::format("{:%H:%M:%S} {:<5} ", fmt::gmtime(std::chrono::system_clock::now()), kNames[index]);
  const std::string text = head + line + '\n';
  // Nobody to tell when stderr itself is gone.
  [[maybe_unused]] const ssize_t written = ::write(descriptor_, text.data(), text.size());
}

}  // namespace csipose
