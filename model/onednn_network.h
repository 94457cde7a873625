// model/onednn_network.h - the network on the operations of onednn_ops.h: encoder, pose decoder, refinement.
//
// Reads beside model/reference.cpp, which is the same network in plain loops. Shapes: N tokens (20 for each
// present link or receiver), D and E widths, Q queries, J joints (14). One window at a time, no allocation of our own
// after prepare().
#pragma once

#include <algorithm>
#include <map>
#include <span>
#include <string>
#include <vector>

#include "model/engine.h"
#include "model/model.h"
#include "model/onednn_ops.h"

namespace csipose {

/// In which formats a precision computes on a processor. Residual stream, LayerNorm, softmax, scores of
/// proposals and all outputs are float32 in each.
struct NumberPlan {
  Element encoder = Element::f32;    ///< operands of the encoder's linears
  Element attention = Element::f32;  ///< q, k, v and probabilities of the encoder
  Element decoder = Element::f32;    ///< operands of decoder, heads and refinement
};
/// int8 keeps attention and decoder in bf16, in float32 where the processor has no unit for bf16.
NumberPlan number_plan(Precision precision, const CpuFeatures& cpu);

/// What a run leaves behind for those who compare or calibrate. Off (the default) it costs a branch.
class Probe {
 public:
  bool keep_stages = false;
  bool watch_inputs = false;  ///< largest magnitude at the input of each encoder linear; float32 engines only

  void start();
  void stage(const char* name, std::span<const float> values);
  void stage(const char* name, std::size_t index, std::span<const float> values);
  void append(const char* name, std::span<const float> values);
  void input(const std::string& layer, const void* values, std::size_t count);
  std::span<const float> stage_values(const std::string& name) const;
  const std::map<std::string, float>& input_max() const { return input_max_; }

 private:
  std::map<std::string, std::vector<float>> stages_;
  std::map<std::string, float> input_max_;
};

struct LayerNorm {
  std::span<const float> gain, bias;
  float epsilon;
};

/// Scratch of all blocks of the encoder; they run one after the other.
struct EncoderBuffers {
  EncoderBuffers(std::size_t dim, const NumberPlan& plan);
  Buffer normed, q, k, v, attended, attended_for_projection, hidden;
};

/// x += Proj(MHA(LN(x))); x += fc2(GELU(fc1(LN(x)))).
class EncoderBlock {
 public:
  EncoderBlock(OneDnnContext& context, const Model& model, const std::string& prefix, const NumberPlan& plan);
  void prepare(std::size_t tokens);
  void run(float* x, std::size_t tokens, Attention& attention, EncoderBuffers& buffers, Probe& probe);
  const std::string& implementation() const { return fc1_.implementation(); }

 private:
  struct LayerNames {
    std::string qkv, proj, fc1, fc2;
  };
  struct InputScales {
    float qkv = 1, proj = 1, fc1 = 1, fc2 = 1;
  };
  static InputScales input_scales(const Model& model, const LayerNames& names, const NumberPlan& plan);
  Linear make_projection(OneDnnContext& context, const Model& model, std::size_t part) const;
  void normalise(const float* x, const LayerNorm& norm, float scale, std::size_t tokens, Buffer& out) const;
  void attend(float* x, std::size_t tokens, Attention& attention, EncoderBuffers& buffers, Probe& probe);
  void transform(float* x, std::size_t tokens, EncoderBuffers& buffers, Probe& probe);

  OneDnnContext* context_;
  NumberPlan plan_;
  LayerNames names_;
  InputScales scales_;
  LayerNorm norm1_, norm2_;
  Linear q_, k_, v_, proj_, fc1_, fc2_;
};

class OneDnnEncoder {
 public:
  OneDnnEncoder(OneDnnContext& context, const Model& model, const NumberPlan& plan);
  void prepare(std::size_t tokens);
  /// x and background as in Engine::run. Returns [N][D] in the decoder's format, N = token_count(links).
  const void* run(std::span<const float> x, LinkSet links, const Background* background, Probe& probe);
  const std::string& implementation() const { return blocks_.front().implementation(); }

 private:
  std::size_t gather_tokens(std::span<const float> x, LinkSet links, const Background* background);

  OneDnnContext* context_;
  NumberPlan plan_;
  NetworkConfig config_;
  Normalisation normalisation_;
  std::size_t dim_;
  std::vector<float> position_code_;  ///< [180][D], as the grid
  Linear embed_;
  std::vector<EncoderBlock> blocks_;
  LayerNorm norm_;
  Attention attention_;
  EncoderBuffers buffers_;
  Buffer tokens_, residual_, final_float_, final_;
};

/// Queries on their way through the decoder: float32, and the copies that products read.
struct QueryState {
  QueryState(std::size_t rows, std::size_t width, Element element);
  Buffer values, typed, with_position;
};

/// q = LN(q + SA(q + pos, q + pos, q)); q = LN(q + CA(q + pos, memory, memory)); q = LN(q + W2 ReLU(W1 q)).
/// `batch` sequences of `queries` rows attend to themselves; all attend to one memory of `keys` rows.
class DecoderLayer {
 public:
  struct Buffers {
    Buffers(std::size_t rows, std::size_t width, std::size_t ffn, Element element);
    Buffer q, k, v, attended, hidden;
  };

  DecoderLayer(OneDnnContext& context, const TensorMap& tensors, const std::string& prefix, Element element);
  void prepare(const AttentionShape& shape);
  /// Keys and values of the memory; once a window.
  void project_memory(const void* memory, std::size_t keys);
  void run(QueryState& state, const float* position, const AttentionShape& shape, Attention& attention,
           Buffers& buffers);

 private:
  void normalise(const LayerNorm& norm, QueryState& state, const float* position, std::size_t rows) const;

  struct Projections {
    Projections(OneDnnContext& context, const TensorMap& tensors, const std::string& name, Element element);
    static Linear make(OneDnnContext& context, const TensorMap& tensors, const std::string& name,
                       std::size_t part, Element element);
    Linear q, k, v, out;
  };

  OneDnnContext* context_;
  Element element_;
  LayerNorm norm1_, norm2_, norm3_;
  Projections self_, cross_;
  Linear linear1_, linear2_;
  Buffer memory_keys_, memory_values_;
};

/// Linears with ReLU between them; the last one gives float32.
class Mlp {
 public:
  Mlp(OneDnnContext& context, const TensorMap& tensors, const std::string& prefix,
      std::span<const int> layers, Element element, std::size_t rows);
  void prepare(std::size_t rows);
  void run(const void* x, float* y, std::size_t rows);
  std::size_t outputs() const { return layers_.back().outputs(); }

 private:
  std::vector<Linear> layers_;
  Buffer ping_, pong_;
};

class OneDnnDecoder {
 public:
  /// `refined_queries` as in OneDnnOptions.
  OneDnnDecoder(OneDnnContext& context, const Model& model, const NumberPlan& plan,
                std::size_t refined_queries);
  void prepare(std::size_t tokens);
  /// features [N][D] in the decoder's format.
  NetworkOutput run(const void* features, std::size_t tokens, Probe& probe);

 private:
  std::size_t queries_for(std::size_t tokens) const { return std::min(config_.queries, tokens); }
  std::size_t given_for(std::size_t tokens) const { return std::min(refined_queries_, queries_for(tokens)); }
  /// Without identity conditioning the refinement is the same for all persons of a window and is done once.
  std::size_t people_for(std::size_t tokens) const {
    return config_.identity_conditioning ? given_for(tokens) : 1;
  }
  std::size_t most_people() const { return config_.identity_conditioning ? refined_queries_ : 1; }
  void project(const void* features, std::size_t tokens, Probe& probe);
  void propose(std::size_t tokens, Probe& probe);
  void decode(std::size_t tokens, Probe& probe);
  void select(std::size_t queries, std::size_t given);
  void refine(std::size_t tokens, Probe& probe);
  void start_state(QueryState& state, const std::vector<float>& position, std::size_t rows) const;
  void start_queries(std::size_t queries);
  void start_refinement(std::size_t given, std::size_t people);
  void make_decoder(const TensorMap& tensors);
  void make_refinement(const TensorMap& tensors);
  void make_buffers();

  OneDnnContext* context_;
  NetworkConfig config_;
  std::size_t refined_queries_;
  Element element_;
  std::vector<float> query_position_, query_content_;    ///< [Q][E]
  std::vector<float> refine_position_, refine_content_;  ///< [people * 14][E], [14][E]
  Linear project_;
  std::vector<Linear> class_heads_;  ///< per decoder layer, then the proposals'
  std::vector<Mlp> pose_heads_;      ///< likewise
  std::vector<DecoderLayer> layers_, refine_layers_;
  std::vector<Mlp> refine_heads_;
  std::vector<Linear> query_proposal_, identity_, sigma_;  ///< one or none
  Attention attention_;
  QueryState state_, refine_state_;
  DecoderLayer::Buffers buffers_, refine_buffers_;
  Buffer memory_, memory_typed_, proposal_logits_, proposal_poses_, logits_, poses_, offsets_, identities_,
      raw_sigma_, sigma_m_;
  std::vector<std::uint32_t> ranking_;
};

}  // namespace csipose
