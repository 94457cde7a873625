#include "train/workers.h"

#include <fmt/format.h>

#include <charconv>
#include <cstdlib>
#include <cstring>
#include <torch/csrc/distributed/c10d/ProcessGroupGloo.hpp>
#include <torch/csrc/distributed/c10d/TCPStore.hpp>

#include "proto/result.h"

namespace csipose::train {
namespace {

const char* variable(const char* name) {
  return std::getenv(name);
}  // NOLINT(concurrency-mt-unsafe): at start

int number(const char* name, int least, int most) {
  const char* text = variable(name);
  int value = 0;
  const char* end = text == nullptr ? nullptr : text + std::strlen(text);
  if (text == nullptr || std::from_chars(text, end, value).ptr != end || value < least || value > most)
    throw SetupError(ExitStatus::usage,
                     fmt::format("WORLD_SIZE is set, so {} must be a number from {} to {}, but it is '{}'",
                                 name, least, most, text == nullptr ? "not set" : text));
  return value;
}

}  // namespace

struct Workers::Group {
  Group(const std::string& host, int port, int rank, int size) {
    c10d::TCPStoreOptions options;
    options.port = static_cast<std::uint16_t>(port);
    options.isServer = rank == 0;
    options.numWorkers = static_cast<std::size_t>(size);
    auto store = c10::make_intrusive<c10d::TCPStore>(host, options);
    auto gloo = c10d::ProcessGroupGloo::Options::create();
    gloo->devices.push_back(c10d::ProcessGroupGloo::createDefaultDevice());
    gloo->threads = 2;
    processes = c10::make_intrusive<c10d::ProcessGroupGloo>(store, rank, size, gloo);
  }
  c10::intrusive_ptr<c10d::ProcessGroupGloo> processes;
};

Workers::Workers() = default;
Workers::~Workers() = default;
Workers::Workers(Workers&&) noexcept = default;

Workers Workers::from_environment() {
  Workers workers;
  const char* world = variable("WORLD_SIZE");
  if (world == nullptr || std::string_view(world) == "1") return workers;
  workers.size_ = number("WORLD_SIZE", 1, 65536);
  workers.rank_ = number("RANK", 0, workers.size_ - 1);
  const char* host = variable("MASTER_ADDR");
  const int port = variable("MASTER_PORT") == nullptr ? c10d::TCPStoreOptions::kDefaultPort
                                                      : number("MASTER_PORT", 1, 65535);
  if (host == nullptr)
    throw SetupError(ExitStatus::usage, "WORLD_SIZE is set, so MASTER_ADDR must name the host of rank 0");
  try {
    workers.group_ = std::make_unique<Group>(host, port, workers.rank_, workers.size_);
  } catch (const std::exception& error) {
    throw SetupError(ExitStatus::unavailable,
                     fmt::format("rank {} of {} cannot join the others at {}:{}: {}", workers.rank_,
                                 workers.size_, host, port, std::string_view(error.what()).substr(0, 200)));
  }
  return workers;
}

void Workers::average(const std::vector<at::Tensor>& tensors) const {
  if (group_ == nullptr || tensors.empty()) return;
  const at::NoGradGuard no_gradients;
  std::vector<at::Tensor> flat;
  for (const at::Tensor& tensor : tensors) flat.push_back(tensor.detach().to(at::kCPU).flatten());
  std::vector<at::Tensor> all = {at::cat(flat)};
  group_->processes->allreduce(all)->wait();
  all[0].div_(size_);
  std::int64_t from = 0;
  for (const at::Tensor& tensor : tensors) {
    tensor.detach().copy_(all[0].narrow(0, from, tensor.numel()).view(tensor.sizes()));
    from += tensor.numel();
  }
}

double Workers::average(double value) const {
  const at::Tensor one = at::full({1}, value, at::kFloat);
  average(std::vector<at::Tensor>{one});
  return one.item<double>();
}

bool Workers::any(bool value) const { return average(value ? 1. : 0.) > 0; }

}  // namespace csipose::train
