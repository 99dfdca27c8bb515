"""What a robot is paid for where it and the people are heading (MSA3C, Eq. 3-4)."""

from __future__ import annotations

import numpy as np

from mrsan.prediction import find_predictor
from mrsan.scenario import Scenario
from mrsan.state import Bools, Floats, State


class LookaheadReward:
    """The K-step lookahead reward; people by a predictor, the robot at constant velocity.

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
        self.weight = reward.lookahead
        self.steps = np.arange(1, reward.lookahead_steps + 1, dtype=np.float32)[:, None]
        self.time_step = np.float32(scenario.time_step)

    def begin(self, state: State, worlds: Bools) -> None:
        """Know of the people only where they are now, in the worlds [E] where an episode begins."""
        state.human_past_known[worlds] = False
        self._add(state, worlds)

    def follow(self, state: State, worlds: Bools) -> None:
        """Take in where the people are after a step of some worlds [E]."""
        for array in (state.human_past, state.human_past_known):
            array[worlds, :, :-1] = array[worlds, :, 1:]
        self._add(state, worlds)

    def _add(self, state: State, worlds: Bools) -> None:
        state.human_past[worlds, :, -1] = state.human_position[worlds]
        state.human_past_known[worlds, :, -1] = state.human_present[worlds]

    def reward(self, state: State, visible: Bools) -> Floats:
        """What each robot on its way is paid after a step, [E, N]; others nothing.

        -weight * exp(-k) at the first k in 1..K at which somebody in view will be nearer than the
        comfort distance, from surface to surface: the minimum of Eq. 4 over the people.

        Args:
            state: after the step; k counts from there.
            visible: [E, N, M] whom each robot sees.
        """
        people = self.predictor.predict(
            state.human_past, state.human_past_known, state.human_velocity, len(self.steps)
        )  # [E, M, K, 2]
        ahead = state.robot_velocity[..., None, :] * (self.steps * self.time_step)
        robots = state.robot_position[..., None, :] + ahead  # [E, N, K, 2]
        apart = people[:, None] - robots[:, :, None]  # [E, N, M, K, 2]
        near = state.human_radius + np.float32(self.radius) + self.distance  # [E, M]
        squared = apart[..., 0] * apart[..., 0] + apart[..., 1] * apart[..., 1]
        intrudes = (squared < (near * near)[:, None, :, None]) & visible[..., None]
        when = intrudes.any(2)  # [E, N, K]
        touches = (state.last_contact == state.clock[:, None, None]).any(-1)
        driving = ~state.arrived & ~touches
        paid = (-self.weight * np.exp(-self.steps[:, 0])).astype(np.float32)
        return np.where(when.any(-1) & driving, paid[when.argmax(-1)], np.float32(0.0))
