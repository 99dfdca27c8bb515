"""A recurrent network that says how people will turn, speed up and slow down.

A gated recurrent unit (Cho et al., 2014) reads a person's velocities in the person's own frame and
then goes on by itself: each step it adds a change of velocity and reads the velocity that this
gives. x / (1 + |x|) takes the place of the sigmoid and of tanh: it is a fifth of the time, and the
same on every processor. A person is a loop of its own, so nothing depends on who else is asked for.
"""

import numpy as np
from numba import prange

from mrsan.kernels import function, kernel

_ZERO = np.float32(0.0)
_HALF = np.float32(0.5)
_ONE = np.float32(1.0)


@kernel
def swerve(chunks, velocities, known, w_input, w_hidden, bias, w_output, time_step, out):
    """By how much people will be elsewhere than at constant velocity.

    Args:
        chunks: number of pieces the loop over people is cut into.
        velocities: [P, L, 2] of the last L steps in the person's own frame, m/s; the last is now.
        known: [P, L] bool; what is not known is not read.
        w_input: [2, 3 H] of the update gate, the reset gate and the candidate.
        w_hidden: [H, 3 H] likewise.
        bias: [3 H] likewise.
        w_output: [H, 2] to the change of velocity in a step, m/s.
        time_step: s.
        out: [P, K, 2], written: the displacement in the own frame after 1..K steps, m.
    """
    total, length, size = velocities.shape[0], velocities.shape[1], w_hidden.shape[0]
    for chunk in prange(chunks):
        hidden = np.empty(size, np.float32)
        gates = np.empty(3 * size, np.float32)
        recurrent = np.empty(3 * size, np.float32)
        for p in range(chunk * total // chunks, (chunk + 1) * total // chunks):
            hidden[:] = _ZERO
            for t in range(length):
                if known[p, t]:
                    x, y = velocities[p, t, 0], velocities[p, t, 1]
                    _read(x, y, w_input, w_hidden, bias, gates, recurrent, hidden)
            vx = vy = px = py = _ZERO
            for k in range(out.shape[1]):
                if k > 0:
                    x, y = velocities[p, -1, 0] + vx, velocities[p, -1, 1] + vy
                    _read(x, y, w_input, w_hidden, bias, gates, recurrent, hidden)
                for i in range(size):
                    vx += w_output[i, 0] * hidden[i]
                    vy += w_output[i, 1] * hidden[i]
                px += vx * time_step
                py += vy * time_step
                out[p, k, 0], out[p, k, 1] = px, py


@function
def _read(x, y, w_input, w_hidden, bias, gates, recurrent, hidden):
    """One step of the unit: `hidden` after it has read the velocity (x, y)."""
    size = hidden.shape[0]
    for o in range(3 * size):
        gates[o] = bias[o] + w_input[0, o] * x + w_input[1, o] * y
        recurrent[o] = _ZERO
    for i in range(size):
        h = hidden[i]
        for o in range(3 * size):
            recurrent[o] += w_hidden[i, o] * h
    for i in range(size):
        update = _gate(gates[i] + recurrent[i])
        reset = _gate(gates[size + i] + recurrent[size + i])
        candidate = _squash(gates[2 * size + i] + reset * recurrent[2 * size + i])
        hidden[i] = candidate + update * (hidden[i] - candidate)


@function
def _squash(x):
    return x / (_ONE + abs(x))


@function
def _gate(x):
    return _HALF + _HALF * _squash(x)
