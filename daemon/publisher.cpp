#include "daemon/publisher.h"

#include <fmt/format.h>
#include <poll.h>
#include <sys/eventfd.h>
#include <sys/socket.h>
#include <sys/uio.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <atomic>
#include <cassert>
#include <cerrno>
#include <cstring>
#include <mutex>
#include <optional>
#include <thread>

#include "daemon/spsc_ring.h"
#include "proto/time.h"
#include "proto/unix_socket.h"

namespace csipose {
namespace {

constexpr auto kHousekeeping = std::chrono::milliseconds(100);  // how late an idle client may be noticed
constexpr auto kLossLogPause = std::chrono::minutes(1);
constexpr int kSendBufferBytes = 32 * 1024;  // small: what lies in the kernel is old when it is read
constexpr std::size_t kReadBytes = 4096;

/// Wakes the thread that polls `wake`.
void ring_the_bell(int wake) {
  const std::uint64_t one = 1;
  [[maybe_unused]] const ssize_t woken = write(wake, &one, sizeof one);  // fails only when it rings already
}

/// When a client's losses are said: at the first, at recovery, then at most once a minute.
class LossLog {
 public:
  std::optional<std::string> update(const ClientSession& session, SteadyTime now) {
    const bool grew = session.frames_dropped() > seen_;
    seen_ = session.frames_dropped();
    if (grew) last_loss_ = now;
    if (grew && !losing_ && (!said_at_ || now - *said_at_ >= kLossLogPause)) {
      losing_ = true;
      said_at_ = now;
      return fmt::format("takes frames too slowly and loses some dropped={}", seen_);
    }
    if (losing_ && !session.is_behind() && now - last_loss_ > std::chrono::seconds(1)) {
      losing_ = false;
      return fmt::format("has caught up dropped={}", seen_);
    }
    return std::nullopt;
  }

 private:
  std::uint64_t seen_ = 0;
  bool losing_ = false;
  SteadyTime last_loss_{};
  std::optional<SteadyTime> said_at_;
};

struct Client {
  FileDescriptor fd;
  ClientSession session;
  std::uint64_t number;
  PeerCredentials peer;
  LossLog losses;
  bool reads = true;    ///< its sending side is open
  bool broken = false;  ///< the socket is of no use any more

  std::string name() const {
    return fmt::format("client {} ({}, pid {}, uid {})", number,
                       session.format() == Format::json ? "json" : "protobuf", peer.pid, peer.uid);
  }
};

/// What other threads leave for the publisher's.
struct Mail {
  std::optional<Status> status;
  std::optional<StreamLimits> limits;
  int max_clients = 0;
  std::optional<std::string> finish_reason;
  SteadyTime finish_by{};
};

}  // namespace

struct Publisher::State {
  State(const PublisherConfig& given, PublisherLog sink);
  void run();

  // The publisher's thread only.
  void wait_for_events();
  void take_mail();
  void take_status(Status status);
  void accept_clients();
  void accept_one(FileDescriptor fd);
  void read_from_clients();
  void read_from(Client& client);
  void distribute_frames();
  void distribute(const PoseFrame& frame);
  bool everybody_has_room() const;
  void send_status();
  void write_to_clients();
  void write_to(Client& client);
  void say_losses(Client& client, SteadyTime now);
  void close_clients();
  void say_goodbye();
  bool is_over() const;

  PublisherConfig config;
  PublisherLog log;
  std::optional<SocketFile> socket_file;
  FileDescriptor listener, wake;
  SpscRing<PoseFrame> ring;
  std::atomic<std::uint64_t> ring_dropped{0};
  std::atomic<int> subscribers{0};
  std::atomic<bool> over{false};  ///< the thread has ended: frames go nowhere

  std::mutex mutex;  // mail and status; never taken by the loop
  Mail mail;
  Status latest;
  bool has_status = false;

  SharedFramePool frames;
  std::vector<std::unique_ptr<Client>> clients;
  std::vector<pollfd> polled;
  std::uint64_t clients_ever = 0, dropped_by_gone = 0, last_seq = 0;
  SteadyTime accept_after{};
  std::optional<std::string> finishing;
  SteadyTime finish_by{};
  bool goodbye_said = false;
  std::thread thread;
};

Publisher::State::State(const PublisherConfig& given, PublisherLog sink)
    : config(given), log(std::move(sink)), ring(given.ring_frames), frames(given.receiver_ids) {
  if (config.inherited_fd >= 0) {
    listener = FileDescriptor(config.inherited_fd);
  } else {
    listener = listen_unix(config.socket_path, config.group);
    socket_file.emplace(config.socket_path);
  }
  wake = FileDescriptor(eventfd(0, EFD_CLOEXEC | EFD_NONBLOCK));
  if (!wake)
    throw SetupError(ExitStatus::os_refusal,
                     fmt::format("No eventfd can be made: {}.", std::strerror(errno)));
}

void Publisher::State::run() {
  while (!is_over()) {
    wait_for_events();
    take_mail();
    accept_clients();
    read_from_clients();
    distribute_frames();
    send_status();
    say_goodbye();
    write_to_clients();
    close_clients();
  }
  over = true;
  while (ring.front() != nullptr) ring.pop();  // a lossless publish() that waits for room must come home
}

void Publisher::State::wait_for_events() {
  polled.clear();
  polled.push_back({wake.get(), POLLIN, 0});
  const bool accepting = !finishing && steady_now() >= accept_after;
  polled.push_back({accepting ? listener.get() : -1, POLLIN, 0});
  for (const auto& client : clients) {
    const int in = client->reads ? POLLIN : 0, out = client->session.wants_output() ? POLLOUT : 0;
    polled.push_back({client->fd.get(), static_cast<short>(in | out), 0});
  }
  poll(polled.data(), polled.size(), static_cast<int>(std::chrono::milliseconds(kHousekeeping).count()));
  std::uint64_t wakes = 0;
  [[maybe_unused]] const ssize_t drained = read(wake.get(), &wakes, sizeof wakes);
}

void Publisher::State::take_mail() {
  Mail taken;
  {
    const std::lock_guard lock(mutex);
    std::swap(taken, mail);
  }
  if (taken.limits) {
    config.limits = *taken.limits;
    config.max_clients = taken.max_clients;
    config.hello.level = std::min(config.limits.max_level, Level::pose);
    for (const auto& client : clients) client->session.set_max_level(config.limits.max_level);
  }
  if (taken.status) take_status(std::move(*taken.status));
  if (taken.finish_reason) finishing = taken.finish_reason, finish_by = taken.finish_by;
}

/// Adds what only this thread knows, and lets everybody have it.
void Publisher::State::take_status(Status status) {
  status.clients.clear();
  status.client_dropped_frames = dropped_by_gone;
  for (const auto& client : clients) {
    const ClientSession& session = client->session;
    status.clients.push_back(
        {client->name(), session.level(), session.frames_sent(), session.frames_dropped()});
    status.client_dropped_frames += session.frames_dropped();
  }
  status.ring_dropped_frames = ring_dropped.load(std::memory_order_relaxed);
  const std::lock_guard lock(mutex);
  latest = std::move(status);
  has_status = true;
  for (const Format format : {Format::json, Format::protobuf}) {
    std::shared_ptr<const std::string> message;
    for (const auto& client : clients) {
      if (!client->session.wants_status() || client->session.format() != format) continue;
      if (!message) message = std::make_shared<const std::string>(encode(format, latest));
      client->session.offer_status(message);
    }
  }
}

void Publisher::State::accept_clients() {
  while (!finishing) {
    FileDescriptor fd(accept4(listener.get(), nullptr, nullptr, SOCK_CLOEXEC | SOCK_NONBLOCK));
    if (fd) {
      accept_one(std::move(fd));
    } else if (errno == EMFILE || errno == ENFILE || errno == ENOMEM || errno == ENOBUFS) {
      accept_after = steady_now() + std::chrono::seconds(1);  // without a pause this would spin
      return log.warn(fmt::format("a client cannot be accepted: {}", std::strerror(errno)));
    } else if (errno != ECONNABORTED && errno != EINTR) {
      return;
    }
  }
}

void Publisher::State::accept_one(FileDescriptor fd) {
  if (clients.size() >= static_cast<std::size_t>(config.max_clients)) {
    const std::string refusal = encode(
        Format::json, WireError{"too_many_clients", fmt::format("{} clients are connected.", clients.size()),
                                "Close one, or raise stream.max_clients."});
    send(fd.get(), refusal.data(), refusal.size(), MSG_NOSIGNAL | MSG_DONTWAIT);
    return log.warn(fmt::format("a client was refused: stream.max_clients={} are there", config.max_clients));
  }
  setsockopt(fd.get(), SOL_SOCKET, SO_SNDBUF, &kSendBufferBytes, sizeof kSendBufferBytes);
  const PeerCredentials peer = peer_of(fd.get());
  const SteadyTime now = steady_now();
  clients.push_back(
      std::make_unique<Client>(Client{std::move(fd),
                                      ClientSession(config.limits, encode(Format::json, config.hello), now),
                                      ++clients_ever,
                                      peer,
                                      {}}));
  log.info(fmt::format("client {} connected pid={} uid={}", clients_ever, peer.pid, peer.uid));
}

void Publisher::State::read_from_clients() {
  // Those accepted just now were not polled: their turn comes with the next round.
  const std::size_t count = std::min(clients.size(), polled.size() - 2);
  for (std::size_t i = 0; i < count; ++i) {
    const short events = polled[i + 2].revents;
    if ((events & POLLIN) != 0) read_from(*clients[i]);
    if ((events & (POLLHUP | POLLERR)) != 0) clients[i]->broken = true;
  }
}

void Publisher::State::read_from(Client& client) {
  std::array<char, kReadBytes> buffer;
  const ssize_t size = recv(client.fd.get(), buffer.data(), buffer.size(), MSG_DONTWAIT);
  if (size > 0) {
    client.session.receive(ByteView(buffer.data(), static_cast<std::size_t>(size)), steady_now());
  } else if (size == 0) {
    client.reads = false;  // it may go on listening
  } else if (errno != EAGAIN && errno != EINTR) {
    client.broken = true;
  }
}

void Publisher::State::distribute_frames() {
  while (const PoseFrame* frame = ring.front()) {
    if (config.lossless && !everybody_has_room()) return;
    distribute(*frame);
    ring.pop();
    write_to_clients();  // one by one: a client that reads loses nothing when several frames came at once
  }
}

void Publisher::State::distribute(const PoseFrame& frame) {
  const bool gap = last_seq != 0 && frame.seq > last_seq + 1;
  const auto lost = gap ? static_cast<std::uint32_t>(frame.seq - last_seq - 1) : 0;
  last_seq = frame.seq;
  config.hello.state = frame.state;
  const bool wanted =
      std::any_of(clients.begin(), clients.end(), [](const auto& c) { return c->session.wants_pose(); });
  if (!wanted) return;
  const SharedFramePtr shared = frames.take(frame);
  for (const auto& client : clients) {
    if (lost > 0) client->session.add_lost(lost);
    client->session.offer(shared);
  }
}

bool Publisher::State::everybody_has_room() const {
  return std::all_of(clients.begin(), clients.end(),
                     [](const auto& c) { return c->broken || c->session.has_room(); });
}

/// To those who have just subscribed; the others get it when it comes.
void Publisher::State::send_status() {
  for (const auto& client : clients) {
    if (!client->session.take_status_request()) continue;
    const std::lock_guard lock(mutex);
    if (!has_status) continue;
    client->session.offer_status(
        std::make_shared<const std::string>(encode(client->session.format(), latest)));
  }
}

void Publisher::State::write_to_clients() {
  for (const auto& client : clients)
    if (!client->broken) write_to(*client);
}

void Publisher::State::write_to(Client& client) {
  while (client.session.wants_output()) {
    ClientSession::Parts parts = client.session.next_bytes();
    std::array<iovec, 3> pieces;
    for (std::size_t i = 0; i < parts.size(); ++i)
      pieces[i] = {const_cast<char*>(parts[i].data()), parts[i].size()};
    msghdr message{};
    message.msg_iov = pieces.data();
    message.msg_iovlen = pieces.size();
    const ssize_t size = sendmsg(client.fd.get(), &message, MSG_NOSIGNAL | MSG_DONTWAIT);
    if (size < 0 && errno == EINTR) continue;
    if (size < 0) client.broken = errno != EAGAIN;
    if (size < 0) return;
    client.session.sent(static_cast<std::size_t>(size), steady_now());
  }
}

void Publisher::State::say_losses(Client& client, SteadyTime now) {
  if (const auto words = client.losses.update(client.session, now)) log.warn(client.name() + ' ' + *words);
}

void Publisher::State::close_clients() {
  const SteadyTime now = steady_now();
  int wanting = 0;
  for (auto& client : clients) {
    say_losses(*client, now);
    const bool idle = client->session.idle_too_long(now);
    if (!client->broken && !idle && !client->session.finished()) {
      wanting += client->session.wants_pose() ? 1 : 0;
      continue;
    }
    dropped_by_gone += client->session.frames_dropped();
    log.info(fmt::format("{} {} sent={} dropped={}", client->name(),
                         idle ? "took nothing for stream.idle_close_s and was closed" : "has left",
                         client->session.frames_sent(), client->session.frames_dropped()));
    client.reset();
  }
  clients.erase(std::remove(clients.begin(), clients.end(), nullptr), clients.end());
  subscribers.store(wanting, std::memory_order_release);
}

void Publisher::State::say_goodbye() {
  if (!finishing || goodbye_said || (ring.front() != nullptr && steady_now() < finish_by)) return;
  for (const auto& client : clients) client->session.say_bye(*finishing);
  goodbye_said = true;
}

bool Publisher::State::is_over() const {
  return goodbye_said && (clients.empty() || steady_now() >= finish_by);
}

Publisher::Publisher(const PublisherConfig& config, PublisherLog log)
    : state_(std::make_unique<State>(config, std::move(log))) {
  assert(config.max_clients > 0 && config.limits.queue_frames >= 1 &&
         config.limits.queue_frames <= kMaxQueueFrames);
  state_->thread = std::thread([state = state_.get()] { state->run(); });
}

Publisher::~Publisher() {
  if (state_->thread.joinable()) finish("stopped");
}

void Publisher::publish(const PoseFrame& frame) {
  while (!state_->ring.push(frame)) {
    if (!state_->config.lossless || state_->over) {
      state_->ring_dropped.fetch_add(1, std::memory_order_relaxed);
      return;
    }
    state_->ring.wait_for_room();
  }
  ring_the_bell(state_->wake.get());
}

std::uint64_t Publisher::ring_dropped() const { return state_->ring_dropped.load(std::memory_order_relaxed); }
int Publisher::subscribers() const { return state_->subscribers.load(std::memory_order_acquire); }

void Publisher::set_status(const Status& status) {
  const std::lock_guard lock(state_->mutex);
  state_->mail.status = status;
  ring_the_bell(state_->wake.get());
}

Status Publisher::status() const {
  const std::lock_guard lock(state_->mutex);
  return state_->latest;
}

void Publisher::configure(const StreamLimits& limits, int max_clients) {
  const std::lock_guard lock(state_->mutex);
  state_->mail.limits = limits;
  state_->mail.max_clients = max_clients;
  ring_the_bell(state_->wake.get());
}

void Publisher::finish(const std::string& reason, Nanoseconds patience) {
  if (!state_->thread.joinable()) return;
  {
    const std::lock_guard lock(state_->mutex);
    state_->mail.finish_reason = reason;
    state_->mail.finish_by = steady_now() + patience;
    ring_the_bell(state_->wake.get());
  }
  state_->thread.join();
  state_->clients.clear();
  state_->socket_file.reset();
}

}  // namespace csipose
