// tests/capture/bytes.h - bytes by value, for comparing.
#pragma once

#include <cstdint>
#include <vector>

#include "proto/bytes.h"

namespace csipose::testing {

using Bytes = std::vector<std::uint8_t>;

inline Bytes copy(ByteView view) { return {view.begin(), view.end()}; }
inline void append(Bytes& to, ByteView more) { to.insert(to.end(), more.begin(), more.end()); }
inline Bytes joined(Bytes a, const Bytes& b) {
  append(a, b);
  return a;
}

}  // namespace csipose::testing
