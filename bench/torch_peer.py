"""Times libtorch on the encoder of a weights file, traced and frozen, so that Python is not in the way.

usage: torch_peer.py WEIGHTS.safetensors PRECISION THREADS RUNS WINDOW.f32 EXPECTED.f32
bf16: weights, activations and residual stream in bf16, the way that libtorch 1.13 is quickest.
"""
import sys

import numpy as np
import torch
import torch.nn.functional as F

import network_file


class Encoder(torch.nn.Module):
    def __init__(self, tensors, config, dtype):
        super().__init__()
        self.depth, self.heads, self.dim, self.dtype = config["depth"], config["heads"], config["dim"], dtype
        self.weights = {name: torch.from_numpy(value.copy()).to(dtype) for name, value in tensors.items()
                        if name.startswith("encoder.")}
        self.position = torch.from_numpy(network_file.position_code(self.dim)).to(dtype)

    def linear(self, x, name):
        return F.linear(x, self.weights[name + ".weight"], self.weights[name + ".bias"])

    def norm(self, x, name):
        return F.layer_norm(x, (self.dim,), self.weights[name + ".weight"], self.weights[name + ".bias"], 1e-6)

    def attention(self, x, prefix):
        split = lambda it: it.view(180, self.heads, self.dim // self.heads).transpose(0, 1)
        q, k, v = (split(it) for it in self.linear(x, prefix + "qkv").split(self.dim, dim=1))
        weights = torch.softmax(torch.bmm(q, k.transpose(1, 2)) * (self.dim // self.heads) ** -0.5, dim=-1)
        return self.linear(torch.bmm(weights, v).transpose(0, 1).reshape(180, self.dim), prefix + "proj")

    def forward(self, csi):
        tokens = csi.reshape(60, 180).t().to(self.dtype)
        weight = self.weights["encoder.patch_embed.proj.weight"].reshape(self.dim, 60)
        x = F.linear(tokens, weight, self.weights["encoder.patch_embed.proj.bias"]) + self.position
        for i in range(self.depth):
            prefix = f"encoder.blocks.{i}."
            x = x + self.attention(self.norm(x, prefix + "norm1"), prefix + "attn.")
            hidden = F.gelu(self.linear(self.norm(x, prefix + "norm2"), prefix + "mlp.fc1"))
            x = x + self.linear(hidden, prefix + "mlp.fc2")
        return self.norm(x, "encoder.norm")


weights, precision, threads, runs, window, expected = sys.argv[1:]
torch.set_num_threads(int(threads))
torch.set_flush_denormal(True)
tensors, config = network_file.read(weights)
x = torch.from_numpy(np.fromfile(window, np.float32).reshape(60, 20, 9))
with torch.inference_mode():
    model = Encoder(tensors, config, torch.bfloat16 if precision == "bf16" else torch.float32).eval()
    model = torch.jit.freeze(torch.jit.trace(model, x, check_trace=False))
    difference = float(np.abs(model(x).float().numpy().ravel() - np.fromfile(expected, np.float32)).max())
    figures = network_file.measure(lambda: model(x), int(runs))
network_file.report(f"libtorch {torch.__version__} encoder", precision, int(threads), figures, difference)
