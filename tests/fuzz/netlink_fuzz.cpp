#include "capture/netlink.h"

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  const csipose::ByteView input(data, size);
  (void)csipose::find_connector(input);
  const auto record = csipose::parse_connector_message(input, {26, 1});
  if (record && (record->empty() || record->end() > input.end() || record->begin() < input.begin()))
    __builtin_trap();
  return 0;
}
