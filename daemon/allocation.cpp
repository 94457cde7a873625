#include "daemon/allocation.h"

#include <malloc.h>

#include <algorithm>
#include <array>
#include <atomic>
#include <bit>
#include <cerrno>
#include <cstdint>
#include <cstdlib>
#include <new>
#include <utility>

extern "C" void __libc_free(void*);  // glibc's own, whatever stands in the place of free

namespace csipose {
namespace {

constexpr std::size_t kClasses = 32, kLongestList = 64;
// glibc's blocks have 24, 40, 56 ... usable bytes (malloc.c: chunks are multiples of 16 with 8 bytes of
// overhead), so the size class of a block is read from the block itself and no header of ours is needed.
constexpr std::size_t kSmallest = 24, kStep = 16;

// Whatever begins where a page does is kept like what was asked for so.
constexpr std::size_t kPage = 4096, kLongestPageList = 8, kLargestPageBlock = 1 << 20;

std::atomic<std::uint64_t> from_malloc_of_all{0};

struct Block {
  Block* next;
};

class ThreadLists {
 public:
  // Never destroyed as an object: a block may be freed while the thread's other destructors run.
  void* take(std::size_t size) {
    ++counts.requests;
    const std::size_t size_class = size <= kSmallest ? 0 : (size - kSmallest + kStep - 1) / kStep;
    if (size_class < kClasses && lists_[size_class] != nullptr) return pop(size_class);
    count_malloc();
    return std::malloc(size_class < kClasses ? kSmallest + kStep * size_class : size);
  }

  void give(void* memory) {
    const std::size_t size_class = (malloc_usable_size(memory) - kSmallest) / kStep;
    if (closed_ || size_class >= kClasses || lengths_[size_class] >= kLongestList) return std::free(memory);
    lists_[size_class] = new (memory) Block{lists_[size_class]};
    ++lengths_[size_class];
  }

  /// Page-aligned: the smallest kept block that is large enough, or a new one.
  void* take_pages(std::size_t size) {
    ++counts.requests;
    void** best = nullptr;
    for (void*& kept : pages_)
      if (kept != nullptr && malloc_usable_size(kept) >= size &&
          (best == nullptr || malloc_usable_size(kept) < malloc_usable_size(*best)))
        best = &kept;
    if (best != nullptr) return std::exchange(*best, nullptr);
    count_malloc();
    return memalign(kPage, size);
  }

  /// The largest are kept: small ones, which lie at the start of a page by chance, would serve nobody.
  void give_pages(void* memory) {
    if (closed_ || malloc_usable_size(memory) > kLargestPageBlock) return give_back(memory);
    const auto least = std::ranges::min_element(
        pages_, {}, [](void* kept) { return kept == nullptr ? 0 : malloc_usable_size(kept); });
    if (*least == nullptr || malloc_usable_size(*least) < malloc_usable_size(memory))
      std::swap(*least, memory);
    give_back(memory);
  }

  void close() {
    closed_ = true;
    for (std::size_t c = 0; c < kClasses; ++c)
      while (lists_[c] != nullptr) std::free(pop(c));
    for (void*& kept : pages_) give_back(std::exchange(kept, nullptr));
  }

  AllocationCounts counts;

 private:
  static void give_back(void* memory) { __libc_free(memory); }
  void count_malloc() {
    ++counts.from_malloc;
    from_malloc_of_all.fetch_add(1, std::memory_order_relaxed);
  }
  void* pop(std::size_t size_class) {
    Block* block = lists_[size_class];
    lists_[size_class] = block->next;
    --lengths_[size_class];
    return block;
  }
  std::array<Block*, kClasses> lists_{};
  std::array<std::size_t, kClasses> lengths_{};
  std::array<void*, kLongestPageList> pages_{};
  bool closed_ = false;
};

constinit thread_local ThreadLists lists;

/// Gives a thread's blocks back when it ends.
struct ListsCloser {
  bool armed = false;
  ~ListsCloser() { lists.close(); }
};
thread_local ListsCloser closer;

}  // namespace

AllocationCounts allocations_of_this_thread() { return lists.counts; }
std::uint64_t allocations_from_malloc() { return from_malloc_of_all.load(std::memory_order_relaxed); }

}  // namespace csipose

#if !defined(__SANITIZE_ADDRESS__) && !defined(__SANITIZE_THREAD__)

void* operator new(std::size_t size) {
  csipose::closer.armed = true;
  while (true) {
    if (void* memory = csipose::lists.take(size)) return memory;
    const std::new_handler handler = std::get_new_handler();
    if (handler == nullptr) throw std::bad_alloc();
    handler();
  }
}

void operator delete(void* memory) noexcept {
  csipose::closer.armed = true;
  if (memory != nullptr) csipose::lists.give(memory);
}
void operator delete(void* memory, std::size_t) noexcept { operator delete(memory); }

// glibc lets a program put its own functions in the place of these.
extern "C" {
int posix_memalign(void** memory, std::size_t alignment, std::size_t size) {
  if (!std::has_single_bit(alignment) || alignment % sizeof(void*) != 0) return EINVAL;
  csipose::closer.armed = true;
  void* block = alignment == csipose::kPage ? csipose::lists.take_pages(size) : memalign(alignment, size);
  if (block == nullptr) return ENOMEM;
  *memory = block;
  return 0;
}

void free(void* memory) {
  if (memory == nullptr) return;
  if (reinterpret_cast<std::uintptr_t>(memory) % csipose::kPage != 0) return __libc_free(memory);
  csipose::closer.armed = true;
  csipose::lists.give_pages(memory);
}
}

#endif
