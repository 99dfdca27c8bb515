"""Two layers per agent and the maximum over agents, as one operator.

The layers see known agents only: often less than half of the slots are filled. The gradient of a
maximum reaches one agent per feature. General matrix products would also multiply the zeros of all
others, which takes several times as long.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from numba import prange
from numpy.typing import NDArray
from torch import Tensor
from torch.nn import functional

from samarl.encoders.operators import Operator, compiled, on_cpu, serial

PARTS = 8  # of the rows, whose gradients are summed in this order whatever the number of threads


def set_pooling(
    own: Tensor, features: Tensor, known: Tensor, first: Tensor, second: Tensor, bias: Tensor
) -> Tensor:
    """Return max_m relu(second relu(own + first x_m) + bias) over the known agents m, [P, D].

    It is 0 where nobody is known.

    Args:
        own: [P, D] what the robot itself adds to the first layer.
        features: [P, M, F] of the agents, x_m.
        known: [P, M] bool.
        first: [D, F] weights of the first layer.
        second: [D, D] weights of the second layer.
        bias: [D] of the second layer.
    """
    if features.shape[1] == 0:
        return torch.zeros_like(own)
    if on_cpu(own) and not features.requires_grad:
        # The known agents [K, F] of all rows, and where those of each row end among them [P].
        agents = features.flatten(0, 1)[known.flatten()]
        end = known.sum(1).cumsum(0)
        pooled: Tensor = _pooling(own, agents, end, first, second, bias)[0]
        return pooled
    hidden = torch.relu(functional.linear(features, first) + own.unsqueeze(1))
    values = functional.linear(hidden, second, bias)
    return torch.relu(torch.where(known.unsqueeze(-1), values, 0.0).amax(1))


@serial
def _first_layer(own, end, hidden):
    """Add `own` [P, D] of an agent's robot to `hidden` [K, D] and rectify it."""
    for p in range(len(end)):
        robot = own[p]
        for k in range(end[p - 1] if p else 0, end[p]):
            h = hidden[k]
            for d in range(len(h)):
                h[d] = max(h[d] + robot[d], np.float32(0.0))


@serial
def _largest(values, end, pooled, winner):
    """Write the maximum of each feature and which agent has it, -1 where the maximum is 0."""
    for p in range(len(pooled)):
        largest, agent = pooled[p], winner[p]
        for d in range(len(largest)):
            largest[d], agent[d] = np.float32(0.0), np.int32(-1)
        for k in range(end[p - 1] if p else 0, end[p]):
            value = values[k]
            for d in range(len(largest)):
                better = value[d] > largest[d]
                agent[d] = np.int32(k) if better else agent[d]
                largest[d] = value[d] if better else largest[d]


@compiled
def _backward(hidden, end, second, winner, gradient, to_own, to_hidden, to_second, to_bias):
    """Write the gradients; `to_second` [PARTS, out, in] and `to_bias` are sums over parts."""
    rows, width = winner.shape
    parts = len(to_bias)
    for part in prange(parts):
        sum_second, sum_bias = to_second[part], to_bias[part]
        sum_second[:], sum_bias[:] = np.float32(0.0), np.float32(0.0)
        for p in range(rows * part // parts, rows * (part + 1) // parts):
            begin = end[p - 1] if p else 0
            to_hidden[begin : end[p]] = np.float32(0.0)
            for d in range(width):
                k, g = winner[p, d], gradient[p, d]
                if k >= 0 and g != 0.0:
                    h, to_h, w, to_w = hidden[k], to_hidden[k], second[d], sum_second[d]
                    sum_bias[d] += g
                    for i in range(width):
                        to_w[i] += g * h[i]
                    for i in range(width):
                        to_h[i] += g * w[i]
            total = to_own[p]
            total[:] = np.float32(0.0)
            for k in range(begin, end[p]):
                h, to_h = hidden[k], to_hidden[k]
                for i in range(width):
                    to_h[i] = to_h[i] if h[i] > 0.0 else np.float32(0.0)
                    total[i] += to_h[i]


def _launch(
    own: NDArray,
    agents: NDArray,
    end: NDArray,
    first: NDArray,
    second: NDArray,
    bias: NDArray,
    pooled: NDArray,
    winner: NDArray,
    hidden: NDArray,
) -> None:
    h = torch.from_numpy(hidden)
    torch.mm(torch.from_numpy(agents), torch.from_numpy(first).t(), out=h)
    _first_layer(own, end, hidden)
    values = torch.addmm(torch.from_numpy(bias), h, torch.from_numpy(second).t())
    _largest(values.numpy(), end, pooled, winner)


def _empty(
    own: Tensor, agents: Tensor, end: Tensor, first: Tensor, second: Tensor, bias: Tensor
) -> tuple[Tensor, Tensor, Tensor]:
    """Allocate the maxima, the agents that have them, and the first layer's outputs."""
    rows, width = own.shape
    return (
        own.new_empty(rows, width),
        own.new_empty(rows, width, dtype=torch.int32),
        own.new_empty(len(agents), width),
    )


def _empty_gradients(
    hidden: Tensor, end: Tensor, second: Tensor, winner: Tensor, gradient: Tensor
) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    return (
        hidden.new_empty(gradient.shape),
        hidden.new_empty(hidden.shape),
        hidden.new_empty(PARTS, *second.shape),
        hidden.new_empty(PARTS, len(second)),
    )


def _gradient(
    agents: Tensor,
    end: Tensor,
    second: Tensor,
    winner: Tensor,
    hidden: Tensor,
    gradient: Tensor,
) -> tuple[Any, ...]:
    to_own, to_hidden, to_second, to_bias = _gradients.op(hidden, end, second, winner, gradient)
    to_first = to_hidden.t() @ agents
    return to_own, None, None, to_first, to_second.sum(0), to_bias.sum(0)


_pooling = Operator(
    "set_pooling",
    "(Tensor own, Tensor agents, Tensor end, Tensor first, Tensor second, Tensor bias)"
    " -> (Tensor, Tensor, Tensor)",
    _empty,
    _launch,
)
_gradients = Operator(
    "set_pooling_backward",
    "(Tensor hidden, Tensor end, Tensor second, Tensor winner, Tensor gradient)"
    " -> (Tensor, Tensor, Tensor, Tensor)",
    _empty_gradients,
    _backward,
)
_pooling.register_gradient(
    lambda inputs, outputs: (inputs[1], inputs[2], inputs[4], outputs[1], outputs[2]), _gradient
)
