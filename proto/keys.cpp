#include "proto/keys.h"

#include <fcntl.h>
#include <sodium.h>
#include <sys/stat.h>

#include <algorithm>
#include <cerrno>
#include <cstring>
#include <filesystem>
#include <iterator>
#include <limits>
#include <set>
#include <vector>

#include "proto/file_descriptor.h"

namespace csipose {
namespace {

constexpr std::size_t kMaxKeyFile = 256;
constexpr const char* kKindNames[] = {"live", "replay", "simulated"};  // KeyKind 1, 2, 3
const std::string kNewKey = "; make a new one with `csipose agent add`";

bool is_receiver_id(const std::string& name) {
  const auto allowed = [](char c) {
    return (c >= 'a' && c <= 'z') || (c >= '0' && c <= '9') || c == '-' || c == '_';
  };
  return !name.empty() && name.size() <= 32 && std::all_of(name.begin(), name.end(), allowed);
}

std::vector<std::string> words_of(ByteView text) {
  std::vector<std::string> words;
  bool inside = false;
  for (const std::uint8_t c : text) {
    const bool space = c == ' ' || c == '\n';
    if (!space && !inside) words.emplace_back();
    if (!space) words.back() += static_cast<char>(c);
    inside = !space;
  }
  return words;
}

bool parse_secret(const std::string& hex, Secret& secret) {
  std::size_t size = 0;
  return hex.size() == 2 * secret.size() &&
         sodium_hex2bin(secret.data(), secret.size(), hex.data(), hex.size(), nullptr, &size, nullptr) == 0 &&
         size == secret.size();
}

[[noreturn]] void refuse_to_open(const std::string& path) {
  const int error = errno;
  const ExitStatus status = error == ENOENT   ? ExitStatus::no_input
                            : error == EACCES ? ExitStatus::no_permission
                                              : ExitStatus::io;
  throw SetupError(status, "key file " + path + " cannot be read: " + std::strerror(error) +
                               (error == ENOENT ? kNewKey : "; run as the user it belongs to"));
}

void require_private(int fd, const std::string& path) {
  struct stat info {};
  if (fstat(fd, &info) != 0) refuse_to_open(path);
  if (!S_ISREG(info.st_mode))
    throw SetupError(ExitStatus::bad_data, "key file " + path + " is not a regular file" + kNewKey);
  if ((info.st_mode & 077) != 0)
    throw SetupError(ExitStatus::no_permission,
                     "key file " + path +
                         " may be read by others, so the key may be known; chmod 0400 it, or, if others "
                         "have used this machine," +
                         kNewKey.substr(1));
  if (info.st_uid != geteuid() && info.st_uid != 0)
    throw SetupError(
        ExitStatus::no_permission,
        "key file " + path + " belongs to another user; chown it to the user that runs this program");
}

std::vector<std::uint16_t> numbers_beside(const std::string& path) {
  require_sodium();
  std::vector<std::uint16_t> numbers;
  std::error_code error;
  for (const auto& file :
       std::filesystem::directory_iterator(std::filesystem::absolute(path, error).parent_path(), error)) {
    try {
      numbers.push_back(agent_number(load_agent_key(file.path().string())));
    } catch (const SetupError&) {
      // no key of this daemon's: configurations, sockets, keys that have come from elsewhere
    }
  }
  return numbers;
}

}  // namespace

const char* name(KeyKind kind) { return kKindNames[static_cast<int>(kind) - 1]; }

Result<AgentKey, std::string> parse_agent_key(ByteView text) {
  const std::vector<std::string> words = words_of(text);
  if (words.size() != 5 || words[0] != "csipose-key")
    return std::string("it is not one line of `csipose-key 1 KIND ID DIGITS`");
  if (words[1] != "1") return std::string("it has a version that this program does not know");
  AgentKey key;
  const auto* kind = std::find(std::begin(kKindNames), std::end(kKindNames), words[2]);
  if (kind == std::end(kKindNames))
    return std::string("its kind is none of `live`, `replay` and `simulated`");
  key.kind = static_cast<KeyKind>(1 + (kind - std::begin(kKindNames)));
  if (!is_receiver_id(words[3])) return std::string("its id is not 1 to 32 of a-z, 0-9, '-' and '_'");
  key.name = words[3];
  if (!parse_secret(words[4], key.secret)) return std::string("its secret is not 64 hexadecimal digits");
  return key;
}

AgentKey load_agent_key(const std::string& path) {
  const FileDescriptor file(::open(path.c_str(), O_RDONLY | O_CLOEXEC | O_NONBLOCK));
  if (!file) refuse_to_open(path);
  require_private(file.get(), path);
  std::array<char, kMaxKeyFile> text{};
  const ssize_t size = ::read(file.get(), text.data(), text.size());
  if (size < 0) refuse_to_open(path);
  auto key = parse_agent_key({text.data(), static_cast<std::size_t>(size)});
  sodium_memzero(text.data(), text.size());
  if (!key)
    throw SetupError(ExitStatus::bad_data, "key file " + path + " holds no key: " + key.error() + kNewKey);
  return *key;
}

AgentKey draw_agent_key(const std::string& name, KeyKind kind, const std::vector<std::uint16_t>& taken) {
  if (!is_receiver_id(name))
    throw SetupError(ExitStatus::usage,
                     "'" + name + "' cannot name a receiver: take 1 to 32 of a-z, 0-9, '-' and '_'");
  require_sodium();
  const std::set<std::uint16_t> numbers(taken.begin(), taken.end());
  if (numbers.size() > std::numeric_limits<std::uint16_t>::max())
    throw SetupError(ExitStatus::cannot_create,
                     "there are as many keys as numbers for them; remove those that no receiver has");
  AgentKey key;
  key.name = name;
  key.kind = kind;
  do randombytes_buf(key.secret.data(), key.secret.size());
  while (numbers.count(agent_number(key)) != 0);
  return key;
}

void create_agent_key(const std::string& path, const std::string& name, KeyKind kind) {
  const AgentKey key = draw_agent_key(name, kind, numbers_beside(path));
  std::array<char, 2 * sizeof(key.secret) + 1> hex{};
  sodium_bin2hex(hex.data(), hex.size(), key.secret.data(), key.secret.size());
  const std::string line =
      std::string("csipose-key 1 ") + csipose::name(kind) + " " + name + " " + hex.data() + "\n";

  const FileDescriptor file(::open(path.c_str(), O_WRONLY | O_CREAT | O_EXCL | O_CLOEXEC, 0400));
  if (!file)
    throw SetupError(ExitStatus::cannot_create,
                     "key file " + path + " cannot be made: " + std::strerror(errno) +
                         (errno == EEXIST ? "; remove it first if the receiver's old key shall end" : ""));
  if (::write(file.get(), line.data(), line.size()) != static_cast<ssize_t>(line.size()) ||
      ::fsync(file.get()) != 0) {
    const int error = errno;
    ::unlink(path.c_str());
    throw SetupError(ExitStatus::io, "key file " + path + " cannot be written: " + std::strerror(error));
  }
}

std::string agent_start_line(const std::string& key_path, const std::string& name,
                             const std::string& daemon_host, unsigned port) {
  return "scp -p " + daemon_host + ":" + key_path + " " + name + ".key && csipose-agent --id " + name +
         " --key " + name + ".key --to " + daemon_host + ":" + std::to_string(port);
}

}  // namespace csipose
