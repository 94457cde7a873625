// tests/model/onnx_evaluator.h - an ONNX graph computed in plain loops and double, from the description of its
// operators: only those that our graphs have, only float and int64, slow.
// source: github.com/onnx/onnx, docs/Operators.md, opset 17
#pragma once

#include <onnx/onnx_pb.h>

#include <algorithm>
#include <cmath>
#include <cstring>
#include <functional>
#include <map>
#include <numeric>
#include <span>
#include <stdexcept>
#include <string>
#include <vector>

namespace csipose::testing {

struct OnnxTensor {
  std::vector<std::size_t> shape;
  std::vector<double> data;
  std::size_t last() const { return shape.back(); }
};

class OnnxEvaluator {
 public:
  explicit OnnxEvaluator(const onnx::GraphProto& graph) : graph_(graph) {
    for (const onnx::TensorProto& tensor : graph.initializer()) values_[tensor.name()] = read(tensor);
  }

  /// Every value of the graph by its name.
  const std::map<std::string, OnnxTensor>& run(const std::string& input, OnnxTensor x) {
    values_[input] = std::move(x);
    for (const onnx::NodeProto& node : graph_.node()) run(node);
    return values_;
  }

 private:
  using Tensor = OnnxTensor;
  using Sizes = std::vector<std::size_t>;

  static std::size_t count(const Sizes& shape) {
    return std::accumulate(shape.begin(), shape.end(), std::size_t{1}, std::multiplies<>());
  }
  template <class Number>
  static std::vector<double> numbers(const std::string& raw) {
    std::vector<Number> copy(raw.size() / sizeof(Number));
    std::memcpy(copy.data(), raw.data(), raw.size());
    return {copy.begin(), copy.end()};
  }
  static Tensor read(const onnx::TensorProto& proto) {
    Tensor tensor{{proto.dims().begin(), proto.dims().end()}, {}};
    tensor.data = proto.data_type() == onnx::TensorProto::INT64 ? numbers<std::int64_t>(proto.raw_data())
                                                                : numbers<float>(proto.raw_data());
    if (tensor.data.size() != count(tensor.shape))
      throw std::runtime_error(proto.name() + " has another size");
    return tensor;
  }
  static const onnx::AttributeProto& attribute(const onnx::NodeProto& node, const std::string& name) {
    for (const onnx::AttributeProto& it : node.attribute())
      if (it.name() == name) return it;
    throw std::runtime_error(node.name() + " has no " + name);
  }
  const Tensor& in(const onnx::NodeProto& node, int i) const { return values_.at(node.input(i)); }

  /// Place in a tensor of `shape` of the element that the multi-index of `place` in `whole` broadcasts to.
  static std::size_t broadcast(std::size_t place, const Sizes& whole, const Sizes& shape) {
    std::size_t at = 0, stride = 1;
    for (std::size_t i = 0; i < whole.size(); ++i) {
      const std::size_t index = place % whole[whole.size() - 1 - i];
      place /= whole[whole.size() - 1 - i];
      if (i >= shape.size()) continue;
      const std::size_t size = shape[shape.size() - 1 - i];
      if (size != 1) at += stride * index;
      stride *= size;
    }
    return at;
  }
  static Sizes common(const Sizes& a, const Sizes& b) {
    Sizes whole(std::max(a.size(), b.size()), 1);
    for (const Sizes* shape : {&a, &b})
      for (std::size_t i = 0; i < shape->size(); ++i) {
        std::size_t& size = whole[whole.size() - 1 - i];
        const std::size_t other = (*shape)[shape->size() - 1 - i];
        if (size != 1 && other != 1 && size != other) throw std::runtime_error("shapes do not go together");
        size = std::max(size, other);
      }
    return whole;
  }
  static Tensor combine(const Tensor& a, const Tensor& b, const std::function<double(double, double)>& f) {
    Tensor out{common(a.shape, b.shape), {}};
    for (std::size_t i = 0; i < count(out.shape); ++i)
      out.data.push_back(
          f(a.data[broadcast(i, out.shape, a.shape)], b.data[broadcast(i, out.shape, b.shape)]));
    return out;
  }
  static Tensor each(Tensor x, const std::function<double(double)>& f) {
    for (double& value : x.data) value = f(value);
    return x;
  }
  static Tensor matmul(const Tensor& a, const Tensor& b) {
    const std::size_t rows = a.shape[a.shape.size() - 2], inner = a.last(), columns = b.last();
    if (b.shape[b.shape.size() - 2] != inner) throw std::runtime_error("matrices do not go together");
    const Sizes of_a(a.shape.begin(), a.shape.end() - 2), of_b(b.shape.begin(), b.shape.end() - 2);
    Tensor out{common(of_a, of_b), {}};
    const Sizes groups = out.shape;
    out.shape.insert(out.shape.end(), {rows, columns});
    out.data.assign(count(out.shape), 0);
    for (std::size_t g = 0; g < count(groups); ++g) {
      const double* x = &a.data[broadcast(g, groups, of_a) * rows * inner];
      const double* y = &b.data[broadcast(g, groups, of_b) * inner * columns];
      double* z = &out.data[g * rows * columns];
      for (std::size_t r = 0; r < rows; ++r)
        for (std::size_t i = 0; i < inner; ++i)
          for (std::size_t c = 0; c < columns; ++c)
            z[r * columns + c] += x[r * inner + i] * y[i * columns + c];
    }
    return out;
  }
  static Tensor transpose(const Tensor& x, const onnx::AttributeProto& order) {
    const std::size_t axes = x.shape.size();
    Tensor out{Sizes(axes), std::vector<double>(x.data.size())};
    Sizes stride(axes, 1);
    for (std::size_t i = axes - 1; i > 0; --i) stride[i - 1] = stride[i] * x.shape[i];
    for (std::size_t i = 0; i < axes; ++i)
      out.shape[i] = x.shape[static_cast<std::size_t>(order.ints(int(i)))];
    for (std::size_t place = 0; place < x.data.size(); ++place) {
      std::size_t rest = place, from = 0;
      for (std::size_t i = axes; i-- > 0; rest /= out.shape[i])
        from += rest % out.shape[i] * stride[static_cast<std::size_t>(order.ints(int(i)))];
      out.data[place] = x.data[from];
    }
    return out;
  }
  static Tensor reshape(Tensor x, const Tensor& shape) {
    x.shape.assign(shape.data.begin(), shape.data.end());
    if (count(x.shape) != x.data.size()) throw std::runtime_error("numbers are lost in another shape");
    return x;
  }
  /// f on every row of the last axis.
  static Tensor by_row(Tensor x, const std::function<void(std::span<double>)>& f) {
    for (std::size_t first = 0; first < x.data.size(); first += x.last()) f({&x.data[first], x.last()});
    return x;
  }
  static void softmax(std::span<double> row) {
    const double most = *std::max_element(row.begin(), row.end());
    double sum = 0;
    for (double& value : row) sum += value = std::exp(value - most);
    for (double& value : row) value /= sum;
  }
  static Tensor layer_norm(const Tensor& x, const Tensor& gain, const Tensor& bias, double epsilon) {
    return by_row(x, [&](std::span<double> row) {
      const double n = static_cast<double>(row.size());
      const double mean = std::accumulate(row.begin(), row.end(), 0.) / n;
      double variance = 0;
      for (const double value : row) variance += (value - mean) * (value - mean) / n;
      for (std::size_t i = 0; i < row.size(); ++i)
        row[i] = (row[i] - mean) / std::sqrt(variance + epsilon) * gain.data[i] + bias.data[i];
    });
  }
  static Tensor best(const Tensor& x, std::size_t wanted) {
    std::vector<double> order(x.data.size());
    std::iota(order.begin(), order.end(), 0.);
    std::stable_sort(order.begin(), order.end(),
                     [&](double a, double b) { return x.data[std::size_t(a)] > x.data[std::size_t(b)]; });
    order.resize(wanted);
    return {{wanted}, order};
  }
  /// Slices `which` (one axis) of x along `axis`.
  static Tensor gather_slices(const Tensor& x, const Tensor& which, std::size_t axis) {
    const auto axes = x.shape.begin() + static_cast<std::ptrdiff_t>(axis);
    const std::size_t outer = count({x.shape.begin(), axes}), inner = count({axes + 1, x.shape.end()});
    Tensor out{x.shape, {}};
    out.shape[axis] = which.data.size();
    for (std::size_t o = 0; o < outer; ++o)
      for (const double slice : which.data) {
        const auto from = (o * x.shape[axis] + static_cast<std::size_t>(slice)) * inner;
        const auto first = x.data.begin() + static_cast<std::ptrdiff_t>(from);
        out.data.insert(out.data.end(), first, first + static_cast<std::ptrdiff_t>(inner));
      }
    return out;
  }
  /// Over these axes; they stay, with size 1.
  static Tensor reduce_sum(const Tensor& x, const Tensor& axes) {
    Tensor out{x.shape, {}};
    for (const double axis : axes.data) out.shape[static_cast<std::size_t>(axis)] = 1;
    out.data.assign(count(out.shape), 0);
    for (std::size_t i = 0; i < x.data.size(); ++i) out.data[broadcast(i, x.shape, out.shape)] += x.data[i];
    return out;
  }
  /// Place of the largest number of each row; the row stays, with size 1.
  static Tensor most(const Tensor& x) {
    Tensor out{x.shape, {}};
    out.shape.back() = 1;
    for (auto row = x.data.begin(); row != x.data.end(); row += static_cast<std::ptrdiff_t>(x.last()))
      out.data.push_back(
          static_cast<double>(std::max_element(row, row + static_cast<std::ptrdiff_t>(x.last())) - row));
    return out;
  }
  static Tensor concatenated(const Tensor& a, const Tensor& b, std::size_t axis) {
    Sizes shape = a.shape;
    shape[axis] += b.shape[axis];
    Tensor out{shape, {}};
    const std::size_t outer = count({shape.begin(), shape.begin() + static_cast<std::ptrdiff_t>(axis)});
    for (std::size_t o = 0; o < outer; ++o)
      for (const Tensor* part : {&a, &b}) {
        const auto inner = static_cast<std::ptrdiff_t>(part->data.size() / outer);
        const auto first = part->data.begin() + static_cast<std::ptrdiff_t>(o) * inner;
        out.data.insert(out.data.end(), first, first + inner);
      }
    return out;
  }
  /// Along axis 0 of a tensor whose other axes have size 1.
  static Tensor least(const Tensor& x) {
    if (x.shape[0] != x.data.size()) throw std::runtime_error("more than one column");
    const auto place = std::min_element(x.data.begin(), x.data.end()) - x.data.begin();
    return {Sizes(x.shape.size(), 1), {static_cast<double>(place)}};
  }

  static void require_axis(const onnx::NodeProto& node, std::int64_t axis) {
    if (attribute(node, "axis").i() != axis)
      throw std::runtime_error(node.name() + " works along another axis");
  }
  Tensor top_k(const onnx::NodeProto& node) {
    require_axis(node, 0);
    const Tensor& x = in(node, 0);
    const Tensor rows = best(x, static_cast<std::size_t>(in(node, 1).data[0]));
    values_[node.output(1)] = rows;
    return gather_slices(x, rows, 0);
  }
  Tensor gather(const onnx::NodeProto& node) {
    Tensor out =
        gather_slices(in(node, 0), in(node, 1), static_cast<std::size_t>(attribute(node, "axis").i()));
    if (in(node, 0).shape.size() == 1) out.shape = in(node, 1).shape;
    return out;
  }
  Tensor arg_min(const onnx::NodeProto& node) {
    require_axis(node, 0);
    return least(in(node, 0));
  }
  Tensor arg_max(const onnx::NodeProto& node) {
    require_axis(node, -1);
    return most(in(node, 0));
  }
  /// Of axis 1, in steps of one.
  Tensor slice(const onnx::NodeProto& node) {
    if (in(node, 3).data != std::vector<double>{1} || node.input_size() != 4)
      throw std::runtime_error(node.name() + " slices another axis");
    const auto from = static_cast<std::size_t>(in(node, 1).data[0]),
               to = static_cast<std::size_t>(in(node, 2).data[0]);
    Tensor which{{to - from}, std::vector<double>(to - from)};
    std::iota(which.data.begin(), which.data.end(), static_cast<double>(from));
    return gather_slices(in(node, 0), which, 1);
  }
  Tensor where(const onnx::NodeProto& node) {
    const auto pick = [](double chosen, double value) { return chosen != 0 ? value : 0; };
    if (in(node, 2).data != std::vector<double>{0})
      throw std::runtime_error(node.name() + " has another value than 0");
    return combine(in(node, 0), in(node, 1), pick);
  }
  Tensor clip(const onnx::NodeProto& node) {
    const double least = in(node, 1).data[0], most = in(node, 2).data[0];
    return each(in(node, 0), [&](double x) { return std::clamp(x, least, most); });
  }
  Tensor row_softmax(const onnx::NodeProto& node) {
    require_axis(node, -1);
    return by_row(in(node, 0), softmax);
  }

  void run(const onnx::NodeProto& node) {
    using Operation = std::function<Tensor()>;
    const auto two = [&](auto f) { return [&, f] { return combine(in(node, 0), in(node, 1), f); }; };
    const auto one = [&](double (*f)(double)) { return [&, f] { return each(in(node, 0), f); }; };
    const std::map<std::string, Operation> operations = {
        {"Add", two(std::plus<>())},
        {"Sub", two(std::minus<>())},
        {"Mul", two(std::multiplies<>())},
        {"Div", two(std::divides<>())},
        {"Erf", one([](double x) { return std::erf(x); })},
        {"Relu", one([](double x) { return std::max(x, 0.); })},
        {"Sigmoid", one([](double x) { return 1 / (1 + std::exp(-x)); })},
        {"Identity", one([](double x) { return x; })},
        {"MatMul", [&] { return matmul(in(node, 0), in(node, 1)); }},
        {"Reshape", [&] { return reshape(in(node, 0), in(node, 1)); }},
        {"Transpose", [&] { return transpose(in(node, 0), attribute(node, "perm")); }},
        {"Softmax", [&] { return row_softmax(node); }},
        {"LayerNormalization",
         [&] {
           const auto epsilon = static_cast<double>(attribute(node, "epsilon").f());
           return layer_norm(in(node, 0), in(node, 1), in(node, 2), epsilon);
         }},
        {"Cos", one([](double x) { return std::cos(x); })},
        {"Sin", one([](double x) { return std::sin(x); })},
        {"Log", one([](double x) { return std::log(x); })},
        {"Neg", one([](double x) { return -x; })},
        {"Less", two([](double a, double b) { return a < b ? 1. : 0.; })},
        {"Where", [&] { return where(node); }},
        {"Clip", [&] { return clip(node); }},
        {"Slice", [&] { return slice(node); }},
        {"Concat",
         [&] {
           Tensor all = in(node, 0);
           for (int i = 1; i < node.input_size(); ++i)
             all = concatenated(all, in(node, i), static_cast<std::size_t>(attribute(node, "axis").i()));
           return all;
         }},
        {"ReduceSum", [&] { return reduce_sum(in(node, 0), in(node, 1)); }},
        {"ArgMax", [&] { return arg_max(node); }},
        {"ArgMin", [&] { return arg_min(node); }},
        {"Gather", [&] { return gather(node); }},
        {"TopK", [&] { return top_k(node); }}};
    const auto found = operations.find(node.op_type());
    if (found == operations.end()) throw std::runtime_error("no operator " + node.op_type());
    values_[node.output(0)] = found->second();
  }

  const onnx::GraphProto& graph_;
  std::map<std::string, Tensor> values_;
};

}  // namespace csipose::testing
