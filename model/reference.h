// model/reference.h - the network in plain loops, to be read beside its description; the oracle of every
// other maker.
//
// Nothing here is clever or quick. Sums run in double, what passes from one operation to the next is float32.
// Weights come by name from a TensorMap, so that each piece can also be run on weights of another origin.
//
// Shapes: N tokens of a sequence, D and E widths, H heads, Q queries, J joints (14). One window at a time.
#pragma once

#include <cstddef>
#include <span>
#include <string>
#include <vector>

#include "model/config.h"
#include "model/tensor.h"
#include "proto/window.h"

namespace csipose::reference {

/// Rows of one width, C order.
struct Matrix {
  Matrix() = default;
  Matrix(std::size_t row_count, std::size_t column_count)
      : rows(row_count), cols(column_count), data(row_count * column_count) {}
  float& at(std::size_t r, std::size_t c) { return data[r * cols + c]; }
  float at(std::size_t r, std::size_t c) const { return data[r * cols + c]; }

  std::size_t rows = 0, cols = 0;
  std::vector<float> data;
};

// Operations.

/// x W^T + b for the rows [first, first + count) of a Linear's weight (out, in) and bias (out).
Matrix linear_rows(const Matrix& x, const Tensor& weight, const Tensor& bias, std::size_t first,
                   std::size_t count);
/// The whole Linear `name`.weight, `name`.bias.
Matrix linear(const Matrix& x, const TensorMap& weights, const std::string& name);
/// Each row to mean 0 and variance 1 (biased), then `name`.weight and `name`.bias.
Matrix layer_norm(const Matrix& x, const TensorMap& weights, const std::string& name, double epsilon);
/// x Phi(x) with the exact Phi (erf), not its tanh approximation.
Matrix gelu(Matrix x);
Matrix relu(Matrix x);
Matrix add(Matrix a, const Matrix& b);
/// The rows of x that `rows` names, in that order.
Matrix gather(const Matrix& x, std::span<const std::size_t> rows);
/// softmax(q k^T / sqrt(width of a head)) v for each of `heads` slices of the columns.
Matrix attention(const Matrix& q, const Matrix& k, const Matrix& v, std::size_t heads);

// Encoder.

/// [tokens][width]; a token's row is (sin, cos of its column; sin, cos of its row) with frequencies 10000^(-k / (width / 4));
/// its column is the link, its row the time.
/// source: facebookresearch/ijepa, src/models/vision_transformer.py, with the link in the place of the first
/// axis
Matrix position_code(std::size_t width, const TokenGrid& grid = {});
/// Tensor [60][20][9] to tokens [180][60], row t * 9 + l.
Matrix tokens_of(std::span<const float> x);

struct EncoderShape {
  std::size_t dim, depth, heads;
  TokenGrid grid{};
};
struct EncoderOutput {
  Matrix embed;                ///< [180][D] (as the grid), position code added
  std::vector<Matrix> blocks;  ///< [depth] of [N][D]
  Matrix tokens;               ///< [N][D] after the last LayerNorm
};
/// Weights `prefix` + "patch_embed.proj.weight" and so on. Tokens not in `visible` are left out after the
/// embedding.
EncoderOutput encode(const TensorMap& weights, const std::string& prefix, const EncoderShape& shape,
                     const Matrix& tokens, std::span<const std::size_t> visible);

// Decoder.

struct DecoderShape {
  std::size_t heads, decoder_layers, refine_layers;
  bool identity_conditioning;
  bool joint_sigma;
  bool query_conditioning = false;
};
struct DecoderOutput {
  Matrix enc_cls;                 ///< [N][1] class logit of each memory row as a proposal
  Matrix enc_kpt;                 ///< [N][42] its pose
  std::vector<std::size_t> topk;  ///< [Q] rows of the memory, best first
  std::vector<Matrix> hidden;     ///< [decoder_layers] of [Q][E]
  std::vector<Matrix> cls;        ///< [decoder_layers] of [Q][1]
  std::vector<Matrix> kpt;        ///< [decoder_layers] of [Q][42]
  std::vector<Matrix> refined;    ///< [refine_layers] of [Q][42]
  Matrix sigma_m;                 ///< [Q][14] expected error before calibration; empty without that head
};
/// The `count` best rows of scores [N][1], best first; among equal ones the lower row first. A score that is
/// not a number comes after all numbers.
std::vector<std::size_t> top_rows(const Matrix& scores, std::size_t count);
/// Memory [N][E] to poses. With fewer than Q rows of memory the N first queries run, for a query needs a
/// proposal, and with query conditioning sees its pose. Without identity conditioning the refinement is the same for all
/// queries and is done once.
DecoderOutput decode(const TensorMap& weights, const DecoderShape& shape, const Matrix& memory);

}  // namespace csipose::reference
