// model/onednn_threads.h - the threads that one engine computes with: OpenMP's, because oneDNN from Debian
// has no others.
//
// libgomp keeps a pool of threads for every thread that opens a parallel region. So the team belongs to the
// thread that calls the engine; the first call from a thread makes its team: count, pinning, denormals. From
// then on regions cost about a microsecond and no allocation: inside a window a thread that waits spins, and
// calls the kernel only where the others are late (bound_spinning(), model/cpu.h); between windows they sleep.
#pragma once

#include <cstddef>
#include <thread>
#include <vector>

namespace csipose {

class InferenceThreads {
 public:
  /// cpus: processor of each thread, [0] for the caller; empty = not pinned. Throws SetupError when they are
  /// fewer than the threads or one of them is not available to this process.
  InferenceThreads(int count, std::vector<int> cpus);
  int count() const { return count_; }

  /// To be called at the start of everything that runs in parallel; cheap but for the first time in a thread.
  void enter();

  /// body(first, last) on disjoint ranges that cover [0, rows), in parallel. The ranges depend on `rows` and
  /// the number of threads only.
  template <class Body>
  void for_rows(std::size_t rows, const Body& body) const {
    run(
        rows,
        [](const void* it, std::size_t first, std::size_t last) {
          (*static_cast<const Body*>(it))(first, last);
        },
        &body);
  }

 private:
  using Chunk = void (*)(const void* body, std::size_t first, std::size_t last);
  void run(std::size_t rows, Chunk chunk, const void* body) const;
  void make_team();

  int count_;
  std::vector<int> cpus_;
  std::thread::id team_of_;
};

}  // namespace csipose
