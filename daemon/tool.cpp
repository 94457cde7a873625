#include "daemon/tool.h"

#include <fmt/format.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cstring>
#include <filesystem>
#include <numeric>

namespace csipose {
namespace {

/// Letters to change, insert, drop or swap with their neighbour to make one word of the other.
std::size_t edit_distance(const std::string& a, const std::string& b) {
  std::vector<std::vector<std::size_t>> d(a.size() + 1, std::vector<std::size_t>(b.size() + 1));
  for (std::size_t i = 0; i <= a.size(); ++i) d[i][0] = i;
  for (std::size_t j = 0; j <= b.size(); ++j) d[0][j] = j;
  for (std::size_t i = 1; i <= a.size(); ++i)
    for (std::size_t j = 1; j <= b.size(); ++j) {
      const std::size_t changed = d[i - 1][j - 1] + (a[i - 1] == b[j - 1] ? 0 : 1);
      d[i][j] = std::min({d[i - 1][j] + 1, d[i][j - 1] + 1, changed});
      if (i > 1 && j > 1 && a[i - 1] == b[j - 2] && a[i - 2] == b[j - 1])
        d[i][j] = std::min(d[i][j], d[i - 2][j - 2] + 1);
    }
  return d[a.size()][b.size()];
}

}  // namespace

ToolOptions& mutable_tool_options() {
  static ToolOptions options;
  return options;
}
const ToolOptions& tool_options() { return mutable_tool_options(); }

std::string sibling_program(const std::string& name) {
  std::error_code error;
  const auto self = std::filesystem::read_symlink("/proc/self/exe", error);
  const auto path = self.parent_path() / name;
  if (error || access(path.c_str(), X_OK) != 0)
    throw SetupError(
        ExitStatus::unavailable,
        fmt::format("{0} is not there: it should lie beside csipose as {1}. Build it (cmake --build --preset "
                    "release --target {0}) or install the package that has it.",
                    name, path.string()));
  return path;
}

std::string shipped_weights() {
  std::error_code error;
  const auto self = std::filesystem::read_symlink("/proc/self/exe", error);
  const auto path = self.parent_path().parent_path() / "share/csiposed/models/simulated-rooms.safetensors";
  return !error && std::filesystem::exists(path, error) ? path.string() : "";
}

void become_sibling(const std::string& name, const std::vector<std::string>& arguments) {
  std::string path = sibling_program(name);
  std::vector<std::string> words = arguments;
  std::vector<char*> argv{path.data()};
  for (std::string& word : words) argv.push_back(word.data());
  argv.push_back(nullptr);
  execv(path.c_str(), argv.data());
  throw SetupError(ExitStatus::os_refusal,
                   fmt::format("{} cannot be started: {}.", path, std::strerror(errno)));
}

void require_free(const std::string& file, bool force) {
  if (force || !std::filesystem::exists(file)) return;
  throw SetupError(ExitStatus::cannot_create,
                   fmt::format("{} is there already; name another file, or say --force to replace it", file));
}

std::string nearest_word(const std::string& word, const std::vector<std::string>& known) {
  std::string nearest;
  std::size_t least = std::max<std::size_t>(1, word.size() / 3) + 1;  // further away is another word
  for (const std::string& candidate : known) {
    const std::size_t distance = edit_distance(word, candidate);
    if (distance < least) least = distance, nearest = candidate;
  }
  return nearest;
}

}  // namespace csipose
