"""Custom terms of the reward, by the names that scenarios use.

A user's module registers a function with `register_reward_term`, and commands import that module
with `plugins=[module]`. `Reward.terms` holds the weights of the terms.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar

import numpy as np
from numpy.typing import ArrayLike

from mrsan.plugin_values import as_numbers, check_finite, check_shape
from mrsan.reward import REWARD_TERMS
from mrsan.scenario import Scenario
from mrsan.state import Bools, Floats, State

F = TypeVar("F", bound="Callable[[State, Scenario], ArrayLike]")


def register_reward_term(name: str) -> Callable[[F], F]:
    """Return a decorator that registers a function as a term of the reward.

    The function takes the `mrsan.State` of all worlds after a step, which it must not change, and
    the scenario; it returns the term of every robot, [E, N]. Times its weight in
    `Scenario.reward.terms`, it is added to the reward of the robots that had not arrived before the
    step. `RewardParts.custom` is the sum of all such terms.

    Args:
        name: key in `Scenario.reward.terms`, an identifier. A later term of the same name replaces
            an earlier one.

    Raises:
        ValueError: the name is not an identifier.

    Examples:
        >>> @register_reward_term("speed")
        ... def speed(state, scenario):
        ...     return np.linalg.norm(state.robot_velocity, axis=-1)
    """
    if not name.isidentifier():
        raise ValueError(f"the name of a reward term is {name!r}; it must be an identifier")

    def register(function: F) -> F:
        REWARD_TERMS[name] = function
        return function

    return register


def sum_of_terms(state: State, scenario: Scenario, driving: Bools) -> Floats:
    """Return the weighted sum of the custom terms after a step, [E, N]; zero where not `driving`.

    Raises:
        PluginError: a term has another shape, or it or the sum is not finite.
    """
    total = np.zeros(driving.shape, np.float32)
    for name, weight in scenario.reward.terms.items():
        term = as_numbers(f"reward term {name}", REWARD_TERMS[name](state, scenario))
        check_shape(f"reward term {name}", term.shape, total.shape)
        check_finite(f"reward term {name}", term, state, driving)
        with np.errstate(over="ignore"):  # reported by the last check
            total[driving] += np.float32(weight) * term[driving]
    check_finite("the weighted sum of the reward terms", total, state)
    return total
