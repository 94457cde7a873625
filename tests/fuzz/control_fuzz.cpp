// Lines on the control socket: each gets one answer line, whatever it holds.
#include <cstdint>
#include <cstdlib>

#include "daemon/control.h"

using namespace csipose;

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  ControlHandlers handlers;
  handlers.record_start = [] { return RecordingEntry{"a.mcap", 0, true}; };
  handlers.record_list = [] { return std::vector<RecordingEntry>{}; };
  handlers.reload = [] { return std::vector<std::string>{}; };
  handlers.status = [] { return Status{}; };
  const std::string answer = answer_control_request(std::string(data, data + size), handlers);
  if (answer.empty() || answer.find('\n') != answer.size() - 1) std::abort();
  return 0;
}
