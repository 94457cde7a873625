// An agent and a door with an adversary between them, who does what the input says. The door must never give out records
// that the agent did not seal, nor the same twice.
#include "proto/datagram.h"

#include <algorithm>
#include <cstdlib>
#include <set>

using namespace csipose;

namespace {

class Adversary {
 public:
  void act(std::uint8_t what, std::uint8_t argument, ByteView rest) {
    switch (what % 6) {
      case 0:
        return remember(agent_.due(now_, {}));
      case 1:
        return seal();
      case 2:
        return deliver(chosen(argument));
      case 3:
        return corrupt(argument, rest);
      case 4:
        return deliver({rest.begin(), rest.end()});
      default:
        now_ += std::chrono::milliseconds(20 * argument);
    }
  }

 private:
  using Bytes = std::vector<std::uint8_t>;
  void remember(ByteView datagram) {
    if (!datagram.empty()) seen_.emplace_back(datagram.begin(), datagram.end());
  }
  void seal() {
    std::uint8_t number[4];
    store_le<std::uint32_t>(number, ++sealed_);
    remember(agent_.seal({number, sizeof number}, now_, {}));
  }
  Bytes chosen(std::uint8_t back) const {
    return seen_.empty() ? Bytes{}
                         : seen_[seen_.size() - 1 - back % std::min<std::size_t>(seen_.size(), 256)];
  }
  void corrupt(std::uint8_t argument, ByteView rest) {
    Bytes datagram = chosen(argument);
    if (datagram.empty() || rest.size() < 2) return;
    datagram[rest[0] % datagram.size()] ^= rest[1];
    if (rest[1] != 0) deliver(datagram);
  }
  void deliver(const Bytes& datagram) {
    const ReceiverDoor::Answer answer = door_.receive(datagram, now_);
    if (answer.kind == ReceiverDoor::Kind::records) {
      if (answer.records.size() != 4) std::abort();
      const auto number = load_le<std::uint32_t>(answer.records.data());
      if (number == 0 || number > sealed_ || !given_.insert(number).second) std::abort();
    }
    if (answer.reply.size() > datagram.size()) std::abort();
    const Bytes reply(answer.reply.begin(), answer.reply.end());
    if (!reply.empty()) agent_.receive(reply, now_);
    agent_.receive(datagram, now_);  // reflected
  }

  SteadyTime now_{std::chrono::seconds(1)};
  ReceiverDoor door_{{{0, make_key()}}, {std::chrono::seconds(20), 50}};
  AgentSession agent_{make_key()};
  std::vector<Bytes> seen_;
  std::uint32_t sealed_ = 0;
  std::set<std::uint32_t> given_;

  static AgentKey make_key() {
    AgentKey key{"rx1", KeyKind::live, {}};
    key.secret.fill(7);
    return key;
  }
};

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  Adversary adversary;
  const ByteView input(data, size);
  for (std::size_t at = 0; at + 2 <= size && at < 2000; at += 2)
    adversary.act(input[at], input[at + 1], input.sub(at + 2, kMaxDatagram + 8));
  return 0;
}
