// A line of the truth socket: whatever it holds, what is understood can be said again and understood.
#include "proto/truth.h"

using namespace csipose;

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  const auto read = parse_truth({reinterpret_cast<const char*>(data), size});
  if (!read) return 0;
  std::string again = std::visit([](const auto& said) { return encode(said); }, *read);
  again.pop_back();
  if (again.size() <= kMaxTruthLine && !parse_truth(again)) __builtin_trap();
  return 0;
}
