"""Attention of tokens over their own last H frames: the inner loop of training on a CPU.

The same in two forms: of torch's operations for any device, and compiled for the CPU, where it
reads keys and values in place instead of copying every window, several times as fast.
"""

from __future__ import annotations

from typing import Any

import numba
import numpy as np
import torch
from numba import prange
from torch import Tensor

MASKED = -1e9  # score of who must get no attention

# Sums may be reordered here (vector units), unlike in the simulator; the result is still the same
# every time on one machine, whatever the number of threads.
FASTMATH = {"reassoc", "contract", "nsz"}
compiled = numba.njit(cache=True, parallel=True, error_model="numpy", fastmath=FASTMATH)


def on_cpu(tensor: Tensor) -> bool:
    """Whether what is compiled can work on it; what is exported is made of torch's operations."""
    exported = torch.onnx.is_in_onnx_export()
    return tensor.device.type == "cpu" and tensor.dtype == torch.float32 and not exported


def windowed_attention(
    query: Tensor, kept: Tensor, window: Tensor, allowed: Tensor, bias: Tensor
) -> Tensor:
    """What each token takes from its own past, [P, M, D]; zero where no frame is allowed.

    Args:
        query: [P, M, D], of several heads one after another, already scaled.
        kept: [F, M, 2 D] keys and values of all frames.
        window: [P, H] which frames.
        allowed: [P, H, M] which of them a token may look at.
        bias: [heads, H] added to the scores.
    """
    if query.numel() == 0:
        return query
    if on_cpu(query):
        result: Tensor = _OnCPU.apply(query, kept, window, allowed, bias)
        return result
    return by_torch(query, kept, window, allowed, bias)


def by_torch(query: Tensor, kept: Tensor, window: Tensor, allowed: Tensor, bias: Tensor) -> Tensor:
    """`windowed_attention` of torch's own operations."""
    heads = len(bias)
    key, value = kept[window].unflatten(-1, (2, heads, -1)).unbind(-3)  # [P, H, M, heads, d]
    score = (query.unflatten(-1, (heads, -1)).unsqueeze(1) * key).sum(-1) + bias.T.unsqueeze(1)
    share = torch.softmax(torch.where(allowed.unsqueeze(-1), score, MASKED), 1)
    share = share * allowed.any(1)[:, None, :, None]
    return (share.unsqueeze(-1) * value).sum(1).flatten(-2)


class _OnCPU(torch.autograd.Function):
    @staticmethod
    def forward(
        ctx: Any, query: Tensor, kept: Tensor, window: Tensor, allowed: Tensor, bias: Tensor
    ) -> Tensor:
        p, m, width = query.shape
        heads = len(bias)
        size = width // heads  # -1 would be ambiguous with nobody there
        query = query.detach().contiguous().view(p, m, heads, size)
        kept = kept.detach().contiguous().view(len(kept), m, 2, heads, size)
        out, share = torch.empty_like(query), query.new_empty(p, m, *bias.shape)
        arrays = query, kept, window.contiguous(), allowed.contiguous(), bias.contiguous()
        _forward(*(tensor.numpy() for tensor in (*arrays, share, out)))
        ctx.save_for_backward(query, kept, arrays[2], share)
        return out.flatten(-2)

    @staticmethod
    def backward(ctx: Any, *gradients: Tensor) -> Any:
        query, kept, window, share = ctx.saved_tensors
        of_query, of_kept = torch.empty_like(query), torch.zeros_like(kept)
        _backward(
            *(tensor.numpy() for tensor in (query, kept, window, share)),
            gradients[0].contiguous().view_as(query).numpy(), of_query.numpy(), of_kept.numpy(),
        )  # fmt: skip
        return of_query.flatten(-2), of_kept.flatten(2), None, None, None


@compiled
def _forward(query, kept, window, allowed, bias, share, out):
    """Arrays are [P, M, heads, d], [F, M, 2, heads, d]; the inner loops run over d alone."""
    total, agents, heads, size = query.shape
    frames = bias.shape[1]
    pieces = min(agents, 64)
    for piece in prange(pieces):
        for m in range(piece, agents, pieces):
            for p in range(total):
                for h in range(heads):
                    asks, found, gives = query[p, m, h], share[p, m, h], out[p, m, h]
                    largest = np.float32(MASKED)
                    for j in range(frames):
                        if allowed[p, j, m]:
                            key = kept[window[p, j], m, 0, h]
                            score = np.float32(0.0)
                            for d in range(size):
                                score += asks[d] * key[d]
                            found[j] = score + bias[h, j]
                            largest = max(largest, found[j])
                    norm = np.float32(0.0)
                    for j in range(frames):
                        if allowed[p, j, m]:
                            found[j] = np.exp(found[j] - largest)
                            norm += found[j]
                        else:
                            found[j] = np.float32(0.0)
                    for d in range(size):
                        gives[d] = np.float32(0.0)
                    for j in range(frames):
                        if found[j] > np.float32(0.0):
                            found[j] /= norm
                            part, value = found[j], kept[window[p, j], m, 1, h]
                            for d in range(size):
                                gives[d] += part * value[d]


@compiled
def _backward(query, kept, window, share, gradient, of_query, of_kept):
    total, agents, heads, size = query.shape
    frames = share.shape[3]
    pieces = min(agents, 64)
    for piece in prange(pieces):  # pieces differ in the agents, so none writes where another does
        of_share = np.empty(frames, np.float32)
        for m in range(piece, agents, pieces):
            for p in range(total):
                for h in range(heads):
                    given, asks, of_asks = gradient[p, m, h], query[p, m, h], of_query[p, m, h]
                    mean = np.float32(0.0)
                    for j in range(frames):
                        part, f = share[p, m, h, j], window[p, j]
                        change = np.float32(0.0)
                        if part > np.float32(0.0):
                            value, of_value = kept[f, m, 1, h], of_kept[f, m, 1, h]
                            for d in range(size):
                                change += given[d] * value[d]
                                of_value[d] += part * given[d]
                        of_share[j] = change
                        mean += part * change
                    for d in range(size):
                        of_asks[d] = np.float32(0.0)
                    for j in range(frames):
                        part, f = share[p, m, h, j], window[p, j]
                        if part > np.float32(0.0):
                            change = part * (of_share[j] - mean)
                            key, of_key = kept[f, m, 0, h], of_kept[f, m, 0, h]
                            for d in range(size):
                                of_asks[d] += change * key[d]
                                of_key[d] += change * asks[d]
