"""Attention and graph convolution within a frame: the other inner loops of training on a CPU.

Frames are many and small, so torch's own operations are mostly overhead. As in
`windowed_attention.py` there are two forms, which are equal: of torch's operations for any device,
and compiled for the CPU.
"""

from __future__ import annotations

import numba
import numpy as np
import torch
from numba import prange
from torch import Tensor

from samarl.encoders.operators import FASTMATH, Operator, compiled, on_cpu, unflatten
from samarl.encoders.windowed_attention import MASKED


def frame_attention(query: Tensor, key_value: Tensor, score: Tensor) -> Tensor:
    """What each of T queries takes from the M tokens of its frame, [P, T, D].

    Args:
        query: [P, T, D], of several heads one after another, already scaled.
        key_value: [P, M, 2 D] keys and values; M is 1 at least.
        score: [P, M, heads] added to the products; it gets no gradient.
    """
    if query.numel() > 0 and on_cpu(query):
        return _attention(query, key_value, score)[0]
    heads = score.shape[-1]
    value = key_value.unflatten(-1, (2, heads, -1)).select(-3, 1)  # [P, M, heads, d]
    share = frame_shares(query, key_value, score).to(value.dtype)
    return torch.einsum("phtm,pmhd->pthd", share, value).to(value.dtype).flatten(-2)


def frame_shares(query: Tensor, key_value: Tensor, score: Tensor) -> Tensor:
    """The share of each query's attention that each token gets, [P, heads, T, M]."""
    heads = score.shape[-1]
    key = key_value.unflatten(-1, (2, heads, -1)).select(-3, 0)
    product = torch.einsum("pthd,pmhd->phtm", query.unflatten(-1, (heads, -1)), key)
    return torch.softmax(product + score.transpose(1, 2).unsqueeze(2), -1)


def proximity_convolution(passed: Tensor, position: Tensor, known: Tensor, slope: float) -> Tensor:
    """What each of M agents is passed by those of its frame, nearer ones more, [P, M, D].

    Args:
        passed: [P, M, D] by each of them.
        position: [P, M, 2]; it gets no gradient.
        known: [P, M]; others pass nothing on, unless nobody is known.
        slope: shares are proportional to exp(-slope times the distance).
    """
    if passed.numel() > 0 and on_cpu(passed):
        return _convolution(passed, position, known, slope)[0]
    distance = (position.unsqueeze(1) - position.unsqueeze(2)).square().sum(-1)
    masked = torch.where(known, 0.0, MASKED).unsqueeze(1)
    share = torch.softmax(masked - slope * distance.clamp_min(1e-12).sqrt(), -1)
    return torch.bmm(share.to(passed.dtype), passed)


# Frames are independent of each other, so every thread takes its own.


@numba.njit(cache=True, error_model="numpy", fastmath=FASTMATH)
def _softmax(scores):
    """From scores to shares, in place."""
    largest, norm = np.float32(-np.inf), np.float32(0.0)
    for m in range(len(scores)):
        largest = max(largest, scores[m])
    for m in range(len(scores)):
        scores[m] = np.exp(scores[m] - largest)
        norm += scores[m]
    for m in range(len(scores)):
        scores[m] /= norm


@compiled
def _attend(query, kept, score, share, out):
    """Arrays are [P, T, heads, d], [P, M, 2, heads, d]; the inner loops run over d alone."""
    total, queries, heads, size = query.shape
    tokens = kept.shape[1]
    for p in prange(total):
        for h in range(heads):
            for t in range(queries):
                asks, found, gives = query[p, t, h], share[p, h, t], out[p, t, h]
                for m in range(tokens):
                    key = kept[p, m, 0, h]
                    product = np.float32(0.0)
                    for d in range(size):
                        product += asks[d] * key[d]
                    found[m] = product + score[p, m, h]
                _softmax(found)
                for d in range(size):
                    gives[d] = np.float32(0.0)
                for m in range(tokens):
                    part, value = found[m], kept[p, m, 1, h]
                    for d in range(size):
                        gives[d] += part * value[d]


@compiled
def _attend_backward(query, kept, share, gradient, of_query, of_kept):
    total, queries, heads, size = query.shape
    tokens = kept.shape[1]
    for p in prange(total):
        of_share = np.empty(tokens, np.float32)
        of_kept[p] = np.float32(0.0)
        for h in range(heads):
            for t in range(queries):
                asks, found, given = query[p, t, h], share[p, h, t], gradient[p, t, h]
                of_asks, mean = of_query[p, t, h], np.float32(0.0)
                for m in range(tokens):
                    part, value, of_value = found[m], kept[p, m, 1, h], of_kept[p, m, 1, h]
                    change = np.float32(0.0)
                    for d in range(size):
                        change += given[d] * value[d]
                        of_value[d] += part * given[d]
                    of_share[m] = change
                    mean += part * change
                for d in range(size):
                    of_asks[d] = np.float32(0.0)
                for m in range(tokens):
                    change = found[m] * (of_share[m] - mean)
                    key, of_key = kept[p, m, 0, h], of_kept[p, m, 0, h]
                    for d in range(size):
                        of_asks[d] += change * key[d]
                        of_key[d] += change * asks[d]


@compiled
def _convolve(slope, passed, position, known, share, out):
    """Arrays are [P, M, D], [P, M, 2], [P, M], [P, M, M]."""
    total, agents, width = passed.shape
    for p in prange(total):
        for i in range(agents):
            found, gives = share[p, i], out[p, i]
            for j in range(agents):
                dx = position[p, i, 0] - position[p, j, 0]
                dy = position[p, i, 1] - position[p, j, 1]
                found[j] = -slope * np.sqrt(max(dx * dx + dy * dy, np.float32(1e-12)))
                if not known[p, j]:
                    found[j] += np.float32(MASKED)
            _softmax(found)
            for d in range(width):
                gives[d] = np.float32(0.0)
            for j in range(agents):
                part, gift = found[j], passed[p, j]
                for d in range(width):
                    gives[d] += part * gift[d]


@compiled
def _convolve_backward(share, gradient, of_passed):
    total, agents, width = gradient.shape
    for p in prange(total):
        of_passed[p] = np.float32(0.0)
        for i in range(agents):
            given = gradient[p, i]
            for j in range(agents):
                part, of_gift = share[p, i, j], of_passed[p, j]
                for d in range(width):
                    of_gift[d] += part * given[d]


def _empty_attention(query, key_value, score):
    """The result [P, T, D] and the shares [P, heads, T, M]."""
    p, m, heads = score.shape
    return query.new_empty(query.shape), query.new_empty(p, heads, query.shape[1], m)


def _launch_attention(query, key_value, score, out, share):
    heads = score.shape[2]
    query, key_value, out = (
        unflatten(query, heads),
        unflatten(key_value, 2, heads),
        unflatten(out, heads),
    )
    _attend(query, key_value, score, share, out)


def _empty_gradients(query, key_value, share, gradient):
    return query.new_empty(query.shape), key_value.new_empty(key_value.shape)


def _launch_gradients(query, key_value, share, gradient, of_query, of_key_value):
    heads = share.shape[1]
    query, key_value, gradient = (
        unflatten(query, heads),
        unflatten(key_value, 2, heads),
        unflatten(gradient, heads),
    )
    of_query, of_key_value = unflatten(of_query, heads), unflatten(of_key_value, 2, heads)
    _attend_backward(query, key_value, share, gradient, of_query, of_key_value)


def _empty_convolution(passed, position, known, slope):
    """The result [P, M, D] and the shares [P, M, M]."""
    return passed.new_empty(passed.shape), passed.new_empty(*known.shape, known.shape[1])


def _launch_convolution(passed, position, known, slope, out, share):
    _convolve(np.float32(slope), passed, position, known, share, out)


_attention = Operator(
    "frame_attention",
    "(Tensor query, Tensor key_value, Tensor score) -> (Tensor, Tensor)",
    _empty_attention,
    _launch_attention,
)
_attention_gradients = Operator(
    "frame_attention_backward",
    "(Tensor query, Tensor key_value, Tensor share, Tensor gradient) -> (Tensor, Tensor)",
    _empty_gradients,
    _launch_gradients,
)
_attention.register_gradient(
    lambda inputs, outputs: (*inputs[:2], outputs[1]),
    lambda *saved: (*_attention_gradients.op(*saved), None),
)
_convolution = Operator(
    "proximity_convolution",
    "(Tensor passed, Tensor position, Tensor known, float slope) -> (Tensor, Tensor)",
    _empty_convolution,
    _launch_convolution,
)
_convolution_gradient = Operator(
    "proximity_convolution_backward",
    "(Tensor share, Tensor gradient) -> Tensor",
    lambda share, gradient: gradient.new_empty(gradient.shape),
    _convolve_backward,
)
_convolution.register_gradient(
    lambda inputs, outputs: (outputs[1],),
    lambda *saved: (_convolution_gradient.op(*saved), None, None, None),
)
