"""Attention of tokens over their own last H frames: the inner loop of training on a CPU.

The same in two forms: of torch's operations for any device, and compiled for the CPU, where it
reads keys and values in place instead of copying every window, several times as fast.
"""

from __future__ import annotations

import numpy as np
import torch
from numba import prange
from torch import Tensor

from samarl.encoders.operators import Operator, compiled, on_cpu, unflatten

MASKED = -1e9  # score of who must get no attention


def windowed_attention(
    query: Tensor, key_value: Tensor, window: Tensor, allowed: Tensor, bias: Tensor
) -> Tensor:
    """What each token takes from its own past, [P, M, D]; zero where no frame is allowed.

    Args:
        query: [P, M, D], of several heads one after another, already scaled.
        key_value: [F, M, 2 D] keys and values of all frames.
        window: [P, H] which frames.
        allowed: [P, H, M] which of them a token may look at.
        bias: [heads, H] added to the scores; it gets no gradient.
    """
    if query.numel() == 0:
        return query
    if on_cpu(query):
        return _attention(query, key_value, window, allowed, bias)[0]
    return by_torch(query, key_value, window, allowed, bias)


def by_torch(
    query: Tensor, key_value: Tensor, window: Tensor, allowed: Tensor, bias: Tensor
) -> Tensor:
    """`windowed_attention` of torch's own operations."""
    heads = len(bias)
    key, value = key_value[window].unflatten(-1, (2, heads, -1)).unbind(-3)  # [P, H, M, heads, d]
    score = (query.unflatten(-1, (heads, -1)).unsqueeze(1) * key).sum(-1) + bias.T.unsqueeze(1)
    share = torch.softmax(torch.where(allowed.unsqueeze(-1), score, MASKED), 1)
    share = share * allowed.any(1)[:, None, :, None]
    return (share.unsqueeze(-1) * value).sum(1).flatten(-2)


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


def _empty_attention(query, key_value, window, allowed, bias):
    """The result [P, M, D] and the shares [P, M, heads, H]."""
    return query.new_empty(query.shape), query.new_empty(*query.shape[:2], *bias.shape)


def _attend(query, key_value, window, allowed, bias, out, share):
    heads = len(bias)
    query, key_value, out = (
        unflatten(query, heads),
        unflatten(key_value, 2, heads),
        unflatten(out, heads),
    )
    _forward(query, key_value, window, allowed, bias, share, out)


def _empty_gradients(query, key_value, window, share, gradient):
    return query.new_empty(query.shape), key_value.new_empty(key_value.shape)


def _attend_backward(query, key_value, window, share, gradient, of_query, of_key_value):
    heads = share.shape[2]
    query, key_value, gradient = (
        unflatten(query, heads),
        unflatten(key_value, 2, heads),
        unflatten(gradient, heads),
    )
    of_key_value[:] = 0.0
    of_query, of_key_value = unflatten(of_query, heads), unflatten(of_key_value, 2, heads)
    _backward(query, key_value, window, share, gradient, of_query, of_key_value)


_attention = Operator(
    "windowed_attention",
    "(Tensor query, Tensor key_value, Tensor window, Tensor allowed, Tensor bias)"
    " -> (Tensor, Tensor)",
    _empty_attention,
    _attend,
)
_gradients = Operator(
    "windowed_attention_backward",
    "(Tensor query, Tensor key_value, Tensor window, Tensor share, Tensor gradient)"
    " -> (Tensor, Tensor)",
    _empty_gradients,
    _attend_backward,
)
_attention.register_gradient(
    lambda inputs, outputs: (*inputs[:3], outputs[1]),
    lambda *saved: (*_gradients.op(*saved), None, None, None),
)
