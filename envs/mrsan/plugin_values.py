"""Checks of what plugins return: shape and finiteness, with the place of the first fault."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from mrsan.state import State


class PluginError(ValueError):
    """A plugin returned values that cannot be used; the message names it, the step and the place.

    Plugins are crowd models, reward terms, sensors, predictors, agents and metrics of users.
    """


def as_numbers(plugin: str, values: Any) -> NDArray[np.float32]:
    """Return what a plugin returned as an array.

    Raises:
        PluginError: it is not an array of numbers.
    """
    try:
        return np.asarray(values, np.float32)
    except (TypeError, ValueError) as error:
        raise PluginError(f"{plugin} is {values!r:.60}; it must be numbers ({error})") from None


def check_shape(plugin: str, shape: tuple[int, ...], expected: tuple[int, ...]) -> None:
    """Check the shape of what a plugin returned.

    Args:
        plugin: its kind and name, such as `reward term speed`.
        shape: of its values.
        expected: that they must have.

    Raises:
        PluginError: the shapes differ.
    """
    if shape != expected:
        raise PluginError(f"{plugin} has shape {shape}; it must have {expected}")


def check_finite(
    plugin: str,
    values: NDArray[Any],
    state: State | None = None,
    where: NDArray[np.bool_] | None = None,
) -> None:
    """Check that the values of a plugin are finite.

    Args:
        plugin: its kind and name; those of people begin with `crowd` or `predictor`.
        values: checked; [E, K, ...] for K agents if `state` is there.
        state: the worlds, for the message; None: the message has only the index.
        where: the values that count, by their leading axes; None: all.

    Raises:
        PluginError: a value is NaN or infinite.
    """
    if np.isfinite(values).all():  # the usual case costs one pass
        return
    fault = ~np.isfinite(values)
    if where is not None:
        fault &= where.reshape(where.shape + (1,) * (fault.ndim - where.ndim))
    if not fault.any():
        return
    first = np.argwhere(fault)[0].tolist()
    if state is None:
        raise PluginError(f"{plugin} is {values[tuple(first)]} at index {first}; it must be finite")
    world, agent, *index = first
    kind = "person" if plugin.startswith(("crowd", "predictor")) else "robot"
    at = f" at index {index}" if index else ""
    raise PluginError(
        f"{plugin} is {values[(world, agent, *index)]} for {kind} {agent} in world {world}{at}, "
        f"after {state.clock[world]} steps of case {state.case[world]}; it must be finite"
    )
