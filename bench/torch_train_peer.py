"""Times a training step of the same networks written the usual way in PyTorch: modules, autocast, foreach AdamW, SciPy's matching.

usage: torch_train_peer.py OBJECTIVE PRECISION THREADS STEPS SIZES
OBJECTIVE pretrain (batch 64, five of nine links hidden) or finetune (batch 32, one to three people); PRECISION f32 or bf16;
SIZES: the `config` of a weights file, and the predictor's as predictor [dim, depth, heads]. Prints one JSON object, with the
number of parameters that learn.
"""
import copy
import json
import sys
import time

import numpy as np
import torch
import torch.nn.functional as F
from scipy.optimize import linear_sum_assignment
from torch import nn

import network_file

TOKENS, CHANNELS, LINKS, JOINTS, PEOPLE = 180, 60, 9, 14, 3


class Block(nn.Module):
    def __init__(self, dim, heads):
        super().__init__()
        self.heads = heads
        self.norm1, self.norm2 = nn.LayerNorm(dim, eps=1e-6), nn.LayerNorm(dim, eps=1e-6)
        self.qkv, self.proj = nn.Linear(dim, 3 * dim), nn.Linear(dim, dim)
        self.mlp = nn.Sequential(nn.Linear(dim, 4 * dim), nn.GELU(), nn.Linear(4 * dim, dim))

    def attention(self, x):
        b, n, dim = x.shape
        q, k, v = self.qkv(x).reshape(b, n, 3, self.heads, dim // self.heads).permute(2, 0, 3, 1, 4)
        share = (q * (dim // self.heads) ** -0.5 @ k.transpose(-2, -1)).softmax(-1)
        return self.proj((share @ v).transpose(1, 2).reshape(b, n, dim))

    def forward(self, x):
        x = x + self.attention(self.norm1(x))
        return x + self.mlp(self.norm2(x))


def code(width):
    return torch.from_numpy(network_file.position_code(width))


def gather(x, idx):
    return x.gather(1, idx.unsqueeze(-1).expand(-1, -1, x.shape[2]))


class Encoder(nn.Module):
    def __init__(self, dim, depth, heads):
        super().__init__()
        self.embed, self.norm = nn.Linear(CHANNELS, dim), nn.LayerNorm(dim, eps=1e-6)
        self.blocks = nn.ModuleList(Block(dim, heads) for _ in range(depth))
        self.register_buffer("code", code(dim))

    def forward(self, tokens, visible=None):
        x = self.embed(tokens) + self.code
        if visible is not None:
            x = gather(x, visible)
        for block in self.blocks:
            x = block(x)
        return self.norm(x)


class Predictor(nn.Module):
    def __init__(self, outer, dim, depth, heads):
        super().__init__()
        self.embed, self.proj, self.norm = nn.Linear(outer, dim), nn.Linear(dim, outer), nn.LayerNorm(dim, eps=1e-6)
        self.mask_token = nn.Parameter(torch.zeros(1, 1, dim))
        self.blocks = nn.ModuleList(Block(dim, heads) for _ in range(depth))
        self.register_buffer("code", code(dim))

    def forward(self, z, context, hidden):
        x = torch.cat([self.embed(z) + self.code[context], self.mask_token + self.code[hidden]], 1)
        for block in self.blocks:
            x = block(x)
        return self.proj(self.norm(x[:, context.shape[1]:]))


class DecoderLayer(nn.Module):
    def __init__(self, dim, heads, ffn):
        super().__init__()
        self.among = nn.MultiheadAttention(dim, heads, dropout=0.1, batch_first=True)
        self.seen = nn.MultiheadAttention(dim, heads, dropout=0.1, batch_first=True)
        self.fed = nn.Sequential(nn.Linear(dim, ffn), nn.ReLU(), nn.Dropout(0.1), nn.Linear(ffn, dim))
        self.norms = nn.ModuleList(nn.LayerNorm(dim) for _ in range(3))
        self.drop = nn.Dropout(0.1)

    def forward(self, q, position, memory):
        """q (B, G, n, E): each of G groups among itself, all of them against the window's memory."""
        b, groups, n, dim = q.shape
        flat = q.reshape(b * groups, n, dim)
        placed = flat + position
        flat = self.norms[0](flat + self.drop(self.among(placed, placed, flat, need_weights=False)[0]))
        asking = (flat + position).reshape(b, groups * n, dim)
        seen = self.seen(asking, memory, memory, need_weights=False)[0]
        q = self.norms[1](flat.reshape(b, groups * n, dim) + self.drop(seen))
        return self.norms[2](q + self.drop(self.fed(q))).reshape(b, groups, n, dim)


def mlp(*widths):
    layers = []
    for a, b in zip(widths, widths[1:]):
        layers += [nn.Linear(a, b), nn.ReLU()]
    return nn.Sequential(*layers[:-1])


class Poses(nn.Module):
    """Encoder and pose decoder."""

    def __init__(self, c):
        super().__init__()
        e, layers = c["decoder_dim"], c["decoder_layers"]
        self.queries = c["queries"]
        self.encoder = Encoder(c["dim"], c["depth"], c["heads"])
        self.proj, self.identity = nn.Linear(c["dim"], e), nn.Linear(e, e)
        self.table, self.refine_table = nn.Embedding(self.queries, 2 * e), nn.Embedding(JOINTS, 2 * e)
        layer = lambda: DecoderLayer(e, c["decoder_heads"], c["ffn"])
        self.layers = nn.ModuleList(layer() for _ in range(layers))
        self.refine_layers = nn.ModuleList(layer() for _ in range(c["refine_layers"]))
        self.cls = nn.ModuleList(nn.Linear(e, 1) for _ in range(layers + 1))
        hidden = c["kpt_hidden"]
        self.kpt = nn.ModuleList(mlp(e, hidden, hidden, hidden, 3 * JOINTS) for _ in range(layers + 1))
        self.refine_kpt = nn.ModuleList(mlp(e, e, e, 3) for _ in range(c["refine_layers"]))

    def decode(self, tokens):
        memory = self.proj(self.encoder(tokens)).float()
        proposals = self.cls[-1](memory).float(), self.kpt[-1](memory).float()
        best = proposals[0].detach().squeeze(-1).topk(self.queries, 1).indices
        pose = gather(proposals[1].detach(), best)
        position, content = self.table.weight.chunk(2, 1)
        q = content.expand(len(tokens), 1, -1, -1)
        answers = []
        for layer, cls, kpt in zip(self.layers, self.cls, self.kpt):
            q = layer(q, position, memory)
            answers.append((cls(q[:, 0]).float(), kpt(q[:, 0]).float() + pose))
            pose = answers[-1][1].detach()
        return memory, q[:, 0], answers, proposals

    def refine(self, memory, state, pose, chosen):
        position, content = self.refine_table.weight.chunk(2, 1)
        g = content + self.identity(gather(state, chosen)).unsqueeze(2)
        pose = gather(pose.detach(), chosen)
        poses = []
        for layer, kpt in zip(self.refine_layers, self.refine_kpt):
            g = layer(g, position, memory)
            poses.append(kpt(g).float().flatten(2) + pose)
            pose = poses[-1].detach()
        return poses


def match(cls, kpt, poses, count):
    """Lists of window, query and person: the assignment of least cost, window by window."""
    with torch.no_grad():
        p = cls.sigmoid()
        one = 0.25 * (1 - p) ** 2 * -(p + 1e-12).log()
        none = 0.75 * p ** 2 * -(1 - p + 1e-12).log()
        cost = (4 * (one - none) + 70 / 28 * (kpt.unsqueeze(2) - poses.unsqueeze(1)).norm(dim=-1)).numpy()
    pairs = [(b, q, m) for b, n in enumerate(count) for q, m in zip(*linear_sum_assignment(cost[b, :, :n]))]
    return torch.tensor(pairs).T


def layer_loss(cls, kpt, poses, count):
    window, query, person = pairs = match(cls, kpt, poses, count)
    wanted = torch.zeros_like(cls)
    wanted[window, query] = 1
    p = cls.sigmoid()
    off = (1 - p) * wanted + p * (1 - wanted)
    weight = (0.25 * wanted + 0.75 * (1 - wanted)) * off ** 2
    focal = (weight * F.binary_cross_entropy_with_logits(cls, wanted, reduction="none")).sum() / len(window)
    square = F.mse_loss(kpt[window, query], poses[window, person])
    return 4 * focal + 70 * square, pairs


def pose_loss(model, tokens, poses, count):
    memory, state, answers, proposals = model.decode(tokens)
    loss, _ = layer_loss(*proposals, poses, count)
    for cls, kpt in answers:
        part, (window, query, person) = layer_loss(cls, kpt, poses, count)
        loss = loss + part
    chosen, slot, used = torch.zeros(len(tokens), PEOPLE, dtype=torch.long), [], [0] * len(tokens)
    for b, q in zip(window.tolist(), query.tolist()):
        chosen[b, used[b]] = q
        slot.append(used[b])
        used[b] += 1
    for refined in model.refine(memory, state, answers[-1][1], chosen):
        loss = loss + 70 * F.mse_loss(refined[window, slot], poses[window, person])
    return loss


def link_masks(batch):
    """Tokens seen and tokens hidden, each ascending: five links hidden in every window."""
    order = torch.rand(batch, LINKS).argsort(1)
    seen = torch.ones(batch, LINKS, dtype=torch.bool).scatter_(1, order[:, :5], False).repeat(1, TOKENS // LINKS)
    return seen.nonzero()[:, 1].view(batch, -1), (~seen).nonzero()[:, 1].view(batch, -1)


def pretraining(c):
    encoder, batch = Encoder(c["dim"], c["depth"], c["heads"]), 64
    target, predictor = copy.deepcopy(encoder).requires_grad_(False), Predictor(c["dim"], *c["predictor"])
    learned = [*encoder.parameters(), *predictor.parameters()]
    optimiser = torch.optim.AdamW(learned, lr=1e-4, weight_decay=0.05, foreach=True)
    tokens = torch.randn(batch, TOKENS, CHANNELS)
    followers, leaders = list(target.parameters()), list(encoder.parameters())

    def loss():
        context, hidden = link_masks(batch)
        with torch.no_grad():
            wanted = gather(target(tokens).float(), hidden)
            wanted = F.layer_norm(wanted, wanted.shape[-1:])
        return F.smooth_l1_loss(predictor(encoder(tokens, context), context, hidden).float(), wanted)

    def step():
        optimiser.step()
        with torch.no_grad():
            torch._foreach_mul_(followers, 0.996)
            torch._foreach_add_(followers, leaders, alpha=0.004)

    return optimiser, learned, loss, step


def finetuning(c):
    model, batch = Poses(c), 32
    learned = list(model.parameters())
    optimiser = torch.optim.AdamW(learned, lr=1e-5, weight_decay=1e-4, foreach=True)
    tokens, count = torch.randn(batch, TOKENS, CHANNELS), [1 + b % PEOPLE for b in range(batch)]
    poses = torch.randn(batch, PEOPLE, 3 * JOINTS)

    def step():
        nn.utils.clip_grad_norm_(learned, 0.1)
        optimiser.step()

    return optimiser, learned, lambda: pose_loss(model, tokens, poses, count), step


def main():
    objective, precision, threads, steps, sizes = sys.argv[1:]
    torch.set_num_threads(int(threads))
    torch.set_flush_denormal(True)
    torch.manual_seed(1)
    optimiser, learned, loss, step = (pretraining if objective == "pretrain" else finetuning)(json.loads(sizes))
    now = time.process_time if threads == "1" else time.perf_counter
    least = float("inf")
    for _ in range(int(steps) + 1):
        begin = now()
        optimiser.zero_grad(set_to_none=True)
        with torch.autocast("cpu", torch.bfloat16, enabled=precision == "bf16"):
            value = loss()
        value.backward()
        assert np.isfinite(value.item())
        step()
        least = min(least, now() - begin)
    print(json.dumps({"step_s": least, "parameters": sum(it.numel() for it in learned), "version": torch.__version__}))


main()
