// model/onednn_ops.h - what the network is made of, on oneDNN: matrix product with packed weights, attention,
// LayerNorm.
//
// Each operation is made once from its weights, then told by prepare() of every row count that it will meet:
// that makes the primitives (a millisecond each), outside the loop. run() only executes. Packed weights do
// not depend on the row count, so one copy serves 180, 120 and 60 tokens.
//
// Formats: an Element says how numbers lie in memory between operations. The residual stream is always
// float32. int8 operands carry one scale per tensor (known from calibration) for the input and one per output
// column for the weight:
//   y[r][o] = (sum_i x8[r][i] w8[i][o]) * input_scale * weight_scale[o] + bias[o].
//
// Not thread-safe; one thread calls, the work is split among the threads of the context.
#pragma once

#include <dnnl.hpp>
#include <map>
#include <set>
#include <span>
#include <string>
#include <unordered_map>
#include <vector>

#include "model/cpu.h"
#include "model/onednn_rows.h"
#include "model/onednn_threads.h"

namespace csipose {

/// Memory for activations, 64-byte aligned, touched when it is made.
class Buffer {
 public:
  Buffer() = default;
  explicit Buffer(std::size_t bytes);
  Buffer(Buffer&& other) noexcept;
  Buffer& operator=(Buffer&& other) noexcept;
  ~Buffer();
  void* data() const { return data_; }
  float* floats() const { return static_cast<float*>(data_); }
  std::size_t bytes() const { return bytes_; }

 private:
  void* data_ = nullptr;
  std::size_t bytes_ = 0;
};

/// What all operations of one engine share: library handles, threads, row kernels, scratch memory.
class OneDnnContext {
 public:
  OneDnnContext(int threads, std::vector<int> cpus);
  OneDnnContext(const OneDnnContext&) = delete;

  /// At the start of every run: see InferenceThreads::enter.
  void enter() { threads_.enter(); }
  const CpuFeatures& cpu() const { return cpu_; }
  const RowKernels& rows() const { return rows_; }
  const InferenceThreads& threads() const { return threads_; }
  const dnnl::engine& engine() const { return engine_; }
  dnnl::stream& stream() { return stream_; }

  /// Enough scratch memory for all primitives made so far; they run one after the other and share it.
  void need_scratch(std::size_t bytes);
  void* scratch() const { return scratch_.data(); }
  /// Notes which of the library's implementations serves; throws SetupError when it is the reference loop,
  /// which is hundreds of times slower and would be taken in silence.
  void note_implementation(const std::string& name, const std::string& what);
  /// All that serve, as the library names them: "brg:avx512_core_bf16".
  const std::set<std::string>& implementations() const { return implementations_; }

  // Row operations on all threads.
  void norm(const NormRows& op, std::size_t rows) const;
  void softmax(const SoftmaxRows& op, std::size_t rows) const;
  void store(const StoreRows& op, std::size_t rows) const;

 private:
  CpuFeatures cpu_;
  InferenceThreads threads_;
  const RowKernels& rows_;
  dnnl::engine engine_;
  dnnl::stream stream_;
  Buffer scratch_;
  std::set<std::string> implementations_;
};

/// One execution: a primitive and its arguments, whose addresses are filled in at run time.
struct PreparedPrimitive {
  dnnl::primitive primitive;
  std::unordered_map<int, dnnl::memory> arguments;
  void run(OneDnnContext& context);
};

/// What a Linear does with its product.
enum class Epilogue : std::uint8_t {
  none,
  relu,
  gelu,  ///< exact (erf)
  add,   ///< onto what is in the destination (float32)
};

struct LinearPlan {
  Element source = Element::f32, destination = Element::f32;
  Epilogue epilogue = Epilogue::none;
  float source_scale = 1;       ///< s8 source: value = number * source_scale
  float destination_scale = 1;  ///< s8 destination: likewise
};

/// Part of a Linear's parameters as files have it: weight (outputs, inputs), bias (outputs).
struct LinearWeights {
  std::span<const float> weight, bias;
  std::size_t inputs() const { return weight.size() / bias.size(); }
  std::size_t outputs() const { return bias.size(); }
};

/// y = x W^T + b. x [rows][inputs] dense in plan.source, y [rows][outputs] dense in plan.destination. What `weights` names must
/// stay for as long as prepare() is called.
class Linear {
 public:
  Linear(OneDnnContext& context, const LinearWeights& weights, const LinearPlan& plan, std::string name);
  void prepare(std::size_t rows);
  void run(const void* x, void* y, std::size_t rows);
  std::size_t inputs() const { return inputs_; }
  std::size_t outputs() const { return outputs_; }
  /// Of the implementation that was prepared last.
  const std::string& implementation() const { return implementation_; }

 private:
  dnnl::matmul::primitive_desc describe(std::size_t rows) const;
  dnnl::primitive_attr attributes() const;
  /// The weight in this layout: for few rows the library may want another than for many.
  const dnnl::memory& packed(const dnnl::memory::desc& layout);
  std::vector<float> steps() const;
  void store_bias();

  OneDnnContext* context_;
  LinearPlan plan_;
  std::string name_, implementation_;
  std::size_t inputs_, outputs_;
  LinearWeights weights_;
  std::vector<float> output_scales_;  ///< s8 only: input_scale * weight_scale per column
  std::vector<dnnl::memory> packed_;
  dnnl::memory bias_;
  std::map<std::size_t, PreparedPrimitive> by_rows_;
};

/// How many sequences, and their lengths.
struct AttentionShape {
  std::size_t batch = 1, queries = 0, keys = 0;
  auto operator<=>(const AttentionShape&) const = default;
};

/// softmax(q k^T / sqrt(head width)) v per head. q and y [batch][queries][width], k and v
/// [batch][keys][width], all dense in `element` (float32 or bf16), y in `result`; scores and softmax are
/// float32.
class Attention {
 public:
  Attention(OneDnnContext& context, std::size_t width, std::size_t heads, Element element, Element result);
  void prepare(const AttentionShape& shape);
  void run(const void* q, const void* k, const void* v, void* y, const AttentionShape& shape);

 private:
  struct Products {
    PreparedPrimitive scores, values;
  };
  PreparedPrimitive product(const dnnl::memory::desc& a, const dnnl::memory::desc& b,
                            const dnnl::memory::desc& c);

  OneDnnContext* context_;
  std::size_t width_, heads_;
  Element element_, result_;
  Buffer scores_, probabilities_;  ///< [batch][heads][queries][keys], for the largest shape
  std::map<AttentionShape, Products> by_shape_;
};

}  // namespace csipose
