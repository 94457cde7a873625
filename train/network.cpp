#include "train/network.h"

#include <fmt/format.h>

#include <cmath>
#include <cstring>

#include "model/reference.h"
#include "proto/shape.h"

namespace csipose::train {
namespace {

constexpr double kEncoderEpsilon = 1e-6;  // LayerNorm of facebookresearch/ijepa
constexpr double kTorchEpsilon = 1e-5;    // LayerNorm of torch: decoder, and the target of pre-training
constexpr double kLeastSigma_m = 1e-3;    // no joint is known to better than a millimetre

std::int64_t signed_size(std::size_t n) { return static_cast<std::int64_t>(n); }

/// x W^T + b with operands of the chosen type; gives that type.
at::Tensor linear(const at::Tensor& x, const at::Tensor& weight, const at::Tensor& bias,
                  const Numerics& numerics) {
  return at::linear(x.to(numerics.matmul), weight.to(numerics.matmul), bias.to(numerics.matmul));
}
at::Tensor linear(const Parameters& weights, const std::string& name, const at::Tensor& x,
                  const Numerics& numerics) {
  return linear(x, weights[name + ".weight"], weights[name + ".bias"], numerics);
}

at::Tensor layer_norm(const Parameters& weights, const std::string& name, const at::Tensor& x,
                      double epsilon) {
  return at::layer_norm(x, {x.size(-1)}, weights[name + ".weight"], weights[name + ".bias"], epsilon);
}

at::Tensor dropped(const at::Tensor& x, const Numerics& numerics) {
  return numerics.dropout > 0 ? dropout(x, numerics.dropout) : x;
}

/// (B, N, C) to (B, heads, N, C / heads).
at::Tensor split_heads(const at::Tensor& x, std::size_t heads) {
  return x.view({x.size(0), x.size(1), signed_size(heads), -1}).transpose(1, 2);
}

/// softmax(q k^T / sqrt(width of a head)) v, heads side by side again: (B, N, C).
at::Tensor attention(const at::Tensor& q, const at::Tensor& k, const at::Tensor& v,
                     const Numerics& numerics) {
  const double scale = 1 / std::sqrt(static_cast<double>(q.size(-1)));
  const at::Tensor scores = at::matmul(q * scale, k.transpose(-2, -1));
  const at::Tensor share = dropped(at::softmax(scores, -1, at::kFloat), numerics).to(numerics.matmul);
  return at::matmul(share, v).transpose(1, 2).flatten(2);
}

/// Pre-LN block of encoder and predictor.
at::Tensor block(const Parameters& weights, const std::string& name, std::size_t heads, at::Tensor x,
                 const Numerics& numerics) {
  const at::Tensor qkv =
      linear(weights, name + "attn.qkv", layer_norm(weights, name + "norm1", x, kEncoderEpsilon), numerics);
  const std::vector<at::Tensor> parts = qkv.chunk(3, -1);
  const at::Tensor mixed = attention(split_heads(parts[0], heads), split_heads(parts[1], heads),
                                     split_heads(parts[2], heads), numerics);
  x = x + linear(weights, name + "attn.proj", mixed, numerics);
  const at::Tensor hidden = at::gelu(
      linear(weights, name + "mlp.fc1", layer_norm(weights, name + "norm2", x, kEncoderEpsilon), numerics));
  return x + linear(weights, name + "mlp.fc2", hidden, numerics);
}

/// The rows [first, first + count) of torch.nn.MultiheadAttention's packed projection.
at::Tensor in_projection(const Parameters& weights, const std::string& name, const at::Tensor& x, int first,
                         int count, const Numerics& numerics) {
  const at::Tensor &weight = weights[name + ".in_proj_weight"], &bias = weights[name + ".in_proj_bias"];
  const std::int64_t width = weight.size(1);
  return linear(x, weight.narrow(0, first * width, count * width),
                bias.narrow(0, first * width, count * width), numerics);
}

at::Tensor multi_head(const Parameters& weights, const std::string& name, std::size_t heads,
                      const at::Tensor& q, const at::Tensor& k, const at::Tensor& v,
                      const Numerics& numerics) {
  const at::Tensor mixed =
      attention(split_heads(q, heads), split_heads(k, heads), split_heads(v, heads), numerics);
  return linear(weights, name + ".out_proj", mixed, numerics);
}

/// Among the queries (G, n, E): groups do not see each other.
at::Tensor self_attention(const Parameters& weights, const std::string& name, std::size_t heads,
                          const at::Tensor& q, const at::Tensor& position, const Numerics& numerics) {
  const at::Tensor qk = in_projection(weights, name, q + position, 0, 2, numerics);
  const std::vector<at::Tensor> parts = qk.chunk(2, -1);
  return multi_head(weights, name, heads, parts[0], parts[1], in_projection(weights, name, q, 2, 1, numerics),
                    numerics);
}

/// Queries (B, n, E) against the memory of their window; keys and values are projected once for all of them.
at::Tensor cross_attention(const Parameters& weights, const std::string& name, std::size_t heads,
                           const at::Tensor& q, const at::Tensor& memory, const Numerics& numerics) {
  const std::vector<at::Tensor> kv = in_projection(weights, name, memory, 1, 2, numerics).chunk(2, -1);
  return multi_head(weights, name, heads, in_projection(weights, name, q, 0, 1, numerics), kv[0], kv[1],
                    numerics);
}

/// Post-LN layer of decoder and refinement. Queries q (B, G, n, E) attend to each other within a group, then all of a
/// window's to its memory (B, N, E).
at::Tensor decoder_layer(const Parameters& weights, const std::string& name, std::size_t heads, at::Tensor q,
                         const at::Tensor& position, const at::Tensor& memory, const Numerics& numerics) {
  const at::IntArrayRef all = q.sizes();
  const std::vector<std::int64_t> shape(all.begin(), all.end());
  const at::Tensor grouped = q.flatten(0, 1);
  const at::Tensor among = self_attention(weights, name + "self_attn", heads, grouped, position, numerics);
  q = layer_norm(weights, name + "norm1", grouped + dropped(among, numerics), kTorchEpsilon).view(shape);
  const at::Tensor asking = (q + position).flatten(1, 2);
  const at::Tensor seen = cross_attention(weights, name + "cross_attn", heads, asking, memory, numerics);
  q = layer_norm(weights, name + "norm2", q + dropped(seen, numerics).view(shape), kTorchEpsilon);
  const at::Tensor hidden = dropped(at::relu(linear(weights, name + "linear1", q, numerics)), numerics);
  const at::Tensor fed = dropped(linear(weights, name + "linear2", hidden, numerics), numerics);
  return layer_norm(weights, name + "norm3", q + fed, kTorchEpsilon);
}

/// Linear, ReLU, .., Linear: layers `name`.0, .2, .. up to `last`. Positions are metres: the last layer is float32.
at::Tensor mlp(const Parameters& weights, const std::string& name, int last, at::Tensor x,
               const Numerics& numerics) {
  for (int i = 0; i < last; i += 2) x = at::relu(linear(weights, fmt::format("{}.{}", name, i), x, numerics));
  return linear(weights, fmt::format("{}.{}", name, last), x.to(at::kFloat), {at::kFloat, 0});
}
at::Tensor keypoint_head(const Parameters& weights, std::size_t i, const at::Tensor& x,
                         const Numerics& numerics) {
  return mlp(weights, fmt::format("kpt_branches.{}", i), 6, x, numerics);
}
/// One column: too little work for bfloat16 to matter, and near scores must not become equal.
at::Tensor class_head(const Parameters& weights, std::size_t i, const at::Tensor& x) {
  return linear(weights, fmt::format("cls_branches.{}", i), x.to(at::kFloat), {at::kFloat, 0});
}

void propose(const Parameters& weights, const DecoderShape& shape, const Numerics& numerics, double share,
             Decoded& out) {
  out.enc_cls = class_head(weights, shape.decoder_layers, out.memory);
  out.enc_kpt = keypoint_head(weights, shape.decoder_layers, out.memory, numerics);
  const auto all = static_cast<std::int64_t>(static_cast<double>(out.memory.size(1)) / share);
  const std::int64_t queries = std::min(weights["query_embedding.weight"].size(0), all);
  const at::Tensor order =
      std::get<1>(out.enc_cls.detach().squeeze(-1).sort(/*stable=*/true, -1, /*descending=*/true));
  const at::Tensor ranks = (at::arange(queries, at::kDouble) * share).floor().to(at::kLong);
  out.topk = order.index_select(1, ranks.to(order.device()));
}

}  // namespace

at::Tensor position_code(std::size_t width, const TokenGrid& grid) {
  const reference::Matrix code = reference::position_code(width, grid);
  at::Tensor tensor = at::empty({signed_size(code.rows), signed_size(code.cols)}, at::kFloat);
  std::memcpy(tensor.data_ptr<float>(), code.data.data(), code.data.size() * sizeof(float));
  return tensor;
}

at::Tensor tokens_of(const at::Tensor& windows) { return windows.flatten(2).transpose(1, 2).contiguous(); }

at::Tensor flat_tokens_of(const at::Tensor& tokens) {
  constexpr auto kRows = static_cast<std::int64_t>(kFlatGrid.rows),
                 kColumns = static_cast<std::int64_t>(kFlatGrid.columns),
                 kSide = static_cast<std::int64_t>(kPatch);
  const std::int64_t windows = tokens.size(0);
  const at::Tensor image = tokens.view({windows, kSamples, kLinks, kChannels}).permute({0, 3, 2, 1});
  const at::Tensor patches = image.reshape({windows, kRows, kSide, kColumns, kSide}).permute({0, 1, 3, 2, 4});
  return patches.reshape({windows, kRows * kColumns, kSide * kSide});
}

at::Tensor dropout(const at::Tensor& x, double share) {
  constexpr double kChances = 65536;
  const std::int64_t left_out = std::llround(share * kChances), numbers = x.numel();
  const at::Tensor drawn = at::empty({(numbers + 3) / 4}, x.options().dtype(at::kLong))
                               .random_(INT64_MIN, c10::optional<std::int64_t>());
  const at::Tensor quarters = drawn.view(at::kShort).narrow(0, 0, numbers).view(x.sizes());
  const double kept = 1 - static_cast<double>(left_out) / kChances;
  return x * (quarters >= left_out - 32768).to(x.scalar_type()).mul_(1 / kept);
}

at::Tensor gather_rows(const at::Tensor& x, const at::Tensor& idx) {
  return x.gather(1, idx.unsqueeze(-1).expand({idx.size(0), idx.size(1), x.size(2)}));
}

at::Tensor encode(const Parameters& weights, const std::string& prefix, const EncoderShape& shape,
                  const at::Tensor& tokens, const at::Tensor& visible, const Numerics& numerics,
                  std::vector<at::Tensor>* blocks) {
  const at::Tensor code = position_code(shape.dim, shape.grid).to(tokens.device());
  const at::Tensor seen = visible.defined() ? gather_rows(tokens, visible) : tokens;
  const at::Tensor places = visible.defined() ? code.index({visible}) : code;
  const std::string embed = prefix + "patch_embed.proj";
  at::Tensor x =
      linear(seen, weights[embed + ".weight"].flatten(1), weights[embed + ".bias"], numerics) + places;
  if (blocks != nullptr) blocks->push_back(x);
  for (std::size_t i = 0; i < shape.depth; ++i) {
    x = block(weights, fmt::format("{}blocks.{}.", prefix, i), shape.heads, x, numerics);
    if (blocks != nullptr) blocks->push_back(x);
  }
  return layer_norm(weights, prefix + "norm", x, kEncoderEpsilon);
}

at::Tensor predict(const Parameters& weights, const PredictorShape& shape, const at::Tensor& z,
                   const at::Tensor& context, const at::Tensor& target, const Numerics& numerics) {
  const at::Tensor code = position_code(shape.dim, shape.grid).to(z.device());
  const at::Tensor known = linear(weights, "predictor.predictor_embed", z, numerics) + code.index({context});
  const at::Tensor asked = weights["predictor.mask_token"] + code.index({target});
  at::Tensor x = at::cat({known, asked}, 1);
  for (std::size_t i = 0; i < shape.depth; ++i)
    x = block(weights, fmt::format("predictor.predictor_blocks.{}.", i), shape.heads, x, numerics);
  x = layer_norm(weights, "predictor.predictor_norm", x.narrow(1, context.size(1), target.size(1)),
                 kEncoderEpsilon);
  return linear(weights, "predictor.predictor_proj", x, numerics).to(at::kFloat);
}

at::Tensor normalised_target(const at::Tensor& features, const at::Tensor& target) {
  return at::layer_norm(gather_rows(features, target), {features.size(-1)}, {}, {}, kTorchEpsilon);
}

void follow(const Parameters& targets, const std::string& target, const Parameters& onlines,
            const std::string& online, double momentum) {
  const at::NoGradGuard no_gradients;
  for (const auto& [name, tensor] : targets.under(target))
    tensor.lerp_(onlines[online + name.substr(target.size())], 1 - momentum);
}

at::Tensor memory_of(const Parameters& weights, const at::Tensor& features, const Numerics& numerics) {
  return linear(weights, "proj", features, numerics).to(at::kFloat);
}

Decoded decode(const Parameters& weights, const DecoderShape& shape, const at::Tensor& memory,
               const Numerics& numerics, double share) {
  Decoded out;
  out.memory = memory;
  propose(weights, shape, numerics, share, out);
  const std::int64_t queries = out.topk.size(1);
  const std::vector<at::Tensor> table = weights["query_embedding.weight"].narrow(0, 0, queries).chunk(2, 1);
  const at::Tensor position = table[0];
  at::Tensor q = table[1].expand({memory.size(0), 1, queries, memory.size(2)});
  at::Tensor pose = gather_rows(out.enc_kpt.detach(), out.topk);
  if (shape.query_conditioning) q = q + linear(weights, "query_proposal", pose, {at::kFloat, 0}).unsqueeze(1);
  for (std::size_t i = 0; i < shape.decoder_layers; ++i) {
    q = decoder_layer(weights, fmt::format("decoder.layers.{}.", i), shape.heads, q, position, memory,
                      numerics);
    out.hidden.push_back(q.squeeze(1));
    out.cls.push_back(class_head(weights, i, out.hidden.back()));
    out.kpt.push_back(keypoint_head(weights, i, out.hidden.back(), numerics) + pose);
    pose = out.kpt.back().detach();
  }
  return out;
}

Refined refine(const Parameters& weights, const DecoderShape& shape, const Decoded& decoded,
               const at::Tensor& chosen, const Numerics& numerics) {
  const std::vector<at::Tensor> table = weights["refine_query_embedding.weight"].chunk(2, 1);
  const at::Tensor position = table[0];
  const std::int64_t windows = decoded.memory.size(0), width = decoded.memory.size(2);
  at::Tensor g = table[1].expand({windows, 1, signed_size(kJoints), width});
  if (shape.identity_conditioning) {
    const at::Tensor who = gather_rows(decoded.hidden.back(), chosen);
    g = g + linear(weights, "refine_identity", who, numerics).unsqueeze(2);
  }
  at::Tensor pose = gather_rows(decoded.kpt.back().detach(), chosen);
  Refined out;
  for (std::size_t j = 0; j < shape.refine_layers; ++j) {
    g = decoder_layer(weights, fmt::format("refine_decoder.layers.{}.", j), shape.heads, g, position,
                      decoded.memory, numerics);
    const at::Tensor moved =
        mlp(weights, fmt::format("refine_kpt_branches.{}", j), 4, g, numerics).flatten(2);
    out.pose.push_back(moved + pose);
    pose = out.pose.back().detach();
  }
  out.state = g;
  return out;
}

at::Tensor joint_sigma_m(const Parameters& weights, const at::Tensor& state) {
  const at::Tensor raw = linear(weights, "sigma_branch", state.to(at::kFloat), {at::kFloat, 0}).squeeze(-1);
  return at::softplus(raw) + kLeastSigma_m;
}

EncoderShape encoder_shape(const NetworkConfig& config) {
  return {config.dim, config.depth, config.heads, config.token_grid()};
}
DecoderShape decoder_shape(const NetworkConfig& config) {
  return {config.decoder_heads, config.decoder_layers, config.refine_layers, config.identity_conditioning,
          config.query_conditioning};
}

Poses infer(const Parameters& weights, const NetworkConfig& config, const at::Tensor& tokens,
            const at::Tensor& visible, const Numerics& numerics) {
  const at::NoGradGuard no_gradients;
  const at::Tensor features = encode(weights, "encoder.", encoder_shape(config), tokens, visible, numerics);
  const DecoderShape shape = decoder_shape(config);
  const Decoded decoded = decode(weights, shape, memory_of(weights, features, numerics), numerics);
  const at::Tensor logits = decoded.cls.back().squeeze(-1);
  if (shape.refine_layers == 0) return {logits, decoded.kpt.back()};
  const at::Tensor all = at::arange(logits.size(1), decoded.topk.options()).expand(logits.sizes());
  return {logits, refine(weights, shape, decoded, all, numerics).pose.back()};
}

}  // namespace csipose::train
