// train/network.h - encoder, predictor and pose decoder as functions of named tensors, for a batch and with gradients.
//
// The same network as model/reference.h, which computes one window in plain loops and is this code's oracle; tensor
// names are those of docs/weights.md. Sizes: B windows of a batch, N tokens (at most 180), D width of the encoder, E of
// the decoder, Q queries, J joints (14).
#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "train/parameters.h"
#include "train/torch.h"

namespace csipose::train {

/// How the arithmetic is done. Operands of Linears and attention may be bfloat16; parameters, residual stream, LayerNorm,
/// softmax and losses are float32 in any case.
struct Numerics {
  at::ScalarType matmul = at::kFloat;
  double dropout = 0;  ///< of the decoder, while it is trained; drawn from libtorch's generator
};

// ---- encoder ----

struct EncoderShape {
  std::size_t dim = 0, depth = 0, heads = 0;
  TokenGrid grid{};
};

/// (tokens, width) position code of model/reference.h.
at::Tensor position_code(std::size_t width, const TokenGrid& grid = {});
/// Windows (B, 60, 20, 9) to tokens (B, 180, 60), row t * 9 + l.
at::Tensor tokens_of(const at::Tensor& windows);
/// Tokens (B, 180, 60) to flat ones (B, 300, 36): the window as an image, channel by l * 20 + t, in patches of 6 by 6, row by
/// row as the numbers within each. Patches lie across links, not across amplitude and phase. source: what the WiFi-JEPA paper
/// compares its tokens with, after Person-in-WiFi 3D
at::Tensor flat_tokens_of(const at::Tensor& tokens);

/// Tokens (B, as the grid, NetworkConfig::token_numbers()), normalised, to (B, N, D). `visible` (B, N), int64: the tokens to
/// encode, in that order; the others are never computed. Undefined: all. `blocks`, when given, takes the embedding and what each block gives.
/// Weights `prefix` + "patch_embed.proj.weight" and so on.
at::Tensor encode(const Parameters& weights, const std::string& prefix, const EncoderShape& shape,
                  const at::Tensor& tokens, const at::Tensor& visible, const Numerics& numerics,
                  std::vector<at::Tensor>* blocks = nullptr);

/// x with a `share` of its numbers 0, which ones by libtorch's generator, and the others larger so that the mean stays.
/// Sixteen drawn bits decide on each; at::dropout draws 64, and its drawing was a twentieth of a step.
at::Tensor dropout(const at::Tensor& x, double share);

/// rows of x (B, N, C) that idx (B, n) names: (B, n, C).
at::Tensor gather_rows(const at::Tensor& x, const at::Tensor& idx);

// ---- predictor ----

/// Context z (B, n, D) of the tokens `context` (B, n) to a prediction (B, m, D) for the tokens `target` (B, m).
/// Weights predictor.*.
at::Tensor predict(const Parameters& weights, const PredictorShape& shape, const at::Tensor& z,
                   const at::Tensor& context, const at::Tensor& target, const Numerics& numerics);
/// What is predicted: features (B, 180, D) of the target encoder, each row to mean 0 and variance 1, rows `target`.
at::Tensor normalised_target(const at::Tensor& features, const at::Tensor& target);

/// Moves the tensors `target` + NAME towards `online` + NAME: target = momentum target + (1 - momentum) online.
void follow(const Parameters& targets, const std::string& target, const Parameters& onlines,
            const std::string& online, double momentum);

// ---- decoder ----

struct DecoderShape {
  std::size_t heads = 0, decoder_layers = 0, refine_layers = 0;
  bool identity_conditioning = true;
  bool query_conditioning = false;
};

struct Decoded {
  at::Tensor memory;   ///< (B, N, E)
  at::Tensor enc_cls;  ///< (B, N, 1) class logit of each token as a proposal
  at::Tensor enc_kpt;  ///< (B, N, 42) its pose
  at::Tensor topk;     ///< (B, Q) best proposals, best first; among equal ones the lower token first
  std::vector<at::Tensor> hidden;  ///< [layers] of (B, Q, E)
  std::vector<at::Tensor> cls;     ///< [layers] of (B, Q, 1)
  std::vector<at::Tensor> kpt;     ///< [layers] of (B, Q, 42)
};
/// Memory (B, N, E) to poses. With fewer than Q tokens the first N queries run. `share` of the samples were encoded: each
/// token stands for 1 / share of them that would propose nearly the same, so query q begins from the proposal of rank
/// floor(share q), as it would with all samples; with query conditioning it sees its pose.
Decoded decode(const Parameters& weights, const DecoderShape& shape, const at::Tensor& memory,
               const Numerics& numerics, double share = 1);

struct Refined {
  std::vector<at::Tensor> pose;  ///< [refine layers] of (B, P, 42)
  at::Tensor state;  ///< (B, P, 14, E) after the last refinement layer; P is 1 without identity conditioning
};
/// Refines the poses of the queries `chosen` (B, P) of each window. Without identity conditioning the correction is the
/// same for all of a window's people and is computed once.
Refined refine(const Parameters& weights, const DecoderShape& shape, const Decoded& decoded,
               const at::Tensor& chosen, const Numerics& numerics);
/// Expected error of each joint, metres: (B, P, 14) from the refinement's state.
at::Tensor joint_sigma_m(const Parameters& weights, const at::Tensor& state);

/// Linear 'proj': what the decoder sees of the encoder's output.
at::Tensor memory_of(const Parameters& weights, const at::Tensor& features, const Numerics& numerics);

// ---- the whole network ----

EncoderShape encoder_shape(const NetworkConfig& config);
DecoderShape decoder_shape(const NetworkConfig& config);

struct Poses {
  at::Tensor logits;  ///< (B, Q)
  at::Tensor joints;  ///< (B, Q, 42) after the last refinement
};
/// Every query's answer, as the daemon's engines give it. `visible` as for encode().
Poses infer(const Parameters& weights, const NetworkConfig& config, const at::Tensor& tokens,
            const at::Tensor& visible, const Numerics& numerics);

}  // namespace csipose::train
