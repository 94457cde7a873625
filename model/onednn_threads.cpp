#include "model/onednn_threads.h"

#include <fmt/format.h>
#include <sched.h>

#include <algorithm>
#include <cassert>

#include "model/cpu.h"
#include "proto/result.h"

// The same library as oneDNN's, whichever compiler this is: clang's <omp.h> would bring a second OpenMP
// runtime with threads of its own. Under clang our loops run in the calling thread.
extern "C" void omp_set_num_threads(int count);
extern "C" int omp_get_thread_num();

namespace csipose {
namespace {

/// ThreadSanitizer does not see the barriers inside libgomp, which is not instrumented, and reports every
/// exchange between its threads as a race. One thread is the honest way to run under it.
int allowed_count(int count) {
#if defined(__SANITIZE_THREAD__)
  return std::min(count, 1);
#else
  return count;
#endif
}

bool pin_this_thread(int cpu) {
  cpu_set_t one;
  CPU_ZERO(&one);
  CPU_SET(static_cast<std::size_t>(cpu), &one);
  return sched_setaffinity(0, sizeof one, &one) == 0;
}

/// By trying: the thread's own mask tells nothing, an earlier engine may have pinned it.
void require_available(const std::vector<int>& cpus) {
  cpu_set_t before;
  sched_getaffinity(0, sizeof before, &before);
  for (const int cpu : cpus) {
    const bool possible = cpu >= 0 && cpu < CPU_SETSIZE && pin_this_thread(cpu);
    sched_setaffinity(0, sizeof before, &before);
    if (!possible)
      throw SetupError(
          ExitStatus::bad_config,
          fmt::format(
              "inference cannot be pinned to processor {}: there is none of that number or this process "
              "may not run there; `nproc` tells how many there are",
              cpu));
  }
}

}  // namespace

InferenceThreads::InferenceThreads(int count, std::vector<int> cpus)
    : count_(allowed_count(count)), cpus_(std::move(cpus)) {
  if (count < 1) throw SetupError(ExitStatus::bad_config, "inference needs at least one thread");
  if (!cpus_.empty() && static_cast<int>(cpus_.size()) < count)
    throw SetupError(
        ExitStatus::bad_config,
        fmt::format("{} inference threads but only {} processors to pin them to", count, cpus_.size()));
  require_available(cpus_);
}

void InferenceThreads::enter() {
  omp_set_num_threads(count_);
  if (team_of_ == std::this_thread::get_id()) return;
  make_team();
  team_of_ = std::this_thread::get_id();
}

void InferenceThreads::make_team() {
#ifdef _OPENMP
#pragma omp parallel num_threads(count_)
#endif
  {
    prepare_process_for_inference();
    if (!cpus_.empty()) pin_this_thread(cpus_[static_cast<std::size_t>(omp_get_thread_num())]);
  }
}

void InferenceThreads::run(std::size_t rows, Chunk chunk, const void* body) const {
  const std::size_t parts = std::min(static_cast<std::size_t>(count_), rows);
  if (parts <= 1) return rows == 0 ? void() : chunk(body, 0, rows);
#ifdef _OPENMP
#pragma omp parallel for num_threads(count_) schedule(static, 1)
#endif
  for (std::size_t part = 0; part < parts; ++part)
    chunk(body, rows * part / parts, rows * (part + 1) / parts);
}

}  // namespace csipose
