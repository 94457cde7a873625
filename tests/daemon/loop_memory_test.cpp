// What this proves, of the whole loop (packets, alignment, windows, oneDNN network, tracker, frames) on real
// code with only the clock scripted: after warm-up, over two thousand windows with losses and a receiver that
// comes and goes,
//   - nobody in the process calls malloc, calloc, realloc or memalign: our code because it allocates nothing,
//     oneDNN because daemon/allocation.cpp serves what it asks for from lists (and the count of those says that
//     it asked);
//   - no thread makes a system call for memory (mmap, munmap, mremap, brk, madvise, mprotect): a seccomp
//   filter traps each.
// Hence memory cannot grow. In sanitizer builds, which bring their own malloc, it is left out.
#include <gtest/gtest.h>
#include <linux/audit.h>
#include <linux/filter.h>
#include <linux/seccomp.h>
#include <sys/prctl.h>
#include <sys/syscall.h>
#include <sys/wait.h>
#include <unistd.h>

#include <atomic>
#include <csignal>
#include <cstddef>

#include "daemon/allocation.h"
#include "daemon/loop.h"
#include "tests/daemon/scripted_loop.h"

#if !defined(__SANITIZE_ADDRESS__) && !defined(__SANITIZE_THREAD__)

namespace {
std::atomic<std::uint64_t> heap_calls{0};
}

// glibc lets a program put its own functions in the place of malloc and keeps the originals under these
// names.
extern "C" {
void* __libc_malloc(std::size_t);
void* __libc_calloc(std::size_t, std::size_t);
void* __libc_realloc(void*, std::size_t);
void* __libc_memalign(std::size_t, std::size_t);

void* malloc(std::size_t size) {
  heap_calls.fetch_add(1, std::memory_order_relaxed);
  return __libc_malloc(size);
}
void* calloc(std::size_t count, std::size_t size) {
  heap_calls.fetch_add(1, std::memory_order_relaxed);
  return __libc_calloc(count, size);
}
void* realloc(void* memory, std::size_t size) {
  heap_calls.fetch_add(1, std::memory_order_relaxed);
  return __libc_realloc(memory, size);
}
void* memalign(std::size_t alignment, std::size_t size) {
  heap_calls.fetch_add(1, std::memory_order_relaxed);
  return __libc_memalign(alignment, size);
}
void* aligned_alloc(std::size_t alignment, std::size_t size) { return memalign(alignment, size); }
}  // posix_memalign and free are those of daemon/allocation.cpp

namespace csipose {
namespace {

using namespace csipose::testing;

std::atomic<std::uint64_t> memory_system_calls{0};
void on_trapped_call(int) { memory_system_calls.fetch_add(1, std::memory_order_relaxed); }

/// From here on, in all threads, a system call for memory is not carried out but counted. False: the kernel
/// has no seccomp.
bool trap_memory_system_calls() {
  struct sigaction action {};
  action.sa_handler = on_trapped_call;
  sigaction(SIGSYS, &action, nullptr);
  constexpr std::array<unsigned, 6> kCalls = {SYS_mmap, SYS_munmap,  SYS_mremap,
                                              SYS_brk,  SYS_madvise, SYS_mprotect};
  std::vector<sock_filter> program = {BPF_STMT(BPF_LD | BPF_W | BPF_ABS, offsetof(seccomp_data, nr))};
  for (std::size_t i = 0; i < kCalls.size(); ++i)
    program.push_back(
        BPF_JUMP(BPF_JMP | BPF_JEQ | BPF_K, kCalls[i], static_cast<unsigned char>(kCalls.size() - i), 0));
  program.push_back(BPF_STMT(BPF_RET | BPF_K, SECCOMP_RET_ALLOW));
  program.push_back(BPF_STMT(BPF_RET | BPF_K, SECCOMP_RET_TRAP));
  const sock_fprog filter{static_cast<unsigned short>(program.size()), program.data()};
  return prctl(PR_SET_NO_NEW_PRIVS, 1, 0, 0, 0) == 0 &&
         syscall(SYS_seccomp, SECCOMP_SET_MODE_FILTER, SECCOMP_FILTER_FLAG_TSYNC, &filter) == 0;
}

/// Counts, and keeps nothing.
class CountingSink final : public FrameSink {
 public:
  void publish(const PoseFrame& frame) override {
    ++frames;
    people += frame.people_count;
  }
  std::uint64_t frames = 0, people = 0;
};

struct Findings {
  bool trapped = false;
  std::uint64_t windows = 0, heap_calls = 0, system_calls = 0, served_by_lists = 0;
};

/// One loop, live by a scripted clock, with the real engine. Between two instants everything is counted.
class MeasuredLoop {
 public:
  Findings run(double how_long_s, int threads) {
    MadeUpTransmitter transmitter;
    transmitter.frames = static_cast<std::int64_t>(how_long_s * transmitter.hz);
    transmitter.frame_record = [](std::int64_t frame) {
      return csip_frame(static_cast<std::uint64_t>(frame) + 1);
    };
    std::vector<MadeUpReceiver> receivers(3);
    for (MadeUpReceiver& receiver : receivers) receiver.loss = 0.02, receiver.jitter_ms = 0.5;
    // One receiver dies and comes back: the network runs with fewer tokens, too.
    receivers[1].deaf = [](std::int64_t frame) { return frame / 200 % 4 == 2; };
    ScriptedInput input(make_packets(transmitter, receivers), &clock_);
    auto model = init_random(preset_config("micro"), 1, HeadInit::random);
    PoseEstimator estimator(model, make_onednn_engine(model, {threads, Precision::f32, {}, false}), people_);
    FrontEnd front_end(FrontEndConfig{});
    FrameMaker frames(front_end, estimator, people_, {});
    LiveLoop loop(input, frames, sink_, clock_, link_, {kJitter, kBudget, 1});
    const SteadyTime warm{from_seconds(100 + 3)}, end{from_seconds(100 + how_long_s - 0.5)};
    clock_.on_time = [&](SteadyTime now) {
      if (now >= warm && !measuring_) begin();
      if (now >= end && !link_.stop) finish();
    };
    loop.run();
    return findings_;
  }

 private:
  void begin() {
    measuring_ = true;
    findings_.trapped = trap_memory_system_calls();
    findings_.windows = sink_.frames;
    findings_.served_by_lists = allocations_of_this_thread().requests;
    findings_.heap_calls = heap_calls;
    findings_.system_calls = memory_system_calls;
  }
  void finish() {
    findings_.windows = sink_.frames - findings_.windows;
    findings_.heap_calls = heap_calls - findings_.heap_calls;
    findings_.system_calls = memory_system_calls - findings_.system_calls;
    findings_.served_by_lists = allocations_of_this_thread().requests - findings_.served_by_lists;
    link_.stop = true;
  }

  ScriptedClock clock_;
  CountingSink sink_;
  LoopLink link_;
  EstimatorConfig people_;
  Findings findings_;
  bool measuring_ = false;
};

/// In a process of its own, because the filter stays for good.
Findings measure_in_child(double how_long_s, int threads) {
  int ends[2];
  EXPECT_EQ(pipe(ends), 0);
  const pid_t child = fork();
  if (child == 0) {
    const Findings findings = MeasuredLoop().run(how_long_s, threads);
    _exit(write(ends[1], &findings, sizeof findings) == sizeof findings ? 0 : 1);
  }
  close(ends[1]);
  Findings findings;
  EXPECT_EQ(read(ends[0], &findings, sizeof findings), static_cast<ssize_t>(sizeof findings));
  close(ends[0]);
  int status = 0;
  waitpid(child, &status, 0);
  EXPECT_EQ(status, 0);
  return findings;
}

void expect_nothing(const Findings& found) {
  EXPECT_EQ(found.heap_calls, 0u);
  EXPECT_GT(found.served_by_lists, found.windows)
      << "oneDNN is known to allocate; were it not seen, nothing would be";
  if (!found.trapped)
    GTEST_SKIP() << "heap calls were counted; system calls were not, this kernel allows no seccomp filter";
  EXPECT_EQ(found.system_calls, 0u);
}

TEST(LoopMemory, NothingIsAllocatedAndTheKernelIsNotAsked) {
  const Findings found = measure_in_child(72, 1);
  EXPECT_GT(found.windows, 2000u);
  expect_nothing(found);
}

TEST(LoopMemory, NorByTheNetworksOtherThreads) {
  const Findings found = measure_in_child(8, 2);
  EXPECT_GT(found.windows, 100u);
  expect_nothing(found);
}

TEST(LoopMemory, TheInstrumentsSeeAnAllocation) {
  const std::uint64_t before = heap_calls;
  char* volatile block = new char[1 << 20];  // volatile, or the optimiser takes the pair away
  delete[] block;
  EXPECT_EQ(heap_calls - before, 1u);
  const pid_t child = fork();
  if (child == 0) {
    if (!trap_memory_system_calls()) _exit(2);
    syscall(SYS_madvise, nullptr, 0, 0);
    _exit(memory_system_calls == 1 ? 0 : 1);
  }
  int status = 0;
  waitpid(child, &status, 0);
  if (WIFEXITED(status) && WEXITSTATUS(status) == 2) GTEST_SKIP() << "this kernel allows no seccomp filter";
  EXPECT_EQ(status, 0);
}

}  // namespace
}  // namespace csipose

#else

TEST(LoopMemory, NothingIsAllocatedAndTheKernelIsNotAsked) {
  GTEST_SKIP() << "left out: a sanitizer's own malloc is in use";
}

#endif
