// model/onnx_graph.h - a network as an ONNX file, for runtimes that are not ours.
//
// Opset 17, IR 8. What the graph computes is model/reference.cpp with all nine links present, normalisation
// included; a value is named after the layer that makes it ("encoder.norm", "decoder.layers.0.norm3"), a
// constant after its tensor in docs/weights.md (turned: MatMul wants (in, out)).
// source: github.com/onnx/onnx, docs/IR.md and docs/Operators.md
#pragma once

#include <string>

namespace csipose {

class Model;

/// The file's bytes.
///   input    csi float32 [1][60][20][9], as Window::x, not normalised
///   outputs  scores float32 [1][Q], sigmoid of the class logit, not calibrated;
///            poses float32 [1][Q][14][3], refined, label frame, metres; order of queries as in NetworkOutput
///   metadata what the weights file says of itself, and its digest (docs/weights.md)
///   errors   SetupError (bad_data): the weights would pass the 2 GiB that one ONNX file may hold, or take flat tokens
///   cost     three times the weights in memory
std::string onnx_file(const Model& model);

}  // namespace csipose
