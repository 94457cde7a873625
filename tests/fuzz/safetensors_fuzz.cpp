// Any bytes as a weights file: refused in words, or whole. What is whole packs and reads back the same; and,
// sealed again, goes through the model's own checks, which a fuzzer could not reach past the digest.
#include <cstdlib>

#include "model/model.h"
#include "proto/result.h"

namespace {

using namespace csipose;

void require(bool holds) {
  if (!holds) std::abort();
}

void read_as_model(const SafetensorsFile& sealed) {
  try {
    const auto model = Model::from(sealed);
    for (const TensorSpec& spec : required_tensors(model->config()))
      require(model->tensors()[spec.name].shape == spec.shape);
  } catch (const SetupError& error) {
    require(error.status == ExitStatus::bad_data);
  }
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  try {
    const SafetensorsFile file = SafetensorsFile::parse({data, data + size}, "fuzz");
    const SafetensorsFile again =
        SafetensorsFile::parse(pack_safetensors(file.metadata(), file.tensors()), "again");
    require(again.sealed() && again.tensors().size() == file.tensors().size());
    for (const TensorView& tensor : file.tensors()) {
      const TensorView* copy = again.find(tensor.name);
      require(copy != nullptr && copy->shape == tensor.shape && copy->bytes.size() == tensor.bytes.size());
    }
    read_as_model(again);
  } catch (const SetupError& error) {
    require(error.status == ExitStatus::bad_data);
  }
  return 0;
}
