"""Writes the encoder of a weights file as an ONNX graph: input csi (60, 20, 9), output encoder (180, D), float32.

GELU stands as Div, Erf, Add, Mul, Mul, which ONNX Runtime fuses. IR 8, opset 17.
usage: make_onnx.py WEIGHTS.safetensors GRAPH.onnx
"""
import sys

import numpy as np
import onnx
from onnx import TensorProto, helper, numpy_helper

import network_file


class Graph:
    def __init__(self):
        self.nodes, self.constants = [], []

    def constant(self, value):
        name = f"c{len(self.constants)}"
        self.constants.append(numpy_helper.from_array(np.ascontiguousarray(value), name))
        return name

    def add(self, operator, *inputs, **attributes):
        output = f"n{len(self.nodes)}"
        self.nodes.append(helper.make_node(operator, list(inputs), [output], **attributes))
        return output

    def linear(self, x, weight, bias):
        return self.add("Add", self.add("MatMul", x, self.constant(weight.T)), self.constant(bias))

    def norm(self, x, tensors, name):
        return self.add("LayerNormalization", x, self.constant(tensors[name + ".weight"]),
                        self.constant(tensors[name + ".bias"]), epsilon=1e-6)

    def gelu(self, x):
        inner = self.add("Erf", self.add("Div", x, self.constant(np.float32(np.sqrt(2)))))
        twice = self.add("Mul", x, self.add("Add", inner, self.constant(np.float32(1))))
        return self.add("Mul", twice, self.constant(np.float32(0.5)))

    def heads(self, x, count, width, order):
        shape = self.constant(np.array([1, 180, count, width], np.int64))
        return self.add("Transpose", self.add("Reshape", x, shape), perm=order)


def block(graph, x, tensors, prefix, heads, dim):
    normed = graph.norm(x, tensors, prefix + "norm1")
    weight, bias = tensors[prefix + "attn.qkv.weight"], tensors[prefix + "attn.qkv.bias"]
    q, k, v = (graph.linear(normed, weight[i * dim:(i + 1) * dim], bias[i * dim:(i + 1) * dim]) for i in range(3))
    width = dim // heads
    q, v = (graph.heads(it, heads, width, [0, 2, 1, 3]) for it in (q, v))
    scores = graph.add("MatMul", q, graph.heads(k, heads, width, [0, 2, 3, 1]))
    scaled = graph.add("Mul", scores, graph.constant(np.float32(width ** -0.5)))
    mixed = graph.add("MatMul", graph.add("Softmax", scaled, axis=-1), v)
    joined = graph.add("Reshape", graph.add("Transpose", mixed, perm=[0, 2, 1, 3]),
                       graph.constant(np.array([1, 180, dim], np.int64)))
    x = graph.add("Add", x, graph.linear(joined, tensors[prefix + "attn.proj.weight"], tensors[prefix + "attn.proj.bias"]))
    hidden = graph.linear(graph.norm(x, tensors, prefix + "norm2"), tensors[prefix + "mlp.fc1.weight"],
                          tensors[prefix + "mlp.fc1.bias"])
    return graph.add("Add", x, graph.linear(graph.gelu(hidden), tensors[prefix + "mlp.fc2.weight"],
                                            tensors[prefix + "mlp.fc2.bias"]))


def encoder(tensors, config):
    graph, dim = Graph(), config["dim"]
    rows = graph.add("Reshape", "csi", graph.constant(np.array([1, 60, 180], np.int64)))
    tokens = graph.add("Transpose", rows, perm=[0, 2, 1])
    weight = tensors["encoder.patch_embed.proj.weight"].reshape(dim, 60)
    x = graph.linear(tokens, weight, tensors["encoder.patch_embed.proj.bias"])
    x = graph.add("Add", x, graph.constant(network_file.position_code(dim)[None]))
    for i in range(config["depth"]):
        x = block(graph, x, tensors, f"encoder.blocks.{i}.", config["heads"], dim)
    last = graph.norm(x, tensors, "encoder.norm")
    graph.nodes.append(helper.make_node("Identity", [last], ["encoder"]))
    return helper.make_graph(graph.nodes, "encoder", [helper.make_tensor_value_info("csi", TensorProto.FLOAT, [60, 20, 9])],
                             [helper.make_tensor_value_info("encoder", TensorProto.FLOAT, [1, 180, dim])], graph.constants)


def main():
    tensors, config = network_file.read(sys.argv[1])
    model = helper.make_model(encoder(tensors, config), opset_imports=[helper.make_opsetid("", 17)], ir_version=8)
    onnx.checker.check_model(model)
    onnx.save(model, sys.argv[2])


main()
