// tests/counting_allocator.h - counts every call of operator new of the program, to prove that something
// makes none.
//
// Include it in one source file of a test program: it replaces the global operators.
// They are not inlined: GCC 12 would see free() meet operator new in the caller and take that for a mistake.
#pragma once

#include <atomic>
#include <cstdint>
#include <cstdlib>
#include <new>

namespace csipose::testing {
inline std::atomic<std::uint64_t> allocations{0};

inline void* counted(std::size_t size) noexcept {
  allocations.fetch_add(1, std::memory_order_relaxed);
  return std::malloc(size == 0 ? 1 : size);
}
inline void* counted(std::size_t size, std::align_val_t align) noexcept {
  allocations.fetch_add(1, std::memory_order_relaxed);
  const auto a = static_cast<std::size_t>(align);
  return std::aligned_alloc(a, (size + a - 1) / a * a);
}
inline void* or_throw(void* memory) {
  if (memory == nullptr) throw std::bad_alloc();
  return memory;
}
}  // namespace csipose::testing

[[gnu::noinline]] void* operator new(std::size_t size) {
  return csipose::testing::or_throw(csipose::testing::counted(size));
}
[[gnu::noinline]] void* operator new(std::size_t size, std::align_val_t align) {
  return csipose::testing::or_throw(csipose::testing::counted(size, align));
}
[[gnu::noinline]] void* operator new(std::size_t size, const std::nothrow_t&) noexcept {
  return csipose::testing::counted(size);
}
[[gnu::noinline]] void* operator new(std::size_t size, std::align_val_t align,
                                     const std::nothrow_t&) noexcept {
  return csipose::testing::counted(size, align);
}
[[gnu::noinline]] void operator delete(void* memory) noexcept { std::free(memory); }
[[gnu::noinline]] void operator delete(void* memory, std::size_t) noexcept { std::free(memory); }
[[gnu::noinline]] void operator delete(void* memory, std::align_val_t) noexcept { std::free(memory); }
[[gnu::noinline]] void operator delete(void* memory, std::size_t, std::align_val_t) noexcept {
  std::free(memory);
}
