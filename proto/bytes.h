// proto/bytes.h - a view of bytes and the reading of little- and big-endian integers.
//
// C++17-clean, because the receiver's agent is: no std::span here. Loads and stores never check;
// whoever calls has compared with size() first.
#pragma once

#include <cstddef>
#include <cstdint>
#include <cstring>
#include <utility>

namespace csipose {

/// Bytes that somebody else owns. Cheap to copy; valid as long as the owner keeps them.
class ByteView {
 public:
  constexpr ByteView() = default;
  constexpr ByteView(const std::uint8_t* data, std::size_t size) : data_(data), size_(size) {}
  ByteView(const void* data, std::size_t size) : data_(static_cast<const std::uint8_t*>(data)), size_(size) {}
  /// Any contiguous container of bytes: std::vector<std::uint8_t>, std::array, std::string_view.
  template <class Container, class = decltype(std::declval<const Container&>().data())>
  ByteView(const Container& container)
      : ByteView(static_cast<const void*>(container.data()), container.size()) {
    static_assert(sizeof(*container.data()) == 1, "a ByteView is made of bytes");
  }

  constexpr const std::uint8_t* data() const { return data_; }
  constexpr std::size_t size() const { return size_; }
  constexpr bool empty() const { return size_ == 0; }
  constexpr std::uint8_t operator[](std::size_t i) const { return data_[i]; }
  constexpr const std::uint8_t* begin() const { return data_; }
  constexpr const std::uint8_t* end() const { return data_ + size_; }
  /// The part from `offset`, at most `count` bytes; both are clipped to what is there.
  constexpr ByteView sub(std::size_t offset, std::size_t count = SIZE_MAX) const {
    const std::size_t from = offset < size_ ? offset : size_;
    const std::size_t left = size_ - from;
    return {data_ + from, count < left ? count : left};
  }

 private:
  const std::uint8_t* data_ = nullptr;
  std::size_t size_ = 0;
};

/// Integers as they lie in memory, least significant byte first, whatever the host does. On a little-endian host that is a
/// copy; compilers do not see it in the loop, which made unpacking CSI four times as slow.
inline constexpr bool kHostIsLittleEndian = __BYTE_ORDER__ == __ORDER_LITTLE_ENDIAN__;
template <class Integer>
Integer load_le(const std::uint8_t* p) {
  if constexpr (kHostIsLittleEndian) {
    Integer copy;
    std::memcpy(&copy, p, sizeof copy);
    return copy;
  }
  std::uint64_t value = 0;
  for (std::size_t i = 0; i < sizeof(Integer); ++i) value |= std::uint64_t{p[i]} << (8 * i);
  return static_cast<Integer>(value);
}
template <class Integer>
void store_le(std::uint8_t* p, Integer value) {
  if constexpr (kHostIsLittleEndian) {
    std::memcpy(p, &value, sizeof value);
    return;
  }
  for (std::size_t i = 0; i < sizeof(Integer); ++i)
    p[i] = static_cast<std::uint8_t>(static_cast<std::uint64_t>(value) >> (8 * i));
}
inline std::uint16_t load_be16(const std::uint8_t* p) { return static_cast<std::uint16_t>(p[0] << 8 | p[1]); }
inline void store_be16(std::uint8_t* p, std::uint16_t value) {
  p[0] = static_cast<std::uint8_t>(value >> 8);
  p[1] = static_cast<std::uint8_t>(value);
}

}  // namespace csipose
