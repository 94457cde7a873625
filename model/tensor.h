// model/tensor.h - weights in memory: float32 numbers with a shape, by name.
#pragma once

#include <cassert>
#include <cstddef>
#include <map>
#include <string>
#include <string_view>
#include <vector>

namespace csipose {

struct Tensor {
  std::vector<std::size_t> shape;  ///< C order; a Linear's weight is (out, in)
  std::vector<float> data;
};

/// Tensors by the names of docs/weights.md. A name that is not there is a mistake of ours (assert): files are
/// checked when they are read.
class TensorMap {
 public:
  void add(const std::string& name, Tensor tensor) { tensors_[name] = std::move(tensor); }
  const Tensor* find(std::string_view name) const {
    const auto found = tensors_.find(name);
    return found == tensors_.end() ? nullptr : &found->second;
  }
  const Tensor& operator[](std::string_view name) const {
    const Tensor* tensor = find(name);
    assert(tensor != nullptr);
    return *tensor;
  }
  Tensor& at(const std::string& name) { return tensors_.at(name); }
  auto begin() const { return tensors_.begin(); }
  auto end() const { return tensors_.end(); }

 private:
  std::map<std::string, Tensor, std::less<>> tensors_;
};

}  // namespace csipose
