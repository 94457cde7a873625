#include "model/reference.h"

#include <fmt/format.h>

#include <algorithm>
#include <cassert>
#include <cmath>
#include <numbers>
#include <numeric>

namespace csipose::reference {
namespace {

constexpr double kEncoderEpsilon = 1e-6;  // LayerNorm of facebookresearch/ijepa
constexpr double kDecoderEpsilon = 1e-5;  // LayerNorm of torch
constexpr double kLeastSigma_m = 1e-3;    // no joint is known to better than a millimetre

double dot(const float* a, const float* b, std::size_t count) {
  double sum = 0;
  for (std::size_t i = 0; i < count; ++i) sum += static_cast<double>(a[i]) * static_cast<double>(b[i]);
  return sum;
}

Matrix columns(const Matrix& x, std::size_t first, std::size_t count) {
  Matrix part(x.rows, count);
  for (std::size_t r = 0; r < x.rows; ++r)
    for (std::size_t c = 0; c < count; ++c) part.at(r, c) = x.at(r, first + c);
  return part;
}

void softmax_in_place(std::vector<double>& scores) {
  const double largest = *std::max_element(scores.begin(), scores.end());
  double sum = 0;
  for (double& score : scores) sum += score = std::exp(score - largest);
  for (double& score : scores) score /= sum;
}

/// One head of attention, into the columns [first, first + width) of `out`.
void attend(const Matrix& q, const Matrix& k, const Matrix& v, std::size_t first, std::size_t width,
            Matrix& out) {
  const double scale = 1 / std::sqrt(static_cast<double>(width));
  std::vector<double> weight(k.rows);
  for (std::size_t i = 0; i < q.rows; ++i) {
    for (std::size_t j = 0; j < k.rows; ++j)
      weight[j] = scale * dot(&q.data[i * q.cols + first], &k.data[j * k.cols + first], width);
    softmax_in_place(weight);
    for (std::size_t c = first; c < first + width; ++c) {
      double sum = 0;
      for (std::size_t j = 0; j < k.rows; ++j) sum += weight[j] * static_cast<double>(v.at(j, c));
      out.at(i, c) = static_cast<float>(sum);
    }
  }
}

/// torch.nn.MultiheadAttention: packed projection, rows q | k | v.
Matrix multi_head(const TensorMap& weights, const std::string& name, std::size_t heads, const Matrix& q_input,
                  const Matrix& k_input, const Matrix& v_input) {
  const Tensor &weight = weights[name + ".in_proj_weight"], &bias = weights[name + ".in_proj_bias"];
  const std::size_t width = weight.shape[1];
  const Matrix q = linear_rows(q_input, weight, bias, 0, width);
  const Matrix k = linear_rows(k_input, weight, bias, width, width);
  const Matrix v = linear_rows(v_input, weight, bias, 2 * width, width);
  return linear(attention(q, k, v, heads), weights, name + ".out_proj");
}

Matrix encoder_block(const TensorMap& weights, const std::string& name, std::size_t heads, Matrix x) {
  const std::size_t width = x.cols;
  const Matrix normed = layer_norm(x, weights, name + "norm1", kEncoderEpsilon);
  const Matrix qkv = linear(normed, weights, name + "attn.qkv");
  const Matrix mixed =
      attention(columns(qkv, 0, width), columns(qkv, width, width), columns(qkv, 2 * width, width), heads);
  x = add(std::move(x), linear(mixed, weights, name + "attn.proj"));
  const Matrix hidden =
      gelu(linear(layer_norm(x, weights, name + "norm2", kEncoderEpsilon), weights, name + "mlp.fc1"));
  return add(std::move(x), linear(hidden, weights, name + "mlp.fc2"));
}

/// Post-LN layer of decoder and refinement: among the queries, against the memory, feed-forward.
Matrix decoder_layer(const TensorMap& weights, const std::string& name, std::size_t heads, Matrix q,
                     const Matrix& position, const Matrix& memory) {
  const Matrix with_position = add(q, position);
  const Matrix among = multi_head(weights, name + "self_attn", heads, with_position, with_position, q);
  q = layer_norm(add(std::move(q), among), weights, name + "norm1", kDecoderEpsilon);
  const Matrix seen = multi_head(weights, name + "cross_attn", heads, add(q, position), memory, memory);
  q = layer_norm(add(std::move(q), seen), weights, name + "norm2", kDecoderEpsilon);
  const Matrix hidden = relu(linear(q, weights, name + "linear1"));
  return layer_norm(add(std::move(q), linear(hidden, weights, name + "linear2")), weights, name + "norm3",
                    kDecoderEpsilon);
}

/// Linear, ReLU, Linear, .., Linear: layers `name`.0, .2, .. up to `last`.
Matrix mlp(const TensorMap& weights, const std::string& name, int last, Matrix x) {
  for (int i = 0; i < last; i += 2) x = relu(linear(x, weights, fmt::format("{}.{}", name, i)));
  return linear(x, weights, fmt::format("{}.{}", name, last));
}
Matrix keypoint_head(const TensorMap& weights, std::size_t i, const Matrix& x) {
  return mlp(weights, fmt::format("kpt_branches.{}", i), 6, x);
}
Matrix class_head(const TensorMap& weights, std::size_t i, const Matrix& x) {
  return linear(x, weights, fmt::format("cls_branches.{}", i));
}

/// A learned table (rows, 2 E): the first half of a row is position, the second half content.
struct QueryTable {
  Matrix position, content;
};
QueryTable query_table(const TensorMap& weights, const std::string& name, std::size_t rows) {
  const Tensor& table = weights[name];
  Matrix both(table.shape[0], table.shape[1]);
  both.data = table.data;
  std::vector<std::size_t> first(rows);
  std::iota(first.begin(), first.end(), std::size_t{0});
  both = gather(both, first);
  return {columns(both, 0, both.cols / 2), columns(both, both.cols / 2, both.cols / 2)};
}

void propose(const TensorMap& weights, const DecoderShape& shape, const Matrix& memory, DecoderOutput& out) {
  out.enc_cls = class_head(weights, shape.decoder_layers, memory);
  out.enc_kpt = keypoint_head(weights, shape.decoder_layers, memory);
  const std::size_t queries = std::min(weights["query_embedding.weight"].shape[0], memory.rows);
  out.topk = top_rows(out.enc_cls, queries);
}

void run_decoder_layers(const TensorMap& weights, const DecoderShape& shape, const Matrix& memory,
                        DecoderOutput& out) {
  const QueryTable table = query_table(weights, "query_embedding.weight", out.topk.size());
  Matrix q = table.content;
  Matrix pose = gather(out.enc_kpt, out.topk);
  if (shape.query_conditioning) q = add(linear(pose, weights, "query_proposal"), q);
  for (std::size_t i = 0; i < shape.decoder_layers; ++i) {
    q = decoder_layer(weights, fmt::format("decoder.layers.{}.", i), shape.heads, std::move(q),
                      table.position, memory);
    pose = add(keypoint_head(weights, i, q), pose);
    out.hidden.push_back(q);
    out.cls.push_back(class_head(weights, i, q));
    out.kpt.push_back(pose);
  }
}

struct Refinement {
  std::vector<Matrix> offsets;  ///< [refine_layers] of [14][3], each layer's own
  Matrix state;                 ///< [14][E] after the last layer
};
/// The 14 joint queries of one person against the window's memory. `identity` [1][E] is added to each joint's
/// content.
Refinement refine(const TensorMap& weights, const DecoderShape& shape, const Matrix& memory,
                  const Matrix* identity) {
  const QueryTable table = query_table(weights, "refine_query_embedding.weight", kJoints);
  Matrix g = table.content;
  if (identity != nullptr)
    for (std::size_t j = 0; j < g.rows; ++j)
      for (std::size_t c = 0; c < g.cols; ++c) g.at(j, c) += identity->at(0, c);
  Refinement out;
  for (std::size_t j = 0; j < shape.refine_layers; ++j) {
    g = decoder_layer(weights, fmt::format("refine_decoder.layers.{}.", j), shape.heads, std::move(g),
                      table.position, memory);
    out.offsets.push_back(mlp(weights, fmt::format("refine_kpt_branches.{}", j), 4, g));
  }
  out.state = std::move(g);
  return out;
}

double softplus(double x) { return x > 30 ? x : std::log1p(std::exp(x)); }

void write_sigma(const TensorMap& weights, const Matrix& state, std::size_t query, Matrix& sigma_m) {
  const Matrix raw = linear(state, weights, "sigma_branch");
  for (std::size_t j = 0; j < kJoints; ++j)
    sigma_m.at(query, j) = static_cast<float>(kLeastSigma_m + softplus(static_cast<double>(raw.at(j, 0))));
}

void run_refinement(const TensorMap& weights, const DecoderShape& shape, const Matrix& memory,
                    DecoderOutput& out) {
  if (shape.refine_layers == 0) return;
  const std::size_t queries = out.topk.size();
  out.refined.assign(shape.refine_layers, Matrix(queries, kPoseWidth));
  if (shape.joint_sigma) out.sigma_m = Matrix(queries, kJoints);
  const Matrix identity =
      shape.identity_conditioning ? linear(out.hidden.back(), weights, "refine_identity") : Matrix();
  Refinement refinement;
  for (std::size_t q = 0; q < queries; ++q) {
    const Matrix person = shape.identity_conditioning ? gather(identity, std::array{q}) : Matrix();
    if (shape.identity_conditioning || q == 0)
      refinement = refine(weights, shape, memory, shape.identity_conditioning ? &person : nullptr);
    for (std::size_t i = 0; i < kPoseWidth; ++i) {
      float joint = out.kpt.back().at(q, i);
      for (std::size_t j = 0; j < shape.refine_layers; ++j)
        out.refined[j].at(q, i) = joint += refinement.offsets[j].data[i];
    }
    if (shape.joint_sigma) write_sigma(weights, refinement.state, q, out.sigma_m);
  }
}

}  // namespace

Matrix linear_rows(const Matrix& x, const Tensor& weight, const Tensor& bias, std::size_t first,
                   std::size_t count) {
  const std::size_t width = weight.data.size() / weight.shape[0];
  assert(x.cols == width && first + count <= weight.shape[0] && bias.data.size() == weight.shape[0]);
  Matrix y(x.rows, count);
  for (std::size_t r = 0; r < x.rows; ++r)
    for (std::size_t o = 0; o < count; ++o)
      y.at(r, o) = static_cast<float>(dot(&x.data[r * width], &weight.data[(first + o) * width], width) +
                                      static_cast<double>(bias.data[first + o]));
  return y;
}

Matrix linear(const Matrix& x, const TensorMap& weights, const std::string& name) {
  const Tensor& weight = weights[name + ".weight"];
  return linear_rows(x, weight, weights[name + ".bias"], 0, weight.shape[0]);
}

Matrix layer_norm(const Matrix& x, const TensorMap& weights, const std::string& name, double epsilon) {
  const Tensor &gain = weights[name + ".weight"], &bias = weights[name + ".bias"];
  assert(gain.data.size() == x.cols && bias.data.size() == x.cols);
  Matrix y(x.rows, x.cols);
  const double count = static_cast<double>(x.cols);
  for (std::size_t r = 0; r < x.rows; ++r) {
    double mean = 0, variance = 0;
    for (std::size_t c = 0; c < x.cols; ++c) mean += static_cast<double>(x.at(r, c)) / count;
    for (std::size_t c = 0; c < x.cols; ++c)
      variance += std::pow(static_cast<double>(x.at(r, c)) - mean, 2) / count;
    for (std::size_t c = 0; c < x.cols; ++c)
      y.at(r, c) = static_cast<float>((static_cast<double>(x.at(r, c)) - mean) /
                                          std::sqrt(variance + epsilon) * static_cast<double>(gain.data[c]) +
                                      static_cast<double>(bias.data[c]));
  }
  return y;
}

Matrix gelu(Matrix x) {
  for (float& value : x.data) {
    const double v = static_cast<double>(value);
    value = static_cast<float>(v / 2 * (1 + std::erf(v / std::numbers::sqrt2)));
  }
  return x;
}

Matrix relu(Matrix x) {
  for (float& value : x.data) value = std::max(value, 0.f);
  return x;
}

Matrix add(Matrix a, const Matrix& b) {
  assert(a.rows == b.rows && a.cols == b.cols);
  for (std::size_t i = 0; i < a.data.size(); ++i) a.data[i] += b.data[i];
  return a;
}

Matrix gather(const Matrix& x, std::span<const std::size_t> rows) {
  Matrix part(rows.size(), x.cols);
  for (std::size_t r = 0; r < rows.size(); ++r)
    for (std::size_t c = 0; c < x.cols; ++c) part.at(r, c) = x.at(rows[r], c);
  return part;
}

Matrix attention(const Matrix& q, const Matrix& k, const Matrix& v, std::size_t heads) {
  assert(q.cols == k.cols && q.cols == v.cols && k.rows == v.rows && q.cols % heads == 0);
  Matrix out(q.rows, q.cols);
  const std::size_t width = q.cols / heads;
  for (std::size_t h = 0; h < heads; ++h) attend(q, k, v, h * width, width, out);
  return out;
}

Matrix position_code(std::size_t width, const TokenGrid& grid) {
  assert(width % 4 == 0);
  Matrix code(grid.size(), width);
  const std::size_t quarter = width / 4;
  for (std::size_t token = 0; token < grid.size(); ++token) {
    const auto column = static_cast<double>(token % grid.columns),
               row = static_cast<double>(token / grid.columns);
    for (std::size_t k = 0; k < quarter; ++k) {
      const double frequency = std::pow(10000., -static_cast<double>(k) / static_cast<double>(quarter));
      code.at(token, k) = static_cast<float>(std::sin(column * frequency));
      code.at(token, quarter + k) = static_cast<float>(std::cos(column * frequency));
      code.at(token, 2 * quarter + k) = static_cast<float>(std::sin(row * frequency));
      code.at(token, 3 * quarter + k) = static_cast<float>(std::cos(row * frequency));
    }
  }
  return code;
}

Matrix tokens_of(std::span<const float> x) {
  assert(x.size() == kChannels * kTokens);
  Matrix tokens(kTokens, kChannels);
  for (std::size_t token = 0; token < kTokens; ++token)
    for (std::size_t c = 0; c < kChannels; ++c) tokens.at(token, c) = x[c * kTokens + token];
  return tokens;
}

EncoderOutput encode(const TensorMap& weights, const std::string& prefix, const EncoderShape& shape,
                     const Matrix& tokens, std::span<const std::size_t> visible) {
  EncoderOutput out;
  out.embed = add(linear(tokens, weights, prefix + "patch_embed.proj"), position_code(shape.dim, shape.grid));
  Matrix x = gather(out.embed, visible);
  for (std::size_t i = 0; i < shape.depth; ++i) {
    x = encoder_block(weights, fmt::format("{}blocks.{}.", prefix, i), shape.heads, std::move(x));
    out.blocks.push_back(x);
  }
  out.tokens = layer_norm(x, weights, prefix + "norm", kEncoderEpsilon);
  return out;
}

std::vector<std::size_t> top_rows(const Matrix& scores, std::size_t count) {
  assert(scores.cols == 1 && count <= scores.rows);
  std::vector<std::size_t> rows(scores.rows);
  std::iota(rows.begin(), rows.end(), std::size_t{0});
  const auto rank = [&](std::size_t r) { return std::isnan(scores.data[r]) ? -HUGE_VALF : scores.data[r]; };
  std::stable_sort(rows.begin(), rows.end(), [&](std::size_t a, std::size_t b) { return rank(a) > rank(b); });
  rows.resize(count);
  return rows;
}

DecoderOutput decode(const TensorMap& weights, const DecoderShape& shape, const Matrix& memory) {
  DecoderOutput out;
  propose(weights, shape, memory, out);
  run_decoder_layers(weights, shape, memory, out);
  run_refinement(weights, shape, memory, out);
  return out;
}

}  // namespace csipose::reference
