#include "model/onnx_graph.h"

#include <fmt/format.h>
#include <onnx/onnx_pb.h>

#include <algorithm>
#include <cassert>
#include <climits>
#include <cmath>
#include <nlohmann/json.hpp>
#include <optional>
#include <set>
#include <span>
#include <vector>

#include "model/model.h"
#include "model/reference.h"
#include "proto/result.h"
#include "version.h"

namespace csipose {
namespace {

constexpr int kOpset = 17;
constexpr int kIrVersion = 8;  // goes with opset 17
constexpr float kEncoderEpsilon = 1e-6f, kDecoderEpsilon = 1e-5f;
constexpr std::int64_t kJointCount = kJoints;

using Shape = std::vector<std::int64_t>;
struct Value {
  std::string name;
  Shape shape;
};

Shape last_replaced(Shape shape, std::int64_t width) {
  shape.back() = width;
  return shape;
}

/// Operators one by one; each says the shape of what it makes, for the next to read.
class Graph {
 public:
  explicit Graph(onnx::GraphProto& proto) : proto_(proto) {}

  Value constant(const std::string& name, Shape shape, std::span<const float> numbers) {
    onnx::TensorProto& tensor = initializer(name, shape, onnx::TensorProto::FLOAT);
    tensor.set_raw_data(numbers.data(), numbers.size_bytes());  // little-endian, as ours are
    return {name, std::move(shape)};
  }
  // These two may be asked for again.
  Value scalar(float number) {
    const std::string name = fmt::format("number_{}", number);
    return known_.insert(name).second ? constant(name, {}, std::span(&number, 1)) : Value{name, {}};
  }
  Value integers(const Shape& numbers) {
    const std::string name = fmt::format("integers_{}", fmt::join(numbers, "_"));
    if (known_.insert(name).second)
      initializer(name, {static_cast<std::int64_t>(numbers.size())}, onnx::TensorProto::INT64)
          .set_raw_data(numbers.data(), numbers.size() * sizeof(std::int64_t));
    return {name, {}};
  }

  onnx::NodeProto& node(const char* operation, std::initializer_list<Value> inputs,
                        const std::string& output) {
    onnx::NodeProto& made = *proto_.add_node();
    made.set_op_type(operation);
    made.set_name(output);
    for (const Value& input : inputs) made.add_input(input.name);
    made.add_output(output);
    return made;
  }
  /// Operators so far: makes a name its own.
  int size() const { return proto_.node_size(); }
  /// An operator without attributes, under a name that says only what it is unless one is given.
  Value apply(const char* operation, std::initializer_list<Value> inputs, Shape shape,
              std::string name = {}) {
    if (name.empty()) name = fmt::format("{}_{}", operation, proto_.node_size());
    node(operation, inputs, name);
    return {name, std::move(shape)};
  }
  /// b may be repeated along the axes of a.
  Value add(const Value& a, const Value& b) { return apply("Add", {a, b}, a.shape); }
  Value reshape(const Value& x, const Shape& shape) { return apply("Reshape", {x, integers(shape)}, shape); }
  Value transpose(const Value& x, const Shape& order) {
    const std::string name = fmt::format("Transpose_{}", proto_.node_size());
    set_integers(node("Transpose", {x}, name), "perm", order);
    Shape shape;
    for (const std::int64_t axis : order) shape.push_back(x.shape[static_cast<std::size_t>(axis)]);
    return {name, shape};
  }
  Value softmax(const Value& x) {
    const std::string name = fmt::format("Softmax_{}", proto_.node_size());
    set_integer(node("Softmax", {x}, name), "axis", -1);
    return {name, x.shape};
  }

  static void set_integer(onnx::NodeProto& node, const char* name, std::int64_t value) {
    attribute(node, name, onnx::AttributeProto::INT).set_i(value);
  }
  static void set_number(onnx::NodeProto& node, const char* name, float value) {
    attribute(node, name, onnx::AttributeProto::FLOAT).set_f(value);
  }
  static void set_integers(onnx::NodeProto& node, const char* name, const Shape& values) {
    attribute(node, name, onnx::AttributeProto::INTS).mutable_ints()->Assign(values.begin(), values.end());
  }

  Value input(const char* name, Shape shape) { return announce(*proto_.add_input(), name, std::move(shape)); }
  void output(const char* name, const Value& value) {
    node("Identity", {value}, name);
    announce(*proto_.add_output(), name, value.shape);
  }

 private:
  onnx::TensorProto& initializer(const std::string& name, const Shape& shape,
                                 onnx::TensorProto::DataType type) {
    onnx::TensorProto& tensor = *proto_.add_initializer();
    tensor.set_name(name);
    tensor.set_data_type(type);
    tensor.mutable_dims()->Assign(shape.begin(), shape.end());
    return tensor;
  }
  static onnx::AttributeProto& attribute(onnx::NodeProto& node, const char* name,
                                         onnx::AttributeProto::AttributeType type) {
    onnx::AttributeProto& made = *node.add_attribute();
    made.set_name(name);
    made.set_type(type);
    return made;
  }
  static Value announce(onnx::ValueInfoProto& info, const char* name, Shape shape) {
    info.set_name(name);
    onnx::TypeProto::Tensor& type = *info.mutable_type()->mutable_tensor_type();
    type.set_elem_type(onnx::TensorProto::FLOAT);
    for (const std::int64_t size : shape) type.mutable_shape()->add_dim()->set_dim_value(size);
    return {name, std::move(shape)};
  }

  onnx::GraphProto& proto_;
  std::set<std::string> known_;  ///< constants without a tensor
};

/// The layers of model/reference.cpp, in its order and under its names.
class NetworkGraph {
 public:
  NetworkGraph(const Model& model, onnx::GraphProto& proto)
      : config_(model.config()),
        weights_(model.tensors()),
        normalisation_(model.normalisation()),
        graph_(proto) {}

  void build() {
    const Value memory = linear(encode(graph_.input("csi", {1, kChannels, kSamples, kLinks})), "proj");
    Value q = constant_half("query_embedding.weight", queries(), Half::content);
    const Value position = constant_half("query_embedding.weight", queries(), Half::position);
    Value pose = propose(memory), logits;
    if (config_.query_conditioning) q = graph_.add(q, linear(pose, "query_proposal"));
    for (std::size_t i = 0; i < config_.decoder_layers; ++i) {
      q = decoder_layer(fmt::format("decoder.layers.{}.", i), q, position, memory);
      pose = graph_.add(mlp(q, fmt::format("kpt_branches.{}", i), 6), pose);
      if (i + 1 == config_.decoder_layers) logits = linear(q, fmt::format("cls_branches.{}", i));
    }
    pose = graph_.reshape(pose, {1, queries(), kJointCount, 3});
    if (config_.refine_layers > 0) pose = refine(pose, q, memory);
    graph_.output("scores",
                  graph_.apply("Sigmoid", {graph_.reshape(logits, {1, queries()})}, {1, queries()}));
    graph_.output("poses", pose);
  }

 private:
  enum class Half : std::uint8_t { position, content };

  /// No more than there are proposals: receivers have fewer tokens than `paper` has queries.
  std::int64_t queries() const { return std::min(static_cast<std::int64_t>(config_.queries), token_count()); }

  /// x W^T + b for some rows of a packed weight.
  Value linear_rows(const Value& x, const std::string& name, const Tensor& weight, const Tensor& bias,
                    std::size_t first, std::size_t count) {
    const std::size_t width = weight.data.size() / weight.shape[0];
    assert(x.shape.back() == static_cast<std::int64_t>(width));
    std::vector<float> turned(width * count);
    for (std::size_t o = 0; o < count; ++o)
      for (std::size_t i = 0; i < width; ++i) turned[i * count + o] = weight.data[(first + o) * width + i];
    const auto outputs = static_cast<std::int64_t>(count);
    const Value w = graph_.constant(name + ".weight", {static_cast<std::int64_t>(width), outputs}, turned);
    const Value b = graph_.constant(name + ".bias", {outputs}, std::span(bias.data).subspan(first, count));
    const Shape shape = last_replaced(x.shape, outputs);
    return graph_.apply("Add", {graph_.apply("MatMul", {x, w}, shape), b}, shape, name);
  }
  Value linear(const Value& x, const std::string& name) {
    const Tensor& weight = weights_[name + ".weight"];
    return linear_rows(x, name, weight, weights_[name + ".bias"], 0, weight.shape[0]);
  }
  /// Part 0, 1 or 2 (q, k, v) of a packed projection.
  Value projection(const Value& x, const std::string& name, const Tensor& weight, const Tensor& bias,
                   std::size_t part) {
    const std::size_t width = weight.shape[0] / 3;
    return linear_rows(x, fmt::format("{}.{}", name, "qkv"[part]), weight, bias, part * width, width);
  }
  Value layer_norm(const Value& x, const std::string& name, float epsilon) {
    const std::int64_t width = x.shape.back();
    const Value gain = graph_.constant(name + ".weight", {width}, weights_[name + ".weight"].data);
    const Value bias = graph_.constant(name + ".bias", {width}, weights_[name + ".bias"].data);
    Graph::set_number(graph_.node("LayerNormalization", {x, gain, bias}, name), "epsilon", epsilon);
    return {name, x.shape};
  }
  /// As a chain that runtimes know to be the exact GELU; the operator of that name came with opset 20.
  Value gelu(const Value& x) {
    const Value inner =
        graph_.apply("Erf", {graph_.apply("Div", {x, graph_.scalar(std::sqrt(2.f))}, x.shape)}, x.shape);
    const Value twice = graph_.apply("Mul", {x, graph_.add(inner, graph_.scalar(1))}, x.shape);
    return graph_.apply("Mul", {twice, graph_.scalar(0.5f)}, x.shape);
  }
  Value relu(const Value& x) { return graph_.apply("Relu", {x}, x.shape); }
  Value mlp(Value x, const std::string& name, int last) {
    for (int i = 0; i < last; i += 2) x = relu(linear(x, fmt::format("{}.{}", name, i)));
    return linear(x, fmt::format("{}.{}", name, last));
  }

  /// [groups][rows][width] to heads, before or after their rows: [groups][heads][rows][..] or its transpose.
  Value heads_of(const Value& x, std::int64_t groups, std::int64_t heads, bool turned) {
    const std::int64_t width = x.shape.back();
    const std::int64_t rows = x.shape[0] * x.shape[1] / groups;
    return graph_.transpose(graph_.reshape(x, {groups, rows, heads, width / heads}),
                            turned ? Shape{0, 2, 3, 1} : Shape{0, 2, 1, 3});
  }
  /// Each of `groups` parts of the queries against its part of keys and values; the queries' shape again.
  Value attention(const Value& q, const Value& k, const Value& v, std::int64_t groups,
                  std::size_t head_count) {
    const auto heads = static_cast<std::int64_t>(head_count);
    const Value queries = heads_of(q, groups, heads, false), keys = heads_of(k, groups, heads, true),
                values = heads_of(v, groups, heads, false);
    const float scale = 1 / std::sqrt(static_cast<float>(queries.shape[3]));
    const Shape square = {groups, heads, queries.shape[2], keys.shape[3]};
    const Value scores =
        graph_.apply("Mul", {graph_.apply("MatMul", {queries, keys}, square), graph_.scalar(scale)}, square);
    const Value mixed = graph_.apply("MatMul", {graph_.softmax(scores), values}, queries.shape);
    return graph_.reshape(graph_.transpose(mixed, {0, 2, 1, 3}), q.shape);
  }

  std::int64_t token_count() const { return static_cast<std::int64_t>(config_.token_grid().size()); }
  /// csi to tokens as the grid, [1][180][60 or 120], three times as many with receiver_conditioning, or [1][60][180 or 360], normalised.
  Value tokens(const Value& csi) {
    const Value given = normalisation_.backgrounds.empty() ? by_scalars(csi) : against_background(csi);
    const auto of_link = static_cast<std::int64_t>(config_.link_numbers());
    const Value of_links = graph_.transpose(graph_.reshape(given, {1, of_link, kTokens}), {0, 2, 1});
    if (config_.token_links() == 1) return of_links;
    const Value of_samples = graph_.reshape(of_links, {1, kSamples, kLinks, of_link});
    const std::vector<std::int64_t> links = config_.token_links_in_turn();
    const std::string name = "tokens.links";
    Graph::set_integer(graph_.node("Gather", {of_samples, graph_.integers(links)}, name), "axis", 2);
    return graph_.reshape({name, {1, kSamples, static_cast<std::int64_t>(links.size()), of_link}},
                          {1, token_count(), static_cast<std::int64_t>(config_.token_numbers())});
  }
  Value by_scalars(const Value& csi) {
    std::vector<float> mean(kChannels, 0.f), deviation(kChannels, normalisation_.ph_std);
    std::fill_n(mean.begin(), kSubcarriers, normalisation_.amp_mean);
    std::fill_n(deviation.begin(), kSubcarriers, normalisation_.amp_std);
    const Shape by_channel = {kChannels, 1, 1};
    const Value centred =
        graph_.apply("Sub", {csi, graph_.constant("norm.mean", by_channel, mean)}, csi.shape);
    const Value scaled =
        graph_.apply("Div", {centred, graph_.constant("norm.std", by_channel, deviation)}, csi.shape);
    return config_.background_conditioning
               ? side_by_side({scaled, zeros("background.none", csi.shape)}, "scaled")
               : scaled;
  }

  // Against backgrounds, with all links: departures() of all samples from the one that is nearest_background().
  // Shapes are [backgrounds or 1][subcarriers][samples][receivers][antennas]; what lies along a line of phase has the
  // subcarriers last.

  /// A complex number in two values.
  struct Pair {
    Value re, im;
  };
  Value product(const Value& a, const Value& b, const Shape& shape) {
    return graph_.apply("Mul", {a, b}, shape);
  }
  Value difference(const Value& a, const Value& b, const Shape& shape) {
    return graph_.apply("Sub", {a, b}, shape);
  }
  Value squared(const Value& x) { return product(x, x, x.shape); }
  Value power(const Pair& x) { return graph_.add(squared(x.re), squared(x.im)); }
  /// a b, of the shape of a.
  Pair product(const Pair& a, const Pair& b) {
    const Shape& shape = a.re.shape;
    return {difference(product(a.re, b.re, shape), product(a.im, b.im, shape), shape),
            graph_.add(product(a.re, b.im, shape), product(a.im, b.re, shape))};
  }
  Value sum_over(const Value& x, const Shape& axes) {
    Shape shape = x.shape;
    for (const std::int64_t axis : axes) shape[static_cast<std::size_t>(axis)] = 1;
    return graph_.apply("ReduceSum", {x, graph_.integers(axes)}, shape);
  }
  /// The axes of subcarriers and antennas against each other.
  Pair turned_over(const Pair& x) {
    return {graph_.transpose(x.re, {0, 4, 2, 3, 1}), graph_.transpose(x.im, {0, 4, 2, 3, 1})};
  }
  /// exp(-i slope (n - 14.5)): slope [..][1] to [..][30].
  Pair line(const Value& slope) {
    const Value angle = product(slope, from_middle(), last_replaced(slope.shape, kSubcarriers));
    return {graph_.apply("Cos", {angle}, angle.shape),
            graph_.apply("Neg", {graph_.apply("Sin", {angle}, angle.shape)}, angle.shape)};
  }
  Value from_middle() {
    if (!from_middle_) {
      std::vector<float> numbers(kSubcarriers);
      for (std::size_t n = 0; n < kSubcarriers; ++n) numbers[n] = static_cast<float>(n) - kMiddleSubcarrier;
      from_middle_ = graph_.constant("subcarriers_from_middle", {kSubcarriers}, numbers);
    }
    return *from_middle_;
  }
  /// The slope at which |sum c exp(-i slope (n - 14.5))| is largest: c [..][30] to [..][1].
  Value steepest(const Pair& c) {
    if (!slopes_) {
      constexpr std::int64_t kCount = kSlopes;
      std::vector<float> slopes, cosines(kSubcarriers * kSlopes), sines(cosines.size());
      for (std::size_t i = 0; i < kSlopes; ++i) slopes.push_back(slope_of(i));
      for (std::size_t n = 0; n < kSubcarriers; ++n)
        for (std::size_t i = 0; i < kSlopes; ++i) {
          const float angle = slopes[i] * (static_cast<float>(n) - kMiddleSubcarrier);
          cosines[n * kSlopes + i] = std::cos(angle), sines[n * kSlopes + i] = -std::sin(angle);
        }
      slopes_ = Slopes{graph_.constant("slopes", {kCount}, slopes),
                       {graph_.constant("slopes.cosines", {kSubcarriers, kCount}, cosines),
                        graph_.constant("slopes.sines", {kSubcarriers, kCount}, sines)}};
    }
    const Shape each = last_replaced(c.re.shape, slopes_->numbers.shape[0]);
    const auto along = [&](const Value& a, const Value& b) { return graph_.apply("MatMul", {a, b}, each); };
    const Value sums =
        power({difference(along(c.re, slopes_->lines.re), along(c.im, slopes_->lines.im), each),
               graph_.add(along(c.re, slopes_->lines.im), along(c.im, slopes_->lines.re))});
    const std::string best = fmt::format("steepest_{}", graph_.size());
    onnx::NodeProto& most = graph_.node("ArgMax", {sums}, best);
    Graph::set_integer(most, "axis", -1);
    Graph::set_integer(most, "keepdims", 1);
    Value slope = {best + "_slope", last_replaced(each, 1)};
    Graph::set_integer(graph_.node("Gather", {slopes_->numbers, {best, {}}}, slope.name), "axis", 0);
    for (int i = 0; i < kNewtonSteps; ++i) slope = difference(slope, newton_step(c, slope), slope.shape);
    return slope;
  }
  Value newton_step(const Pair& c, const Value& slope) {
    const auto last = static_cast<std::int64_t>(slope.shape.size()) - 1;
    const auto sum = [&](const Pair& x) { return Pair{sum_over(x.re, {last}), sum_over(x.im, {last})}; };
    const auto times_n = [&](const Pair& x) {
      return Pair{product(x.re, from_middle(), x.re.shape), product(x.im, from_middle(), x.re.shape)};
    };
    const Pair turned = product(c, line(slope)), first = times_n(turned);
    const Pair s = sum(turned), s1 = sum(first), s2 = sum(times_n(first));
    const Shape& shape = slope.shape;
    const Value rise = difference(product(s.re, s1.im, shape), product(s.im, s1.re, shape), shape);
    const Value bend =
        difference(power(s1), graph_.add(product(s.re, s2.re, shape), product(s.im, s2.im, shape)), shape);
    const Value step = graph_.apply("Clip",
                                    {graph_.apply("Div", {rise, bend}, shape), graph_.scalar(-kSlopeStep / 2),
                                     graph_.scalar(kSlopeStep / 2)},
                                    shape);
    return graph_.apply(
        "Where", {graph_.apply("Less", {bend, graph_.scalar(0)}, shape), step, graph_.scalar(0)}, shape);
  }
  /// departures() of samples `csi` [1][60][T][9] from responses [B][60][1][3][3]: in phase and across, [B][30][T][3][3].
  Pair departures(const Value& csi, const Value& response) {
    const std::int64_t samples = csi.shape[2];
    const Shape shape = {response.shape[0], kSubcarriers, samples, kReceivers, kAntennas};
    const Value there = graph_.reshape(csi, {1, kChannels, samples, kReceivers, kAntennas});
    const Value amplitude = half_of(there, 0), background = half_of(response, 0);
    const Value phase = difference(half_of(there, 1), half_of(response, 1), shape);
    const Pair turned = {product(graph_.apply("Cos", {phase}, shape), amplitude, shape),
                         product(graph_.apply("Sin", {phase}, shape), amplitude, shape)};
    const auto over_antennas = [&](const Value& x) { return sum_over(product(x, background, shape), {4}); };
    const Pair weighed = turned_over({over_antennas(turned.re), over_antennas(turned.im)});
    const Pair turns = line(steepest(weighed)), along = product(weighed, turns);
    const Value strength = sum_over(squared(amplitude), {1, 4});
    const Value re = sum_over(along.re, {4}), im = sum_over(along.im, {4});
    const Pair scale = {graph_.apply("Div", {re, strength}, re.shape),
                        graph_.apply("Neg", {graph_.apply("Div", {im, strength}, re.shape)}, re.shape)};
    const Pair over = product(turned, turned_over(product(turns, scale)));
    return {difference(over.re, background, shape), over.im};
  }
  /// Amplitudes (0) or phases (1) of [..][60][..].
  Value half_of(const Value& x, std::int64_t half) {
    constexpr std::int64_t kHalf = kSubcarriers;
    Shape shape = x.shape;
    shape[1] = kHalf;
    return graph_.apply(
        "Slice",
        {x, graph_.integers({half * kHalf}), graph_.integers({(half + 1) * kHalf}), graph_.integers({1})},
        shape);
  }

  Value against_background(const Value& csi) {
    const auto count = static_cast<std::int64_t>(normalisation_.backgrounds.size());
    const Shape each = {count, kChannels, 1, kReceivers, kAntennas},
                one = {1, kChannels, 1, kReceivers, kAntennas};
    std::vector<float> response, deviation, logarithms;
    for (const Background& background : normalisation_.backgrounds) {
      response.insert(response.end(), background.response.begin(), background.response.end());
      deviation.insert(deviation.end(), background.deviation.begin(), background.deviation.end());
      double sum = 0;
      for (const float s : background.deviation) sum += std::log(static_cast<double>(s));
      logarithms.push_back(static_cast<float>(sum));
    }
    const Value responses = graph_.constant("norm.background_response", each, response);
    const Value deviations = graph_.constant("norm.background_deviation", each, deviation);
    const auto scaled = [&](const Value& samples, const Value& from, const Value& by) {
      const Pair departed = departures(samples, from);
      const auto part = [&](const Value& x, std::int64_t half) {
        return graph_.apply("Div", {x, half_of(by, half)}, x.shape);
      };
      return Pair{part(departed.re, 0), part(departed.im, 1)};
    };
    const Pair z = scaled(middle_sample(csi), responses, deviations);
    const Value surprise =
        graph_.add(sum_over(graph_.add(tail(z.re), tail(z.im)), {1, 2, 3, 4}),
                   graph_.constant("norm.background_log", {count, 1, 1, 1, 1}, logarithms));
    onnx::NodeProto& least = graph_.node("ArgMin", {surprise}, "background");
    Graph::set_integer(least, "axis", 0);
    Graph::set_integer(least, "keepdims", 1);
    const Value nearest = graph_.reshape({"background", {}}, {1});
    const auto chosen = [&](const Value& table, const char* name) {
      Graph::set_integer(graph_.node("Gather", {table, nearest}, name), "axis", 0);
      return Value{name, one};
    };
    const Pair departed =
        scaled(csi, chosen(responses, "background.response"), chosen(deviations, "background.deviation"));
    if (!config_.background_conditioning) return side_by_side({departed.re, departed.im}, "departures");
    std::vector<float> moves;
    for (const Background& background : normalisation_.backgrounds) {
      const auto one_of = mobility(background);
      moves.insert(moves.end(), one_of.begin(), one_of.end());
    }
    const Value of_chosen =
        chosen(graph_.constant("background.mobilities", each, moves), "background.mobility");
    const Value of_samples =
        graph_.add(zeros("background.samples", {1, kChannels, kSamples, kReceivers, kAntennas}), of_chosen);
    return side_by_side({departed.re, departed.im, of_samples}, "departures");
  }
  Value zeros(const char* name, const Shape& shape) {
    std::int64_t count = 1;
    for (const std::int64_t size : shape) count *= size;
    return graph_.constant(name, shape, std::vector<float>(static_cast<std::size_t>(count), 0.f));
  }
  /// One after the other along the channels.
  Value side_by_side(std::initializer_list<Value> parts, const std::string& name) {
    Graph::set_integer(graph_.node("Concat", parts, name), "axis", 1);
    Shape shape = parts.begin()->shape;
    shape[1] = 0;
    for (const Value& part : parts) shape[1] += part.shape[1];
    return {name, shape};
  }
  /// kTailShape log(1 + z^2 / kFreedom).
  Value tail(const Value& z) {
    const Value square =
        graph_.apply("Div", {squared(z), graph_.scalar(static_cast<float>(kFreedom))}, z.shape);
    const Value logarithm = graph_.apply("Log", {graph_.add(square, graph_.scalar(1))}, z.shape);
    return graph_.apply("Mul", {logarithm, graph_.scalar(static_cast<float>(kTailShape))}, z.shape);
  }
  Value middle_sample(const Value& csi) {
    const std::string name = "csi.middle";
    Graph::set_integer(graph_.node("Gather", {csi, graph_.integers({kSamples / 2})}, name), "axis", 2);
    return {name, {1, kChannels, 1, kLinks}};
  }

  Value encode(const Value& csi) {
    const auto dim = static_cast<std::int64_t>(config_.dim);
    const Value code = graph_.constant("position_code", {1, token_count(), dim},
                                       reference::position_code(config_.dim, config_.token_grid()).data);
    Value x = graph_.add(linear(tokens(csi), "encoder.patch_embed.proj"), code);
    for (std::size_t i = 0; i < config_.depth; ++i) x = block(fmt::format("encoder.blocks.{}.", i), x);
    return layer_norm(x, "encoder.norm", kEncoderEpsilon);
  }
  Value block(const std::string& name, Value x) {
    const Value normed = layer_norm(x, name + "norm1", kEncoderEpsilon);
    const Tensor &weight = weights_[name + "attn.qkv.weight"], &bias = weights_[name + "attn.qkv.bias"];
    const auto part = [&](std::size_t i) { return projection(normed, name + "attn", weight, bias, i); };
    const Value q = part(0), k = part(1), v = part(2);
    x = graph_.add(x, linear(attention(q, k, v, 1, config_.heads), name + "attn.proj"));
    const Value hidden = gelu(linear(layer_norm(x, name + "norm2", kEncoderEpsilon), name + "mlp.fc1"));
    return graph_.add(x, linear(hidden, name + "mlp.fc2"));
  }

  /// Poses of the best tokens, [1][Q][42].
  Value propose(const Value& memory) {
    const std::string last = std::to_string(config_.decoder_layers);
    const Value scores = graph_.reshape(linear(memory, "cls_branches." + last), {token_count()});
    const Value poses = mlp(memory, "kpt_branches." + last, 6);
    // Descending; among equal ones the lower row first, as ours.
    onnx::NodeProto& best = graph_.node("TopK", {scores, graph_.integers({queries()})}, "proposals.score");
    Graph::set_integer(best, "axis", 0);
    best.add_output("proposals.token");
    Graph::set_integer(graph_.node("Gather", {poses, {"proposals.token", {}}}, "proposals.pose"), "axis", 1);
    return {"proposals.pose", {1, queries(), 3 * kJointCount}};
  }

  /// Half of a learned table (rows, 2 E) as [1][rows][E].
  Value constant_half(const std::string& name, std::int64_t rows, Half half) {
    const Tensor& table = weights_[name];
    const std::size_t width = table.shape[1] / 2;
    std::vector<float> part;
    for (std::size_t r = 0; r < static_cast<std::size_t>(rows); ++r) {
      const auto row =
          std::span(table.data).subspan((2 * r + (half == Half::content ? 1 : 0)) * width, width);
      part.insert(part.end(), row.begin(), row.end());
    }
    return graph_.constant(name + (half == Half::content ? ".content" : ".position"),
                           {1, rows, static_cast<std::int64_t>(width)}, part);
  }
  /// q [P][rows][E]: attention within each of P, then all of them against the one memory.
  Value decoder_layer(const std::string& name, Value q, const Value& position, const Value& memory) {
    const auto multi_head = [&](const char* kind, const Value& qs, const Value& ks, const Value& vs,
                                std::int64_t groups) {
      const std::string layer = name + kind;
      const Tensor &weight = weights_[layer + ".in_proj_weight"], &bias = weights_[layer + ".in_proj_bias"];
      const Value q_part = projection(qs, layer, weight, bias, 0),
                  k_part = projection(ks, layer, weight, bias, 1),
                  v_part = projection(vs, layer, weight, bias, 2);
      return linear(attention(q_part, k_part, v_part, groups, config_.decoder_heads), layer + ".out_proj");
    };
    const Value placed = graph_.add(q, position);
    q = layer_norm(graph_.add(q, multi_head("self_attn", placed, placed, q, q.shape[0])), name + "norm1",
                   kDecoderEpsilon);
    q = layer_norm(graph_.add(q, multi_head("cross_attn", graph_.add(q, position), memory, memory, 1)),
                   name + "norm2", kDecoderEpsilon);
    return layer_norm(graph_.add(q, linear(relu(linear(q, name + "linear1")), name + "linear2")),
                      name + "norm3", kDecoderEpsilon);
  }

  /// Joint queries of every person at once, or of one for all when they do not know whom they refine.
  Value refine(Value pose, const Value& q, const Value& memory) {
    Value g = constant_half("refine_query_embedding.weight", kJointCount, Half::content);
    const Value position = constant_half("refine_query_embedding.weight", kJointCount, Half::position);
    if (config_.identity_conditioning) {
      const std::int64_t width = g.shape.back();
      const Value identity = graph_.reshape(linear(q, "refine_identity"), {queries(), 1, width});
      g = graph_.apply("Add", {g, identity}, {queries(), kJointCount, width});
    }
    for (std::size_t j = 0; j < config_.refine_layers; ++j) {
      g = decoder_layer(fmt::format("refine_decoder.layers.{}.", j), g, position, memory);
      const Value offset = mlp(g, fmt::format("refine_kpt_branches.{}", j), 4);
      pose = graph_.add(pose, graph_.reshape(offset, {1, g.shape[0], kJointCount, 3}));
    }
    return pose;
  }

  const NetworkConfig& config_;
  const TensorMap& weights_;
  const Normalisation& normalisation_;
  Graph graph_;
  std::optional<Value> from_middle_;
  struct Slopes {
    Value numbers;  ///< [19]
    Pair lines;     ///< [30][19]
  };
  std::optional<Slopes> slopes_;
};

void describe(const Model& model, onnx::ModelProto& proto) {
  const WindowDemand& demand = model.demand();
  for (const auto& [key, value] : std::initializer_list<std::pair<const char*, std::string>>{
           {"preset", model.config().preset},
           {"config", to_json(model.config())},
           {"stage", model.provenance().stage},
           {"corpus", model.provenance().corpus},
           {"joint_order", nlohmann::json(kJointNames).dump()},
           {"model_to_room", nlohmann::json(model.model_to_room()).dump()},
           {"rate_hz", fmt::format("{}", demand.rate_hz)},
           {"phase", demand.phase},
           {"amplitude", demand.amplitude},
           {"weights_sha256", model.digest()}}) {
    onnx::StringStringEntryProto& entry = *proto.add_metadata_props();
    entry.set_key(key);
    entry.set_value(value);
  }
}

}  // namespace

std::string onnx_file(const Model& model) {
  require_engine_tokens(model.config());
  const double bytes = sizeof(float) * static_cast<double>(parameter_count(model.config()));
  onnx::ModelProto proto;
  proto.set_ir_version(kIrVersion);
  proto.set_producer_name("csipose");
  proto.set_producer_version(CSIPOSE_VERSION);
  proto.add_opset_import()->set_version(kOpset);
  describe(model, proto);
  proto.mutable_graph()->set_name("csipose");
  const bool fits = bytes < INT_MAX;
  if (fits) NetworkGraph(model, *proto.mutable_graph()).build();
  std::string file;
  if (!fits || !proto.SerializeToString(&file))
    throw SetupError(
        ExitStatus::bad_data,
        fmt::format("{} holds {:.1f} GB of weights, and one ONNX file at most 2: make a smaller network",
                    model.file_name(), 1e-9 * bytes));
  return file;
}

}  // namespace csipose
