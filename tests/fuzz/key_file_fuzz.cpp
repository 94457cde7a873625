#include "proto/keys.h"

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  const auto key = csipose::parse_agent_key({data, size});
  if (key && (key->name.empty() || key->name.size() > 32)) __builtin_trap();
  if (!key && key.error().empty()) __builtin_trap();  // a refusal has words
  return 0;
}
