#include "daemon/child_process.h"

#include <fcntl.h>
#include <fmt/format.h>
#include <signal.h>
#include <spawn.h>
#include <sys/wait.h>
#include <unistd.h>

#include <cerrno>
#include <cstdlib>
#include <cstring>
#include <deque>
#include <fstream>
#include <thread>

#include "proto/result.h"

namespace csipose {
namespace {

/// posix_spawn's list of what happens to descriptors, freed at the end of the scope.
struct FileActions {
  FileActions() { posix_spawn_file_actions_init(&actions); }
  ~FileActions() { posix_spawn_file_actions_destroy(&actions); }
  posix_spawn_file_actions_t actions;
};

struct SpawnAttributes {
  SpawnAttributes() { posix_spawnattr_init(&value); }
  ~SpawnAttributes() { posix_spawnattr_destroy(&value); }
  posix_spawnattr_t value;
};

int shell_status(int status) { return WIFSIGNALED(status) ? 128 + WTERMSIG(status) : WEXITSTATUS(status); }

pid_t spawn(const std::string& program, const std::vector<std::string>& arguments,
            const std::filesystem::path& log) {
  std::vector<char*> argv{const_cast<char*>(program.c_str())};
  for (const std::string& argument : arguments) argv.push_back(const_cast<char*>(argument.c_str()));
  argv.push_back(nullptr);
  FileActions files;
  SpawnAttributes attributes;
  if (!log.empty()) {
    posix_spawnattr_setflags(&attributes.value, POSIX_SPAWN_SETPGROUP);  // Ctrl-C is not for it
    posix_spawn_file_actions_addopen(&files.actions, STDOUT_FILENO, log.c_str(), O_WRONLY | O_CREAT | O_TRUNC,
                                     0600);
    posix_spawn_file_actions_adddup2(&files.actions, STDOUT_FILENO, STDERR_FILENO);
  }
  pid_t pid = -1;
  const int error =
      posix_spawn(&pid, program.c_str(), &files.actions, &attributes.value, argv.data(), environ);
  if (error != 0)
    throw SetupError(ExitStatus::os_refusal,
                     fmt::format("cannot start {}: {}", program, std::strerror(error)));
  return pid;
}

}  // namespace

PrivateFolder::PrivateFolder() {
  std::string name = (std::filesystem::temp_directory_path() / "csipose-XXXXXX").string();
  if (mkdtemp(name.data()) == nullptr)
    throw SetupError(ExitStatus::cannot_create,
                     fmt::format("cannot make the folder {}: {}; set TMPDIR to one that can be written", name,
                                 std::strerror(errno)));
  path_ = name;
}

PrivateFolder::~PrivateFolder() {
  std::error_code ignored;  // a leftover in the temporary folder is no reason to fail
  std::filesystem::remove_all(path_, ignored);
}

ChildProcess::ChildProcess(const std::string& program, const std::vector<std::string>& arguments,
                           const std::filesystem::path& log)
    : name_(std::filesystem::path(program).filename()), log_(log), pid_(spawn(program, arguments, log)) {}

ChildProcess::~ChildProcess() {
  ask_to_stop();
  if (!wait_for(std::chrono::seconds(3))) kill(pid_, SIGKILL);
  wait();
}

std::optional<int> ChildProcess::ended() {
  int status = 0;
  if (!status_ && waitpid(pid_, &status, WNOHANG) == pid_) status_ = shell_status(status);
  return status_;
}

int ChildProcess::wait() {
  int status = 0;
  while (!status_)
    if (waitpid(pid_, &status, 0) == pid_) status_ = shell_status(status);
  return *status_;
}

std::optional<int> ChildProcess::wait_for(std::chrono::nanoseconds patience) {
  const auto deadline = std::chrono::steady_clock::now() + patience;
  while (!ended() && std::chrono::steady_clock::now() < deadline)
    std::this_thread::sleep_for(std::chrono::milliseconds(10));
  return ended();
}

std::string ChildProcess::last_words(std::size_t lines) const {
  std::ifstream in(log_);
  std::deque<std::string> last;
  for (std::string line; std::getline(in, line);) {
    last.push_back("  " + line + "\n");
    if (last.size() > lines) last.pop_front();
  }
  return fmt::format("{}", fmt::join(last, ""));
}

void ChildProcess::ask_to_stop() const {
  if (!status_) kill(pid_, SIGTERM);
}

}  // namespace csipose
