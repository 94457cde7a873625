// Any bytes as a list of names, a file of labels and a map of environments of the published data set.
#include "train/published_files.h"

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  const std::string_view text(reinterpret_cast<const char*>(data), size);
  if (const auto list = csipose::train::parse_name_list(text))
    for (const csipose::train::WindowName& name : list->names)
      if (name.text.find('/') != std::string::npos || name.clip_number() > 9999) __builtin_trap();
  (void)csipose::train::parse_keypoints(csipose::ByteView(data, size));
  (void)csipose::train::EnvironmentMap::parse(text);
  return 0;
}
