"""Attention of tokens over their own last H frames, in training the inner loop on a CPU.

There are two equivalent implementations: one of torch's operations for any device, and compiled
kernels for the CPU, which read keys and values in place instead of copying every window and are
several times as fast.
"""

from __future__ import annotations

import numpy as np
import torch
from numba import prange
from torch import Tensor

from samarl.encoders.operators import Operator, compiled, on_cpu, unflatten

MASKED = -1e9  # score of masked tokens


def windowed_attention(
    query: Tensor, key_value: Tensor, window: Tensor, allowed: Tensor, bias: Tensor
) -> Tensor:
    """Return the attention of each token over its own past, [P, M, D]; zero if no frame is allowed.

    Args:
        query: [P, M, D], the heads concatenated, already scaled.
        key_value: [F, M, 2 D] keys and values of all frames.
        window: [P, H] indices of frames.
        allowed: [P, H, M] which of them a token may attend to.
        bias: [heads, H] added to the scores; without a gradient.
    """
    if query.numel() == 0:
        return query
    if on_cpu(query):
        return _attention(query, key_value, window, allowed, bias)[0]
    return by_torch(query, key_value, window, allowed, bias)


def by_torch(
    query: Tensor, key_value: Tensor, window: Tensor, allowed: Tensor, bias: Tensor
) -> Tensor:
    """Compute `windowed_attention` with torch's own operations."""
    heads = len(bias)
    key, value = key_value[window].unflatten(-1, (2, heads, -1)).unbind(-3)  # [P, H, M, heads, d]
    score = (query.unflatten(-1, (heads, -1)).unsqueeze(1) * key).sum(-1) + bias.T.unsqueeze(1)
    weights = torch.softmax(torch.where(allowed.unsqueeze(-1), score, MASKED), 1)
    weights = weights * allowed.any(1)[:, None, :, None]
    return (weights.unsqueeze(-1) * value).sum(1).flatten(-2)


@compiled
def _forward(query, key_value, window, allowed, bias, weights, out):
    """Arrays are [P, M, heads, d], [F, M, 2, heads, d]; the inner loops run over d alone."""
    total, agents, heads, size = query.shape
    frames = bias.shape[1]
    pieces = min(agents, 64)
    for piece in prange(pieces):
        for m in range(piece, agents, pieces):
            for p in range(total):
                for h in range(heads):
                    q, w, output = query[p, m, h], weights[p, m, h], out[p, m, h]
                    largest = np.float32(MASKED)
                    for j in range(frames):
                        if allowed[p, j, m]:
                            key = key_value[window[p, j], m, 0, h]
                            score = np.float32(0.0)
                            for d in range(size):
                                score += q[d] * key[d]
                            w[j] = score + bias[h, j]
                            largest = max(largest, w[j])
                    norm = np.float32(0.0)
                    for j in range(frames):
                        if allowed[p, j, m]:
                            w[j] = np.exp(w[j] - largest)
                            norm += w[j]
                        else:
                            w[j] = np.float32(0.0)
                    for d in range(size):
                        output[d] = np.float32(0.0)
                    for j in range(frames):
                        if w[j] > np.float32(0.0):
                            w[j] /= norm
                            weight, value = w[j], key_value[window[p, j], m, 1, h]
                            for d in range(size):
                                output[d] += weight * value[d]


@compiled
def _backward(query, key_value, window, weights, gradient, grad_query, grad_key_value):
    total, agents, heads, size = query.shape
    frames = weights.shape[3]
    pieces = min(agents, 64)
    for piece in prange(pieces):  # of the agents, so no two pieces write to the same place
        grad_weights = np.empty(frames, np.float32)
        for m in range(piece, agents, pieces):
            for p in range(total):
                for h in range(heads):
                    grad_out, q, grad_q = gradient[p, m, h], query[p, m, h], grad_query[p, m, h]
                    mean = np.float32(0.0)
                    for j in range(frames):
                        weight, f = weights[p, m, h, j], window[p, j]
                        grad_weight = np.float32(0.0)
                        if weight > np.float32(0.0):
                            value, grad_value = key_value[f, m, 1, h], grad_key_value[f, m, 1, h]
                            for d in range(size):
                                grad_weight += grad_out[d] * value[d]
                                grad_value[d] += weight * grad_out[d]
                        grad_weights[j] = grad_weight
                        mean += weight * grad_weight
                    for d in range(size):
                        grad_q[d] = np.float32(0.0)
                    for j in range(frames):
                        weight, f = weights[p, m, h, j], window[p, j]
                        if weight > np.float32(0.0):
                            grad_score = weight * (grad_weights[j] - mean)
                            key, grad_key = key_value[f, m, 0, h], grad_key_value[f, m, 0, h]
                            for d in range(size):
                                grad_q[d] += grad_score * key[d]
                                grad_key[d] += grad_score * q[d]


def _empty_attention(query, key_value, window, allowed, bias):
    """Allocate the result [P, M, D] and the attention weights [P, M, heads, H]."""
    return query.new_empty(query.shape), query.new_empty(*query.shape[:2], *bias.shape)


def _attend(query, key_value, window, allowed, bias, out, weights):
    heads = len(bias)
    query, key_value, out = (
        unflatten(query, heads),
        unflatten(key_value, 2, heads),
        unflatten(out, heads),
    )
    _forward(query, key_value, window, allowed, bias, weights, out)


def _empty_gradients(query, key_value, window, weights, gradient):
    return query.new_empty(query.shape), key_value.new_empty(key_value.shape)


def _attend_backward(query, key_value, window, weights, gradient, grad_query, grad_key_value):
    heads = weights.shape[2]
    query, key_value, gradient = (
        unflatten(query, heads),
        unflatten(key_value, 2, heads),
        unflatten(gradient, heads),
    )
    grad_key_value[:] = 0.0
    grad_query, grad_key_value = unflatten(grad_query, heads), unflatten(grad_key_value, 2, heads)
    _backward(query, key_value, window, weights, gradient, grad_query, grad_key_value)


_attention = Operator(
    "windowed_attention",
    "(Tensor query, Tensor key_value, Tensor window, Tensor allowed, Tensor bias)"
    " -> (Tensor, Tensor)",
    _empty_attention,
    _attend,
)
_gradients = Operator(
    "windowed_attention_backward",
    "(Tensor query, Tensor key_value, Tensor window, Tensor weights, Tensor gradient)"
    " -> (Tensor, Tensor)",
    _empty_gradients,
    _attend_backward,
)
_attention.register_gradient(
    lambda inputs, outputs: (*inputs[:3], outputs[1]),
    lambda *saved: (*_gradients.op(*saved), None, None, None),
)
