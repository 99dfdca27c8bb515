"""A reward for where robots and people are heading (MSA3C, Eq. 3-4)."""

from __future__ import annotations

import math

import numpy as np

from mrsan.prediction import checked_prediction, find_predictor
from mrsan.scenario import Scenario
from mrsan.state import Bools, Floats, State


class LookaheadReward:
    """The K-step lookahead reward: people follow a predictor, robots constant velocity.

    The people's last positions are part of the state (`State.human_past`).
    """

    def __init__(self, scenario: Scenario) -> None:
        """Find the predictor.

        Raises:
            ConfigurationError: there is no such predictor.
        """
        reward, self.radius = scenario.reward, scenario.robot_radius
        field = "scenario.reward.lookahead_predictor"
        self.predictor = find_predictor(reward.lookahead_predictor, scenario.time_step, field)
        self.distance = np.float32(reward.lookahead_distance)
        steps = range(1, reward.lookahead_steps + 1)
        self._penalty = np.array([-reward.lookahead * math.exp(-k) for k in steps], np.float32)
        self.steps = np.arange(1, reward.lookahead_steps + 1, dtype=np.float32)[:, None]
        self.time_step = np.float32(scenario.time_step)

    def begin(self, state: State, worlds: Bools) -> None:
        """Begin the history of the people in the worlds [E] in which an episode begins."""
        state.human_past_valid[worlds] = False
        self._add(state, worlds)

    def update(self, state: State, worlds: Bools) -> None:
        """Append the positions of the people after a step of some worlds [E]."""
        for array in (state.human_past, state.human_past_valid):
            array[worlds, :, :-1] = array[worlds, :, 1:]
        self._add(state, worlds)

    def _add(self, state: State, worlds: Bools) -> None:
        state.human_past[worlds, :, -1] = state.human_position[worlds]
        state.human_past_valid[worlds, :, -1] = state.human_present[worlds]

    def reward(self, state: State, visible: Bools) -> Floats:
        """Return the reward of each robot after a step, [E, N]; zero for parked and touching ones.

        It is -weight * exp(-k) at the first k in 1..K at which a visible person will be closer than
        the lookahead distance, from surface to surface: the minimum of Eq. 4 over the people.

        Args:
            state: after the step; k counts from there.
            visible: [E, N, M] the people that each robot sees.
        """
        people = checked_prediction(
            self.predictor,
            state.human_past,
            state.human_past_valid,
            state.human_velocity,
            len(self.steps),
            state,
        )  # [E, M, K, 2]
        ahead = state.robot_velocity[..., None, :] * (self.steps * self.time_step)
        robots = state.robot_position[..., None, :] + ahead  # [E, N, K, 2]
        offset = people[:, None] - robots[:, :, None]  # [E, N, M, K, 2]
        limit = state.human_radius + np.float32(self.radius) + self.distance  # [E, M]
        squared = offset[..., 0] * offset[..., 0] + offset[..., 1] * offset[..., 1]
        too_close = (squared < (limit * limit)[:, None, :, None]) & visible[..., None]
        at_step = too_close.any(2)  # [E, N, K]
        touching = (state.last_contact == state.clock[:, None, None]).any(-1)
        driving = ~state.arrived & ~touching
        first = self._penalty[at_step.argmax(-1)]
        return np.where(at_step.any(-1) & driving, first, np.float32(0.0))
