"""Attention and graph convolution within a frame: the other inner loops of training on a CPU.

Frames are many and small, so torch's own operations are mostly overhead. As in
`windowed_attention.py` there are two forms, which are equal: of torch's operations for any device,
and compiled for the CPU.
"""

from __future__ import annotations

from typing import Any

import numba
import numpy as np
import torch
from numba import prange
from torch import Tensor

from samarl.encoders.windowed_attention import FASTMATH, MASKED, compiled, on_cpu


def frame_attention(query: Tensor, kept: Tensor, score: Tensor) -> Tensor:
    """What each of T queries takes from the M tokens of its frame, [P, T, D].

    Args:
        query: [P, T, D], of several heads one after another, already scaled.
        kept: [P, M, 2 D] keys and values; M is 1 at least.
        score: [P, M, heads] added to the products; it gets no gradient.
    """
    if query.numel() > 0 and on_cpu(query):
        result: Tensor = _Attention.apply(query, kept, score)
        return result
    heads = score.shape[-1]
    value = kept.unflatten(-1, (2, heads, -1)).select(-3, 1)  # [P, M, heads, d]
    share = frame_shares(query, kept, score).to(value.dtype)
    return torch.einsum("phtm,pmhd->pthd", share, value).to(value.dtype).flatten(-2)


def frame_shares(query: Tensor, kept: Tensor, score: Tensor) -> Tensor:
    """The share of each query's attention that each token gets, [P, heads, T, M]."""
    heads = score.shape[-1]
    key = kept.unflatten(-1, (2, heads, -1)).select(-3, 0)
    found = torch.einsum("pthd,pmhd->phtm", query.unflatten(-1, (heads, -1)), key)
    return torch.softmax(found + score.transpose(1, 2).unsqueeze(2), -1)


def proximity_convolution(passed: Tensor, position: Tensor, known: Tensor, slope: float) -> Tensor:
    """What each of M agents is passed by those of its frame, nearer ones more, [P, M, D].

    Args:
        passed: [P, M, D] by each of them.
        position: [P, M, 2]; it gets no gradient.
        known: [P, M]; others pass nothing on, unless nobody is known.
        slope: shares are proportional to exp(-slope times the distance).
    """
    if passed.numel() > 0 and on_cpu(passed):
        result: Tensor = _Convolution.apply(passed, position, known, slope)
        return result
    distance = (position.unsqueeze(1) - position.unsqueeze(2)).square().sum(-1)
    masked = torch.where(known, 0.0, MASKED).unsqueeze(1)
    share = torch.softmax(masked - slope * distance.clamp_min(1e-12).sqrt(), -1)
    return torch.bmm(share.to(passed.dtype), passed)


class _Attention(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, query: Tensor, kept: Tensor, score: Tensor) -> Tensor:
        p, t, width = query.shape
        m, heads = score.shape[1:]
        query = query.detach().contiguous().view(p, t, heads, width // heads)
        kept = kept.detach().contiguous().view(p, m, 2, heads, width // heads)
        out, share = torch.empty_like(query), query.new_empty(p, heads, t, m)
        arrays = query, kept, score.detach().contiguous(), share, out
        _attend(*(tensor.numpy() for tensor in arrays))
        ctx.save_for_backward(query, kept, share)
        return out.flatten(-2)

    @staticmethod
    def backward(ctx: Any, *gradients: Tensor) -> Any:
        query, kept, share = ctx.saved_tensors
        of_query, of_kept = torch.empty_like(query), torch.empty_like(kept)
        given = gradients[0].contiguous().view_as(query)
        arrays = query, kept, share, given, of_query, of_kept
        _attend_backward(*(tensor.numpy() for tensor in arrays))
        return of_query.flatten(-2), of_kept.flatten(2), None


class _Convolution(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, passed: Tensor, position: Tensor, known: Tensor, slope: float) -> Tensor:
        passed = passed.detach().contiguous()
        share, out = passed.new_empty(*known.shape, known.shape[1]), torch.empty_like(passed)
        arrays = passed, position.contiguous(), known.contiguous(), share, out
        _convolve(np.float32(slope), *(tensor.numpy() for tensor in arrays))
        ctx.save_for_backward(share)
        return out

    @staticmethod
    def backward(ctx: Any, *gradients: Tensor) -> Any:
        (share,) = ctx.saved_tensors
        given = gradients[0].contiguous()
        of_passed = torch.empty_like(given)
        _convolve_backward(share.numpy(), given.numpy(), of_passed.numpy())
        return of_passed, None, None, None


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
