"""Attention and graph convolution within a frame, in training the inner loops on a CPU.

Frames are many and small, so most of the time of torch's own operations is overhead. As in
`windowed_attention.py` there are two equivalent implementations: one of torch's operations for any
device, and compiled kernels for the CPU.
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
    """Return the attention of T queries over the M tokens of their frame, [P, T, D].

    Args:
        query: [P, T, D], the heads concatenated, already scaled.
        key_value: [P, M, 2 D] keys and values; M is at least 1.
        score: [P, M, heads] added to the scores; without a gradient.
    """
    if query.numel() > 0 and on_cpu(query):
        return _attention(query, key_value, score)[0]
    heads = score.shape[-1]
    value = key_value.unflatten(-1, (2, heads, -1)).select(-3, 1)  # [P, M, heads, d]
    weights = frame_attention_weights(query, key_value, score).to(value.dtype)
    return torch.einsum("phtm,pmhd->pthd", weights, value).to(value.dtype).flatten(-2)


def frame_attention_weights(query: Tensor, key_value: Tensor, score: Tensor) -> Tensor:
    """Return the attention weights of T queries over M tokens, [P, heads, T, M]."""
    heads = score.shape[-1]
    key = key_value.unflatten(-1, (2, heads, -1)).select(-3, 0)
    product = torch.einsum("pthd,pmhd->phtm", query.unflatten(-1, (heads, -1)), key)
    return torch.softmax(product + score.transpose(1, 2).unsqueeze(2), -1)


def proximity_convolution(
    messages: Tensor, position: Tensor, known: Tensor, slope: float
) -> Tensor:
    """Return the weighted means of the messages that agents receive, [P, M, D].

    Args:
        messages: [P, M, D] of the agents.
        position: [P, M, 2]; without a gradient.
        known: [P, M]; messages of others have no weight, unless nobody is known.
        slope: weights are proportional to exp(-slope times the distance).
    """
    if messages.numel() > 0 and on_cpu(messages):
        return _convolution(messages, position, known, slope)[0]
    distance = (position.unsqueeze(1) - position.unsqueeze(2)).square().sum(-1)
    masked = torch.where(known, 0.0, MASKED).unsqueeze(1)
    weights = torch.softmax(masked - slope * distance.clamp_min(1e-12).sqrt(), -1)
    return torch.bmm(weights.to(messages.dtype), messages)


# Frames are independent of each other, so the kernels run them in parallel.


@numba.njit(error_model="numpy", fastmath=FASTMATH)
def _softmax(scores):
    """Replace scores by their softmax."""
    largest, norm = np.float32(-np.inf), np.float32(0.0)
    for m in range(len(scores)):
        largest = max(largest, scores[m])
    for m in range(len(scores)):
        scores[m] = np.exp(scores[m] - largest)
        norm += scores[m]
    for m in range(len(scores)):
        scores[m] /= norm


@compiled
def _attend(query, key_value, score, weights, out):
    """Arrays are [P, T, heads, d], [P, M, 2, heads, d]; the inner loops run over d alone."""
    total, queries, heads, size = query.shape
    tokens = key_value.shape[1]
    for p in prange(total):
        for h in range(heads):
            for t in range(queries):
                q, w, output = query[p, t, h], weights[p, h, t], out[p, t, h]
                for m in range(tokens):
                    key = key_value[p, m, 0, h]
                    product = np.float32(0.0)
                    for d in range(size):
                        product += q[d] * key[d]
                    w[m] = product + score[p, m, h]
                _softmax(w)
                for d in range(size):
                    output[d] = np.float32(0.0)
                for m in range(tokens):
                    weight, value = w[m], key_value[p, m, 1, h]
                    for d in range(size):
                        output[d] += weight * value[d]


@compiled
def _attend_backward(query, key_value, weights, gradient, grad_query, grad_key_value):
    total, queries, heads, size = query.shape
    tokens = key_value.shape[1]
    for p in prange(total):
        grad_weights = np.empty(tokens, np.float32)
        grad_key_value[p] = np.float32(0.0)
        for h in range(heads):
            for t in range(queries):
                q, w, grad_out = query[p, t, h], weights[p, h, t], gradient[p, t, h]
                grad_q, mean = grad_query[p, t, h], np.float32(0.0)
                for m in range(tokens):
                    weight, value, grad_value = (
                        w[m],
                        key_value[p, m, 1, h],
                        grad_key_value[p, m, 1, h],
                    )
                    grad_weight = np.float32(0.0)
                    for d in range(size):
                        grad_weight += grad_out[d] * value[d]
                        grad_value[d] += weight * grad_out[d]
                    grad_weights[m] = grad_weight
                    mean += weight * grad_weight
                for d in range(size):
                    grad_q[d] = np.float32(0.0)
                for m in range(tokens):
                    grad_score = w[m] * (grad_weights[m] - mean)
                    key, grad_key = key_value[p, m, 0, h], grad_key_value[p, m, 0, h]
                    for d in range(size):
                        grad_q[d] += grad_score * key[d]
                        grad_key[d] += grad_score * q[d]


@compiled
def _convolve(slope, messages, position, known, weights, out):
    """Arrays are [P, M, D], [P, M, 2], [P, M], [P, M, M]."""
    total, agents, width = messages.shape
    for p in prange(total):
        for i in range(agents):
            w, output = weights[p, i], out[p, i]
            for j in range(agents):
                dx = position[p, i, 0] - position[p, j, 0]
                dy = position[p, i, 1] - position[p, j, 1]
                w[j] = -slope * np.sqrt(max(dx * dx + dy * dy, np.float32(1e-12)))
                if not known[p, j]:
                    w[j] += np.float32(MASKED)
            _softmax(w)
            for d in range(width):
                output[d] = np.float32(0.0)
            for j in range(agents):
                weight, message = w[j], messages[p, j]
                for d in range(width):
                    output[d] += weight * message[d]


@compiled
def _convolve_backward(weights, gradient, grad_messages):
    total, agents, width = gradient.shape
    for p in prange(total):
        grad_messages[p] = np.float32(0.0)
        for i in range(agents):
            grad_out = gradient[p, i]
            for j in range(agents):
                weight, grad_message = weights[p, i, j], grad_messages[p, j]
                for d in range(width):
                    grad_message[d] += weight * grad_out[d]


def _empty_attention(query, key_value, score):
    """Allocate the result [P, T, D] and the attention weights [P, heads, T, M]."""
    p, m, heads = score.shape
    return query.new_empty(query.shape), query.new_empty(p, heads, query.shape[1], m)


def _launch_attention(query, key_value, score, out, weights):
    heads = score.shape[2]
    query, key_value, out = (
        unflatten(query, heads),
        unflatten(key_value, 2, heads),
        unflatten(out, heads),
    )
    _attend(query, key_value, score, weights, out)


def _empty_gradients(query, key_value, weights, gradient):
    return query.new_empty(query.shape), key_value.new_empty(key_value.shape)


def _launch_gradients(query, key_value, weights, gradient, grad_query, grad_key_value):
    heads = weights.shape[1]
    query, key_value, gradient = (
        unflatten(query, heads),
        unflatten(key_value, 2, heads),
        unflatten(gradient, heads),
    )
    grad_query, grad_key_value = unflatten(grad_query, heads), unflatten(grad_key_value, 2, heads)
    _attend_backward(query, key_value, weights, gradient, grad_query, grad_key_value)


def _empty_convolution(messages, position, known, slope):
    """Allocate the result [P, M, D] and the weights [P, M, M]."""
    return messages.new_empty(messages.shape), messages.new_empty(*known.shape, known.shape[1])


def _launch_convolution(messages, position, known, slope, out, weights):
    _convolve(np.float32(slope), messages, position, known, weights, out)


_attention = Operator(
    "frame_attention",
    "(Tensor query, Tensor key_value, Tensor score) -> (Tensor, Tensor)",
    _empty_attention,
    _launch_attention,
)
_attention_gradients = Operator(
    "frame_attention_backward",
    "(Tensor query, Tensor key_value, Tensor weights, Tensor gradient) -> (Tensor, Tensor)",
    _empty_gradients,
    _launch_gradients,
)
_attention.register_gradient(
    lambda inputs, outputs: (*inputs[:2], outputs[1]),
    lambda *saved: (*_attention_gradients.op(*saved), None),
)
_convolution = Operator(
    "proximity_convolution",
    "(Tensor messages, Tensor position, Tensor known, float slope) -> (Tensor, Tensor)",
    _empty_convolution,
    _launch_convolution,
)
_convolution_gradient = Operator(
    "proximity_convolution_backward",
    "(Tensor weights, Tensor gradient) -> Tensor",
    lambda weights, gradient: gradient.new_empty(gradient.shape),
    _convolve_backward,
)
_convolution.register_gradient(
    lambda inputs, outputs: (outputs[1],),
    lambda *saved: (_convolution_gradient.op(*saved), None, None, None),
)
