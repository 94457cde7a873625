#include "model/onednn_ops.h"

#include <fmt/format.h>

#include <algorithm>
#include <cassert>
#include <cmath>
#include <cstdlib>
#include <cstring>
#include <new>
#include <ranges>
#include <utility>

#include "proto/result.h"

namespace csipose {
namespace {

using dnnl::memory;
using Tag = memory::format_tag;

constexpr std::size_t kAlignment = 64;

memory::data_type type_of(Element element) {
  switch (element) {
    case Element::f32:
      return memory::data_type::f32;
    case Element::bf16:
      return memory::data_type::bf16;
    case Element::s8:
      break;
  }
  return memory::data_type::s8;
}

memory::dim dim(std::size_t size) { return static_cast<memory::dim>(size); }

/// Arguments whose address changes from run to run; the library only reads what is an input.
void set_address(PreparedPrimitive& step, int argument, const void* address) {
  step.arguments.at(argument).set_data_handle(const_cast<void*>(address));
}

float largest_magnitude(const float* numbers, std::size_t count) {
  float most = 0;
  for (std::size_t i = 0; i < count; ++i) most = std::max(most, std::abs(numbers[i]));
  return most;
}

memory::desc dense(std::size_t rows, std::size_t columns, Element element) {
  return {{dim(rows), dim(columns)}, type_of(element), Tag::ab};
}

/// [batch][tokens][heads * head_width] seen as (batch, heads, tokens, head width).
memory::desc per_head(std::size_t batch, std::size_t heads, std::size_t tokens, std::size_t head_width,
                      Element element) {
  return {{dim(batch), dim(heads), dim(tokens), dim(head_width)}, type_of(element), Tag::acbd};
}
/// The same memory as (batch, heads, head width, tokens).
memory::desc per_head_transposed(std::size_t batch, std::size_t heads, std::size_t tokens,
                                 std::size_t head_width, Element element) {
  return {{dim(batch), dim(heads), dim(head_width), dim(tokens)}, type_of(element), Tag::adbc};
}

}  // namespace

Buffer::Buffer(std::size_t bytes) : bytes_((bytes + kAlignment - 1) / kAlignment * kAlignment) {
  if (bytes_ == 0) return;
  data_ = std::aligned_alloc(kAlignment, bytes_);
  if (data_ == nullptr) throw std::bad_alloc();
  std::memset(data_, 0, bytes_);
}
Buffer::Buffer(Buffer&& other) noexcept
    : data_(std::exchange(other.data_, nullptr)), bytes_(std::exchange(other.bytes_, 0)) {}
Buffer& Buffer::operator=(Buffer&& other) noexcept {
  std::swap(data_, other.data_);
  std::swap(bytes_, other.bytes_);
  return *this;
}
Buffer::~Buffer() { std::free(data_); }

OneDnnContext::OneDnnContext(int threads, std::vector<int> cpus)
    : cpu_(cpu_features()),
      threads_(threads, std::move(cpus)),
      rows_(row_kernels(cpu_)),
      engine_(dnnl::engine::kind::cpu, 0),
      stream_(engine_) {
  enter();  // before the first primitive descriptor: one that was made for another number of threads is slow
}

void OneDnnContext::need_scratch(std::size_t bytes) {
  if (bytes > scratch_.bytes()) scratch_ = Buffer(bytes);
}

void OneDnnContext::note_implementation(const std::string& name, const std::string& what) {
  if (name.find("ref") != std::string::npos)
    throw SetupError(
        ExitStatus::unavailable,
        fmt::format("oneDNN has no fast code for {} on this processor ({}), only its reference loop '{}'; "
                    "choose another precision",
                    what, to_string(cpu_), name));
  implementations_.insert(name);
}

void OneDnnContext::norm(const NormRows& op, std::size_t rows) const {
  threads_.for_rows(rows, [&](std::size_t first, std::size_t last) { rows_.norm(op, first, last); });
}
void OneDnnContext::softmax(const SoftmaxRows& op, std::size_t rows) const {
  threads_.for_rows(rows, [&](std::size_t first, std::size_t last) { rows_.softmax(op, first, last); });
}
void OneDnnContext::store(const StoreRows& op, std::size_t rows) const {
  threads_.for_rows(rows, [&](std::size_t first, std::size_t last) { rows_.store(op, first, last); });
}

void PreparedPrimitive::run(OneDnnContext& context) {
  const auto scratch = arguments.find(DNNL_ARG_SCRATCHPAD);
  if (scratch != arguments.end()) scratch->second.set_data_handle(context.scratch());
  primitive.execute(context.stream(), arguments);
}

// Linear.

Linear::Linear(OneDnnContext& context, const LinearWeights& weights, const LinearPlan& plan, std::string name)
    : context_(&context),
      plan_(plan),
      name_(std::move(name)),
      inputs_(weights.inputs()),
      outputs_(weights.outputs()),
      weights_(weights) {
  assert(weights.weight.size() == inputs_ * outputs_);
  assert(plan.destination == Element::f32 || plan.epilogue != Epilogue::add);
  if (plan_.source == Element::s8)
    for (std::size_t o = 0; o < outputs_; ++o) {
      const float most = largest_magnitude(&weights.weight[o * inputs_], inputs_);
      output_scales_.push_back(plan_.source_scale * (most > 0 ? most / 127 : 1.f));
    }
  store_bias();
}

dnnl::primitive_attr Linear::attributes() const {
  dnnl::primitive_attr attributes;
  attributes.set_scratchpad_mode(dnnl::scratchpad_mode::user);
  constexpr int kPerColumn = 1 << 1;
  if (plan_.source == Element::s8) attributes.set_output_scales(kPerColumn, output_scales_);
  const float scale = plan_.destination == Element::s8 ? 1 / plan_.destination_scale : 1.f;
  dnnl::post_ops after;
  switch (plan_.epilogue) {
    case Epilogue::none:
      assert(plan_.destination != Element::s8);
      break;
    case Epilogue::relu:
      after.append_eltwise(scale, dnnl::algorithm::eltwise_relu, 0, 0);
      break;
    case Epilogue::gelu:
      after.append_eltwise(scale, dnnl::algorithm::eltwise_gelu_erf, 0, 0);
      break;
    case Epilogue::add:
      after.append_sum();
      break;
  }
  attributes.set_post_ops(after);
  return attributes;
}

dnnl::matmul::primitive_desc Linear::describe(std::size_t rows) const try {
  const memory::desc weight({dim(inputs_), dim(outputs_)}, type_of(plan_.source), Tag::any);
  return {{dense(rows, inputs_, plan_.source), weight, dense(1, outputs_, Element::f32),
           dense(rows, outputs_, plan_.destination)},
          attributes(),
          context_->engine()};
} catch (const dnnl::error& error) {
  throw SetupError(
      ExitStatus::unavailable,
      fmt::format(
          "oneDNN cannot compute {} in the wanted precision on this processor ({}): {}; choose another "
          "precision",
          name_, to_string(context_->cpu()), error.what()));
}

/// The weight as numbers of its format: for int8 brought to its 255 steps.
std::vector<float> Linear::steps() const {
  std::vector<float> whole(weights_.weight.begin(), weights_.weight.end());
  for (std::size_t o = 0; o < output_scales_.size(); ++o) {
    const float step = output_scales_[o] / plan_.source_scale;
    for (std::size_t i = 0; i < inputs_; ++i)
      whole[o * inputs_ + i] = std::nearbyint(whole[o * inputs_ + i] / step);
  }
  return whole;
}

/// The weight is stored (outputs, inputs); the library transposes, converts and packs it.
const memory& Linear::packed(const memory::desc& layout) {
  const auto found = std::ranges::find_if(packed_, [&](const memory& it) { return it.get_desc() == layout; });
  if (found != packed_.end()) return *found;
  std::vector<float> whole = steps();
  memory plain({{dim(inputs_), dim(outputs_)}, memory::data_type::f32, Tag::ba}, context_->engine(),
               whole.data());
  packed_.emplace_back(layout, context_->engine());
  dnnl::reorder(plain, packed_.back()).execute(context_->stream(), plain, packed_.back());
  context_->stream().wait();
  return packed_.back();
}

/// For int8 it is divided by the scales, for the library multiplies accumulator plus bias by them.
void Linear::store_bias() {
  bias_ = memory(dense(1, outputs_, Element::f32), context_->engine());
  auto* numbers = static_cast<float*>(bias_.get_data_handle());
  std::ranges::copy(weights_.bias, numbers);
  for (std::size_t o = 0; o < output_scales_.size(); ++o) numbers[o] /= output_scales_[o];
}

void Linear::prepare(std::size_t rows) {
  if (by_rows_.count(rows) > 0) return;
  const dnnl::matmul::primitive_desc description = describe(rows);
  implementation_ = description.impl_info_str();
  context_->note_implementation(implementation_, name_);
  context_->need_scratch(description.scratchpad_desc().get_size());
  PreparedPrimitive step;
  step.primitive = dnnl::matmul(description);
  const dnnl::engine& engine = context_->engine();
  step.arguments = {{DNNL_ARG_SRC, memory(description.src_desc(), engine, nullptr)},
                    {DNNL_ARG_WEIGHTS, packed(description.weights_desc())},
                    {DNNL_ARG_BIAS, bias_},
                    {DNNL_ARG_DST, memory(description.dst_desc(), engine, nullptr)},
                    {DNNL_ARG_SCRATCHPAD, memory(description.scratchpad_desc(), engine, nullptr)}};
  by_rows_.emplace(rows, std::move(step));
}

void Linear::run(const void* x, void* y, std::size_t rows) {
  PreparedPrimitive& step = by_rows_.at(rows);
  set_address(step, DNNL_ARG_SRC, x);
  set_address(step, DNNL_ARG_DST, y);
  step.run(*context_);
}

// Attention.

Attention::Attention(OneDnnContext& context, std::size_t width, std::size_t heads, Element element,
                     Element result)
    : context_(&context), width_(width), heads_(heads), element_(element), result_(result) {
  assert(width % heads == 0 && element != Element::s8);
}

PreparedPrimitive Attention::product(const memory::desc& a, const memory::desc& b, const memory::desc& c) {
  dnnl::primitive_attr attributes;
  attributes.set_scratchpad_mode(dnnl::scratchpad_mode::user);
  const dnnl::matmul::primitive_desc description({a, b, c}, attributes, context_->engine());
  context_->note_implementation(description.impl_info_str(), "attention");
  context_->need_scratch(description.scratchpad_desc().get_size());
  PreparedPrimitive step;
  step.primitive = dnnl::matmul(description);
  const dnnl::engine& engine = context_->engine();
  step.arguments = {{DNNL_ARG_SRC, memory(a, engine, nullptr)},
                    {DNNL_ARG_WEIGHTS, memory(b, engine, nullptr)},
                    {DNNL_ARG_DST, memory(c, engine, nullptr)},
                    {DNNL_ARG_SCRATCHPAD, memory(description.scratchpad_desc(), engine, nullptr)}};
  return step;
}

void Attention::prepare(const AttentionShape& s) {
  if (by_shape_.count(s) > 0) return;
  const std::size_t head_width = width_ / heads_;
  const memory::dims square = {dim(s.batch), dim(heads_), dim(s.queries), dim(s.keys)};
  const memory::desc scores(square, memory::data_type::f32, Tag::abcd);
  const memory::desc probabilities(square, type_of(element_), Tag::abcd);
  Products products;
  products.scores = product(per_head(s.batch, heads_, s.queries, head_width, element_),
                            per_head_transposed(s.batch, heads_, s.keys, head_width, element_), scores);
  products.values = product(probabilities, per_head(s.batch, heads_, s.keys, head_width, element_),
                            per_head(s.batch, heads_, s.queries, head_width, result_));
  by_shape_.emplace(s, std::move(products));
  const std::size_t elements = s.batch * heads_ * s.queries * s.keys;
  if (elements * sizeof(float) > scores_.bytes()) scores_ = Buffer(elements * sizeof(float));
  if (element_ != Element::f32 && elements * size_of(element_) > probabilities_.bytes())
    probabilities_ = Buffer(elements * size_of(element_));
}

void Attention::run(const void* q, const void* k, const void* v, void* y, const AttentionShape& shape) {
  Products& products = by_shape_.at(shape);
  set_address(products.scores, DNNL_ARG_SRC, q);
  set_address(products.scores, DNNL_ARG_WEIGHTS, k);
  set_address(products.scores, DNNL_ARG_DST, scores_.data());
  products.scores.run(*context_);
  const void* probabilities = element_ == Element::f32 ? scores_.data() : probabilities_.data();
  const float factor = 1 / std::sqrt(static_cast<float>(width_ / heads_));
  context_->softmax({scores_.floats(), shape.keys, factor, {const_cast<void*>(probabilities), element_}},
                    shape.batch * heads_ * shape.queries);
  set_address(products.values, DNNL_ARG_SRC, probabilities);
  set_address(products.values, DNNL_ARG_WEIGHTS, v);
  set_address(products.values, DNNL_ARG_DST, y);
  products.values.run(*context_);
}

}  // namespace csipose
