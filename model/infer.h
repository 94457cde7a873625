// model/infer.h - an engine over a file of windows: what it answers, and what each of its stages held, as
// NumPy arrays.
#pragma once

#include <cstddef>
#include <filesystem>
#include <string>
#include <vector>

#include "model/config.h"
#include "model/engine.h"

namespace csipose {

/// Every stage that a network of this configuration has, in the order of computation: "embed", "block0" ..,
/// "encoder", "memory", "enc_cls", "enc_kpt", "topk", "layer0" .., "cls", "kpt", "refined", "sigma".
std::vector<std::string> stage_names(const NetworkConfig& config);
/// Shape of one window's stage when `links` are encoded: N = 20 tokens a link, Q = min(queries, N).
///   embed, blockI, encoder [N][D]; memory [N][E]; enc_cls [N][1]; enc_kpt [N][42]; topk [Q], rows of the
///   memory; layerI [Q][E]; cls [layers][Q][1]; kpt [layers][Q][42]; refined [refine layers][Q][14][3]; sigma
///   [Q][14]
std::vector<std::size_t> stage_shape(const NetworkConfig& config, LinkSet links, const std::string& stage);

/// The windows of a NumPy file, float32 (60, 20, 9) or (n, 60, 20, 9), each as Window::x. Throws SetupError: another
/// shape, or a number that is not finite.
std::vector<std::vector<float>> read_window_file(const std::filesystem::path& path);

struct InferJob {
  std::filesystem::path tensors;    ///< .npy, float32, (60, 20, 9) or (n, 60, 20, 9), not normalised
  std::filesystem::path folder;     ///< made when it is not there
  LinkSet links = LinkSet().set();  ///< the others are left out of the sequence
  std::vector<std::string> stages;
};

/// Writes logits.npy (n, Q), scores.npy (n, Q), poses.npy (n, Q, 14, 3) in the label frame, sigma_m.npy (n,
/// Q, 14) when the model has that head, STAGE.npy (n, ...) for each stage asked for, and infer.json with what
/// made them. Returns the number of windows. Throws SetupError: an unknown stage, one that the engine does
/// not keep, no link, windows of another shape or with numbers that are not finite, folders that cannot be
/// written.
std::size_t infer_file(Engine& engine, const Model& model, const InferJob& job);

}  // namespace csipose
