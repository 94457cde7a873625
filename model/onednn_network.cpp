#include "model/onednn_network.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cassert>
#include <cmath>
#include <cstring>

#include "model/reference.h"

namespace csipose {
namespace {

constexpr float kEncoderEpsilon = 1e-6f,
                kDecoderEpsilon = 1e-5f;  // of the LayerNorms; model/reference.cpp has the same
constexpr float kLeastSigma_m = 0.001f;
constexpr std::array<int, 4> kPoseHeadLayers = {0, 2, 4, 6};
constexpr std::array<int, 3> kRefineHeadLayers = {0, 2, 4};

LinearWeights whole(const TensorMap& tensors, const std::string& name) {
  return {tensors[name + ".weight"].data, tensors[name + ".bias"].data};
}

/// Third `part` (0 q, 1 k, 2 v) of a packed projection (3 width, width).
LinearWeights third(const Tensor& weight, const Tensor& bias, std::size_t part) {
  const std::size_t width = bias.data.size() / 3;
  return {std::span(weight.data).subspan(part * width * width, width * width),
          std::span(bias.data).subspan(part * width, width)};
}

LayerNorm layer_norm(const TensorMap& tensors, const std::string& name, float epsilon) {
  return {tensors[name + ".weight"].data, tensors[name + ".bias"].data, epsilon};
}

/// int8 scales of a block's layers, from calibration: the largest magnitude seen is 127 steps.
float int8_scale(const Model& model, const std::string& layer) {
  return model.calibration().int8_input_max.at(layer) / 127;
}

/// Column `half` (0 position, 1 content) of a table (rows, 2 width), repeated.
std::vector<float> half_of_table(const Tensor& table, std::size_t half, std::size_t repeats) {
  const std::size_t width = table.shape[1] / 2;
  std::vector<float> rows;
  for (std::size_t i = 0; i < repeats; ++i)
    for (std::size_t r = 0; r < table.shape[0]; ++r) {
      const auto first = table.data.begin() + static_cast<std::ptrdiff_t>((2 * r + half) * width);
      rows.insert(rows.end(), first, first + static_cast<std::ptrdiff_t>(width));
    }
  return rows;
}

std::span<const float> view(const Buffer& buffer, std::size_t count) { return {buffer.floats(), count}; }

/// The first numbers of `ranking` in descending order of score; among equal ones the lower comes first, and a
/// score that is not a number after all numbers.
void rank(const float* scores, std::span<std::uint32_t> ranking) {
  const auto score = [&](std::uint32_t i) { return std::isnan(scores[i]) ? -HUGE_VALF : scores[i]; };
  for (std::uint32_t i = 0; i < ranking.size(); ++i) ranking[i] = i;
  std::sort(ranking.begin(), ranking.end(), [&](std::uint32_t a, std::uint32_t b) {
    return score(a) != score(b) ? score(a) > score(b) : a < b;
  });
}

float softplus(float x) { return x > 30 ? x : std::log1p(std::exp(x)); }

}  // namespace

NumberPlan number_plan(Precision precision, const CpuFeatures& cpu) {
  const Element half = cpu.avx512_bf16 ? Element::bf16 : Element::f32;
  switch (precision) {
    case Precision::f32:
      break;
    case Precision::bf16:
      return {Element::bf16, Element::bf16, Element::bf16};
    case Precision::int8:
      return {Element::s8, half, half};
  }
  return {};
}

// Probe.

void Probe::start() { stages_.clear(); }
void Probe::stage(const char* name, std::span<const float> values) {
  if (keep_stages) stages_[name].assign(values.begin(), values.end());
}
void Probe::stage(const char* name, std::size_t index, std::span<const float> values) {
  if (keep_stages) stages_[name + std::to_string(index)].assign(values.begin(), values.end());
}
void Probe::append(const char* name, std::span<const float> values) {
  if (keep_stages) stages_[name].insert(stages_[name].end(), values.begin(), values.end());
}
void Probe::input(const std::string& layer, const void* values, std::size_t count) {
  if (!watch_inputs) return;
  float& most = input_max_[layer];
  for (std::size_t i = 0; i < count; ++i)
    most = std::max(most, std::abs(static_cast<const float*>(values)[i]));
}
std::span<const float> Probe::stage_values(const std::string& name) const {
  const auto found = stages_.find(name);
  return found == stages_.end() ? std::span<const float>() : std::span<const float>(found->second);
}

// Encoder.

EncoderBuffers::EncoderBuffers(std::size_t dim, const NumberPlan& plan)
    : normed(kTokens * dim * size_of(plan.encoder)),
      q(kTokens * dim * size_of(plan.attention)),
      k(kTokens * dim * size_of(plan.attention)),
      v(kTokens * dim * size_of(plan.attention)),
      attended(kTokens * dim * sizeof(float)),
      attended_for_projection(plan.encoder == Element::s8 ? kTokens * dim : 0),
      hidden(kTokens * 4 * dim * size_of(plan.encoder)) {}

EncoderBlock::EncoderBlock(OneDnnContext& context, const Model& model, const std::string& prefix,
                           const NumberPlan& plan)
    : context_(&context),
      plan_(plan),
      names_{prefix + "attn.qkv", prefix + "attn.proj", prefix + "mlp.fc1", prefix + "mlp.fc2"},
      scales_(input_scales(model, names_, plan)),
      norm1_(layer_norm(model.tensors(), prefix + "norm1", kEncoderEpsilon)),
      norm2_(layer_norm(model.tensors(), prefix + "norm2", kEncoderEpsilon)),
      q_(make_projection(context, model, 0)),
      k_(make_projection(context, model, 1)),
      v_(make_projection(context, model, 2)),
      proj_(context, whole(model.tensors(), names_.proj),
            {plan.encoder, Element::f32, Epilogue::add, scales_.proj}, names_.proj),
      fc1_(context, whole(model.tensors(), names_.fc1),
           {plan.encoder, plan.encoder, Epilogue::gelu, scales_.fc1, scales_.fc2}, names_.fc1),
      fc2_(context, whole(model.tensors(), names_.fc2),
           {plan.encoder, Element::f32, Epilogue::add, scales_.fc2}, names_.fc2) {}

EncoderBlock::InputScales EncoderBlock::input_scales(const Model& model, const LayerNames& names,
                                                     const NumberPlan& plan) {
  if (plan.encoder != Element::s8) return {};
  return {int8_scale(model, names.qkv), int8_scale(model, names.proj), int8_scale(model, names.fc1),
          int8_scale(model, names.fc2)};
}

Linear EncoderBlock::make_projection(OneDnnContext& context, const Model& model, std::size_t part) const {
  const LinearWeights weights =
      third(model.tensors()[names_.qkv + ".weight"], model.tensors()[names_.qkv + ".bias"], part);
  return {context, weights, {plan_.encoder, plan_.attention, Epilogue::none, scales_.qkv}, names_.qkv};
}

void EncoderBlock::prepare(std::size_t tokens) {
  for (Linear* linear : {&q_, &k_, &v_, &proj_, &fc1_, &fc2_}) linear->prepare(tokens);
}

void EncoderBlock::run(float* x, std::size_t tokens, Attention& attention, EncoderBuffers& buffers,
                       Probe& probe) {
  attend(x, tokens, attention, buffers, probe);
  transform(x, tokens, buffers, probe);
}

void EncoderBlock::normalise(const float* x, const LayerNorm& norm, float scale, std::size_t tokens,
                             Buffer& out) const {
  const RowSink sink = {out.data(), plan_.encoder, 1 / scale};
  context_->norm(
      {x, norm.gain.size(), norm.gain.data(), norm.bias.data(), norm.epsilon, nullptr, sink, nullptr, {}},
      tokens);
}

void EncoderBlock::attend(float* x, std::size_t tokens, Attention& attention, EncoderBuffers& b,
                          Probe& probe) {
  const std::size_t dim = norm1_.gain.size();
  normalise(x, norm1_, scales_.qkv, tokens, b.normed);
  probe.input(names_.qkv, b.normed.data(), tokens * dim);
  q_.run(b.normed.data(), b.q.data(), tokens);
  k_.run(b.normed.data(), b.k.data(), tokens);
  v_.run(b.normed.data(), b.v.data(), tokens);
  attention.run(b.q.data(), b.k.data(), b.v.data(), b.attended.data(), {1, tokens, tokens});
  probe.input(names_.proj, b.attended.data(), tokens * dim);
  const void* attended = b.attended.data();
  if (plan_.encoder == Element::s8) {
    context_->store({b.attended.floats(),
                     dim,
                     nullptr,
                     {b.attended_for_projection.data(), Element::s8, 1 / scales_.proj}},
                    tokens);
    attended = b.attended_for_projection.data();
  }
  proj_.run(attended, x, tokens);
}

void EncoderBlock::transform(float* x, std::size_t tokens, EncoderBuffers& b, Probe& probe) {
  normalise(x, norm2_, scales_.fc1, tokens, b.normed);
  probe.input(names_.fc1, b.normed.data(), tokens * fc1_.inputs());
  fc1_.run(b.normed.data(), b.hidden.data(), tokens);
  probe.input(names_.fc2, b.hidden.data(), tokens * fc2_.inputs());
  fc2_.run(b.hidden.data(), x, tokens);
}

OneDnnEncoder::OneDnnEncoder(OneDnnContext& context, const Model& model, const NumberPlan& plan)
    : context_(&context),
      plan_(plan),
      config_(model.config()),
      normalisation_(model.normalisation()),
      dim_(config_.dim),
      position_code_(reference::position_code(dim_, config_.token_grid()).data),
      embed_(context, whole(model.tensors(), "encoder.patch_embed.proj"),
             {Element::f32, Element::f32, Epilogue::add}, "encoder.patch_embed.proj"),
      norm_(layer_norm(model.tensors(), "encoder.norm", kEncoderEpsilon)),
      attention_(context, dim_, model.config().heads, plan.attention,
                 plan.encoder == Element::s8 ? Element::f32 : plan.encoder),
      buffers_(dim_, plan),
      tokens_(config_.token_grid().size() * config_.token_numbers() * sizeof(float)),
      residual_(kTokens * dim_ * sizeof(float)),
      final_float_(kTokens * dim_ * sizeof(float)),
      final_(kTokens * dim_ * size_of(plan.decoder)) {
  for (std::size_t i = 0; i < model.config().depth; ++i)
    blocks_.emplace_back(context, model, fmt::format("encoder.blocks.{}.", i), plan);
}

void OneDnnEncoder::prepare(std::size_t tokens) {
  embed_.prepare(tokens);
  for (EncoderBlock& block : blocks_) block.prepare(tokens);
  attention_.prepare({1, tokens, tokens});
}

/// Normalised channels of the tokens that are there, and their position codes where the embedding will be added. Gives their
/// number.
std::size_t OneDnnEncoder::gather_tokens(std::span<const float> x, LinkSet links,
                                         const Background* background) {
  if (background == nullptr) background = nearest_background(normalisation_.backgrounds, x, links).background;
  const std::size_t count = config_.token_count(links);
  write_tokens(config_, normalisation_, background, x, links, {tokens_.floats(), count * embed_.inputs()});
  float* residual = residual_.floats();
  for (std::size_t i = 0; i < config_.token_grid().size(); ++i) {
    if (!config_.has_token(i, links)) continue;
    std::memcpy(residual, &position_code_[i * dim_], dim_ * sizeof(float));
    residual += dim_;
  }
  return count;
}

const void* OneDnnEncoder::run(std::span<const float> x, LinkSet links, const Background* background,
                               Probe& probe) {
  assert(x.size() == kChannels * kTokens && links.any());
  const std::size_t tokens = gather_tokens(x, links, background);
  embed_.run(tokens_.data(), residual_.data(), tokens);
  probe.stage("embed", view(residual_, tokens * dim_));
  for (std::size_t i = 0; i < blocks_.size(); ++i) {
    blocks_[i].run(residual_.floats(), tokens, attention_, buffers_, probe);
    probe.stage("block", i, view(residual_, tokens * dim_));
  }
  context_->norm({residual_.floats(),
                  dim_,
                  norm_.gain.data(),
                  norm_.bias.data(),
                  norm_.epsilon,
                  final_float_.floats(),
                  {final_.data(), plan_.decoder},
                  nullptr,
                  {}},
                 tokens);
  probe.stage("encoder", view(final_float_, tokens * dim_));
  return final_.data();
}

// Decoder.

QueryState::QueryState(std::size_t rows, std::size_t width, Element element)
    : values(rows * width * sizeof(float)),
      typed(rows * width * size_of(element)),
      with_position(rows * width * size_of(element)) {}

DecoderLayer::Buffers::Buffers(std::size_t rows, std::size_t width, std::size_t ffn, Element element)
    : q(rows * width * size_of(element)),
      k(rows * width * size_of(element)),
      v(rows * width * size_of(element)),
      attended(rows * width * size_of(element)),
      hidden(rows * ffn * size_of(element)) {}

DecoderLayer::DecoderLayer(OneDnnContext& context, const TensorMap& tensors, const std::string& prefix,
                           Element element)
    : context_(&context),
      element_(element),
      norm1_(layer_norm(tensors, prefix + "norm1", kDecoderEpsilon)),
      norm2_(layer_norm(tensors, prefix + "norm2", kDecoderEpsilon)),
      norm3_(layer_norm(tensors, prefix + "norm3", kDecoderEpsilon)),
      self_(context, tensors, prefix + "self_attn", element),
      cross_(context, tensors, prefix + "cross_attn", element),
      linear1_(context, whole(tensors, prefix + "linear1"), {element, element, Epilogue::relu},
               prefix + "linear1"),
      linear2_(context, whole(tensors, prefix + "linear2"), {element, Element::f32, Epilogue::add},
               prefix + "linear2"),
      memory_keys_(kTokens * norm1_.gain.size() * size_of(element)),
      memory_values_(kTokens * norm1_.gain.size() * size_of(element)) {}

DecoderLayer::Projections::Projections(OneDnnContext& context, const TensorMap& tensors,
                                       const std::string& name, Element element)
    : q(make(context, tensors, name, 0, element)),
      k(make(context, tensors, name, 1, element)),
      v(make(context, tensors, name, 2, element)),
      out(context, whole(tensors, name + ".out_proj"), {element, Element::f32, Epilogue::add},
          name + ".out_proj") {}

Linear DecoderLayer::Projections::make(OneDnnContext& context, const TensorMap& tensors,
                                       const std::string& name, std::size_t part, Element element) {
  return {context,
          third(tensors[name + ".in_proj_weight"], tensors[name + ".in_proj_bias"], part),
          {element, element},
          name};
}

void DecoderLayer::prepare(const AttentionShape& shape) {
  const std::size_t rows = shape.batch * shape.queries;
  for (Linear* linear :
       {&self_.q, &self_.k, &self_.v, &self_.out, &cross_.q, &cross_.out, &linear1_, &linear2_})
    linear->prepare(rows);
  cross_.k.prepare(shape.keys);
  cross_.v.prepare(shape.keys);
}

void DecoderLayer::project_memory(const void* memory, std::size_t keys) {
  cross_.k.run(memory, memory_keys_.data(), keys);
  cross_.v.run(memory, memory_values_.data(), keys);
}

void DecoderLayer::run(QueryState& state, const float* position, const AttentionShape& shape,
                       Attention& attention, Buffers& b) {
  const std::size_t rows = shape.batch * shape.queries;
  self_.q.run(state.with_position.data(), b.q.data(), rows);
  self_.k.run(state.with_position.data(), b.k.data(), rows);
  self_.v.run(state.typed.data(), b.v.data(), rows);
  attention.run(b.q.data(), b.k.data(), b.v.data(), b.attended.data(),
                {shape.batch, shape.queries, shape.queries});
  self_.out.run(b.attended.data(), state.values.data(), rows);
  normalise(norm1_, state, position, rows);

  cross_.q.run(state.with_position.data(), b.q.data(), rows);
  attention.run(b.q.data(), memory_keys_.data(), memory_values_.data(), b.attended.data(),
                {1, rows, shape.keys});
  cross_.out.run(b.attended.data(), state.values.data(), rows);
  normalise(norm2_, state, position, rows);

  linear1_.run(state.typed.data(), b.hidden.data(), rows);
  linear2_.run(b.hidden.data(), state.values.data(), rows);
  normalise(norm3_, state, position, rows);
}

void DecoderLayer::normalise(const LayerNorm& norm, QueryState& state, const float* position,
                             std::size_t rows) const {
  context_->norm({state.values.floats(),
                  norm.gain.size(),
                  norm.gain.data(),
                  norm.bias.data(),
                  norm.epsilon,
                  state.values.floats(),
                  {state.typed.data(), element_},
                  position,
                  {state.with_position.data(), element_}},
                 rows);
}

Mlp::Mlp(OneDnnContext& context, const TensorMap& tensors, const std::string& prefix,
         std::span<const int> layers, Element element, std::size_t rows) {
  for (const int layer : layers) {
    const bool last = layer == layers.back();
    const std::string name = prefix + std::to_string(layer);
    layers_.emplace_back(
        context, whole(tensors, name),
        LinearPlan{element, last ? Element::f32 : element, last ? Epilogue::none : Epilogue::relu}, name);
  }
  const std::size_t hidden_bytes = rows * layers_.front().outputs() * size_of(element);
  ping_ = Buffer(hidden_bytes);
  pong_ = Buffer(hidden_bytes);
}

void Mlp::prepare(std::size_t rows) {
  for (Linear& layer : layers_) layer.prepare(rows);
}

void Mlp::run(const void* x, float* y, std::size_t rows) {
  for (std::size_t i = 0; i + 1 < layers_.size(); ++i) {
    layers_[i].run(x, ping_.data(), rows);
    x = ping_.data();
    std::swap(ping_, pong_);
  }
  layers_.back().run(x, y, rows);
}

OneDnnDecoder::OneDnnDecoder(OneDnnContext& context, const Model& model, const NumberPlan& plan,
                             std::size_t refined_queries)
    : context_(&context),
      config_(model.config()),
      refined_queries_(refined_queries == 0 ? config_.queries : std::min(refined_queries, config_.queries)),
      element_(plan.decoder),
      project_(context, whole(model.tensors(), "proj"), {element_, Element::f32}, "proj"),
      attention_(context, config_.decoder_dim, config_.decoder_heads, element_, element_),
      state_(config_.queries, config_.decoder_dim, element_),
      refine_state_(most_people() * kJoints, config_.decoder_dim, element_),
      buffers_(config_.queries, config_.decoder_dim, config_.ffn, element_),
      refine_buffers_(most_people() * kJoints, config_.decoder_dim, config_.ffn, element_),
      ranking_(kTokens) {
  make_decoder(model.tensors());
  if (config_.refine_layers > 0) make_refinement(model.tensors());
  make_buffers();
}

void OneDnnDecoder::make_decoder(const TensorMap& tensors) {
  query_position_ = half_of_table(tensors["query_embedding.weight"], 0, 1);
  query_content_ = half_of_table(tensors["query_embedding.weight"], 1, 1);
  if (config_.query_conditioning)
    query_proposal_.emplace_back(*context_, whole(tensors, "query_proposal"), LinearPlan{}, "query_proposal");
  for (std::size_t i = 0; i <= config_.decoder_layers; ++i) {
    const std::string cls = fmt::format("cls_branches.{}", i), kpt = fmt::format("kpt_branches.{}.", i);
    class_heads_.emplace_back(*context_, whole(tensors, cls), LinearPlan{}, cls);
    const bool proposals = i == config_.decoder_layers;
    pose_heads_.emplace_back(*context_, tensors, kpt, kPoseHeadLayers, element_,
                             proposals ? kTokens : config_.queries);
  }
  for (std::size_t i = 0; i < config_.decoder_layers; ++i)
    layers_.emplace_back(*context_, tensors, fmt::format("decoder.layers.{}.", i), element_);
}

void OneDnnDecoder::make_refinement(const TensorMap& tensors) {
  refine_position_ = half_of_table(tensors["refine_query_embedding.weight"], 0, most_people());
  refine_content_ = half_of_table(tensors["refine_query_embedding.weight"], 1, 1);
  for (std::size_t j = 0; j < config_.refine_layers; ++j) {
    refine_layers_.emplace_back(*context_, tensors, fmt::format("refine_decoder.layers.{}.", j), element_);
    refine_heads_.emplace_back(*context_, tensors, fmt::format("refine_kpt_branches.{}.", j),
                               kRefineHeadLayers, element_, most_people() * kJoints);
  }
  if (config_.identity_conditioning)
    identity_.emplace_back(*context_, whole(tensors, "refine_identity"), LinearPlan{element_, Element::f32},
                           "refine_identity");
  if (config_.joint_sigma)
    sigma_.emplace_back(*context_, whole(tensors, "sigma_branch"), LinearPlan{}, "sigma_branch");
}

void OneDnnDecoder::make_buffers() {
  const auto floats = [](std::size_t count) { return Buffer(count * sizeof(float)); };
  const std::size_t queries = config_.queries, joints = most_people() * kJoints;
  memory_ = floats(kTokens * config_.decoder_dim);
  memory_typed_ = Buffer(kTokens * config_.decoder_dim * size_of(element_));
  proposal_logits_ = floats(kTokens);
  proposal_poses_ = floats(kTokens * kPoseWidth);
  logits_ = floats(queries);
  poses_ = floats(queries * kPoseWidth);
  offsets_ = floats(std::max(queries * kPoseWidth, joints * 3));
  identities_ = floats(queries * config_.decoder_dim);
  raw_sigma_ = floats(joints);
  sigma_m_ = floats(queries * kJoints);
}

void OneDnnDecoder::prepare(std::size_t tokens) {
  const std::size_t queries = queries_for(tokens), people = people_for(tokens), joints = people * kJoints;
  project_.prepare(tokens);
  for (std::size_t i = 0; i <= config_.decoder_layers; ++i) {
    const std::size_t rows = i == config_.decoder_layers ? tokens : queries;
    class_heads_[i].prepare(rows);
    pose_heads_[i].prepare(rows);
  }
  for (Linear& proposal : query_proposal_) proposal.prepare(queries);
  for (DecoderLayer& layer : layers_) layer.prepare({1, queries, tokens});
  attention_.prepare({1, queries, queries});
  attention_.prepare({1, queries, tokens});
  if (refine_layers_.empty()) return;
  for (DecoderLayer& layer : refine_layers_) layer.prepare({people, kJoints, tokens});
  for (Mlp& head : refine_heads_) head.prepare(joints);
  for (Linear& identity : identity_) identity.prepare(given_for(tokens));
  for (Linear& sigma : sigma_) sigma.prepare(joints);
  attention_.prepare({people, kJoints, kJoints});
  attention_.prepare({1, joints, tokens});
}

NetworkOutput OneDnnDecoder::run(const void* features, std::size_t tokens, Probe& probe) {
  project(features, tokens, probe);
  propose(tokens, probe);
  decode(tokens, probe);
  const std::size_t given = given_for(tokens);
  select(queries_for(tokens), given);
  if (!refine_layers_.empty()) refine(tokens, probe);
  return {view(logits_, given), view(poses_, given * kPoseWidth),
          view(sigma_m_, config_.joint_sigma ? given * kJoints : 0)};
}

void OneDnnDecoder::project(const void* features, std::size_t tokens, Probe& probe) {
  const std::size_t width = config_.decoder_dim;
  project_.run(features, memory_.data(), tokens);
  context_->store({memory_.floats(), width, nullptr, {memory_typed_.data(), element_}}, tokens);
  for (DecoderLayer& layer : layers_) layer.project_memory(memory_typed_.data(), tokens);
  for (DecoderLayer& layer : refine_layers_) layer.project_memory(memory_typed_.data(), tokens);
  probe.stage("memory", view(memory_, tokens * width));
}

/// Every row of the memory proposes a pose; the best Q are where the queries start.
void OneDnnDecoder::propose(std::size_t tokens, Probe& probe) {
  class_heads_.back().run(memory_.data(), proposal_logits_.data(), tokens);
  pose_heads_.back().run(memory_typed_.data(), proposal_poses_.floats(), tokens);
  const std::span<std::uint32_t> rows = std::span(ranking_).first(tokens);
  rank(proposal_logits_.floats(), rows);
  for (std::size_t q = 0; q < queries_for(tokens); ++q) {
    std::memcpy(poses_.floats() + q * kPoseWidth, proposal_poses_.floats() + rows[q] * kPoseWidth,
                kPoseWidth * sizeof(float));
    const float row = static_cast<float>(rows[q]);
    probe.append("topk", {&row, 1});
  }
  probe.stage("enc_cls", view(proposal_logits_, tokens));
  probe.stage("enc_kpt", view(proposal_poses_, tokens * kPoseWidth));
}

void OneDnnDecoder::start_state(QueryState& state, const std::vector<float>& position,
                                std::size_t rows) const {
  const std::size_t width = config_.decoder_dim;
  context_->store({state.values.floats(), width, nullptr, {state.typed.data(), element_}}, rows);
  context_->store({state.values.floats(), width, position.data(), {state.with_position.data(), element_}},
                  rows);
}

/// Content of each query, plus the pose that it begins from.
void OneDnnDecoder::start_queries(std::size_t queries) {
  const std::size_t numbers = queries * config_.decoder_dim;
  std::memcpy(state_.values.data(), query_content_.data(), numbers * sizeof(float));
  for (Linear& proposal : query_proposal_) {
    proposal.run(poses_.data(), identities_.data(), queries);
    for (std::size_t i = 0; i < numbers; ++i) state_.values.floats()[i] += identities_.floats()[i];
  }
  start_state(state_, query_position_, queries);
}

void OneDnnDecoder::decode(std::size_t tokens, Probe& probe) {
  const std::size_t queries = queries_for(tokens), width = config_.decoder_dim;
  start_queries(queries);
  for (std::size_t i = 0; i < layers_.size(); ++i) {
    layers_[i].run(state_, query_position_.data(), {1, queries, tokens}, attention_, buffers_);
    class_heads_[i].run(state_.values.data(), logits_.data(), queries);
    pose_heads_[i].run(state_.typed.data(), offsets_.floats(), queries);
    for (std::size_t n = 0; n < queries * kPoseWidth; ++n) poses_.floats()[n] += offsets_.floats()[n];
    probe.stage("layer", i, view(state_.values, queries * width));
    probe.append("cls", view(logits_, queries));
    probe.append("kpt", view(poses_, queries * kPoseWidth));
  }
}

/// Keeps the queries with the highest logits, in their order: logits, poses, and the state that tells persons
/// apart.
void OneDnnDecoder::select(std::size_t queries, std::size_t given) {
  if (given == queries) return;
  const std::span<std::uint32_t> chosen = std::span(ranking_).first(queries);
  rank(logits_.floats(), chosen);
  std::sort(chosen.begin(), chosen.begin() + static_cast<std::ptrdiff_t>(given));
  const auto keep = [&](const Buffer& rows, std::size_t row_bytes) {
    char* bytes = static_cast<char*>(rows.data());
    for (std::size_t i = 0; i < given; ++i)
      std::memmove(bytes + i * row_bytes, bytes + chosen[i] * row_bytes, row_bytes);
  };
  keep(logits_, sizeof(float));
  keep(poses_, kPoseWidth * sizeof(float));
  keep(state_.typed, config_.decoder_dim * size_of(element_));
}

/// Content of each joint's query, plus what says whose joint it is.
void OneDnnDecoder::start_refinement(std::size_t given, std::size_t people) {
  const std::size_t width = config_.decoder_dim;
  for (Linear& identity : identity_) identity.run(state_.typed.data(), identities_.data(), given);
  for (std::size_t p = 0; p < people; ++p)
    for (std::size_t j = 0; j < kJoints; ++j) {
      float* row = refine_state_.values.floats() + (p * kJoints + j) * width;
      for (std::size_t c = 0; c < width; ++c)
        row[c] =
            refine_content_[j * width + c] + (identity_.empty() ? 0.f : identities_.floats()[p * width + c]);
    }
  start_state(refine_state_, refine_position_, people * kJoints);
}

void OneDnnDecoder::refine(std::size_t tokens, Probe& probe) {
  const std::size_t given = given_for(tokens), people = people_for(tokens), joints = people * kJoints;
  start_refinement(given, people);
  for (std::size_t j = 0; j < refine_layers_.size(); ++j) {
    refine_layers_[j].run(refine_state_, refine_position_.data(), {people, kJoints, tokens}, attention_,
                          refine_buffers_);
    refine_heads_[j].run(refine_state_.typed.data(), offsets_.floats(), joints);
    for (std::size_t q = 0; q < given; ++q)
      for (std::size_t n = 0; n < kPoseWidth; ++n)
        poses_.floats()[q * kPoseWidth + n] += offsets_.floats()[(q % people) * kPoseWidth + n];
    probe.append("refined", view(poses_, given * kPoseWidth));
  }
  for (Linear& sigma : sigma_) {
    sigma.run(refine_state_.values.data(), raw_sigma_.data(), joints);
    for (std::size_t n = 0; n < given * kJoints; ++n)
      sigma_m_.floats()[n] = kLeastSigma_m + softplus(raw_sigma_.floats()[n % joints]);
  }
}

}  // namespace csipose
