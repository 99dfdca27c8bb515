"""Decisions of robots before passages: each has its own time axis.

A robot chooses at events (see `samarl.planning.right_of_way`), so the decisions of a team are not
simultaneous. A decision earns the team's rewards until the same robot's next one, discounted over
its duration, or until the end of the episode.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mrsan import ConfigurationError, Split, World
from mrsan.metrics import Episodes, episodes_of
from samarl.agents.agent import Agent, act_and_tell
from samarl.agents.learned import Learned
from samarl.agents.planners.right_of_way import RightOfWay, Robots
from samarl.agents.shielded import Shielded
from samarl.macro_level.settings import MacroRewards
from samarl.planning.passage_features import MATE, OWN, TRUTH

Floats = NDArray[np.float32]
Choose = Callable[[Floats, Floats], tuple[NDArray[np.int64], Floats]]

_LONGEST_PROGRESS = 0.5  # m, per step and robot


def guide_of(agent: Agent) -> RightOfWay:
    """Return what tells the robots of an agent who goes first.

    Raises:
        ConfigurationError: nobody does, or there are no walls.
    """
    inner = agent.agent if isinstance(agent, Shielded) else agent
    guide = inner.guide if isinstance(inner, Learned) else inner
    if not isinstance(guide, RightOfWay):
        raise ConfigurationError(
            "the driver has no right of way here; it must be right_of_way, or a policy with "
            "right_of_way=rule among walls"
        )
    return guide


class Decisions(NamedTuple):
    """The decisions of a rollout: slots 0 to `number` - 1 of each robot, oldest first."""

    own: Floats  # [E, N, K, OWN]
    mates: Floats  # [E, N, K, N - 1, MATE]
    truth: Floats  # [E, N, K, N - 1, MATE + TRUTH]
    choice: NDArray[np.int64]  # [E, N, K]
    log_prob: Floats  # [E, N, K]
    reward: NDArray[np.float64]  # [E, N, K] of the team, discounted to the moment of the decision
    duration: NDArray[np.int64]  # [E, N, K] steps
    ended: NDArray[np.bool_]  # [E, N, K] the episode ended before the next decision
    number: NDArray[np.int64]  # [E, N] filled slots; the last decision may not be over yet

    @property
    def is_filled(self) -> NDArray[np.bool_]:
        """Return which slots hold a decision, [E, N, K]."""
        filled: NDArray[np.bool_] = np.arange(self.choice.shape[2]) < self.number[..., None]
        return filled

    @property
    def is_over(self) -> NDArray[np.bool_]:
        """Return which slots hold a decision with all its rewards, [E, N, K]."""
        over: NDArray[np.bool_] = np.arange(self.choice.shape[2]) < self.number[..., None] - 1
        return over | (self.ended & self.is_filled)


class Collector:
    """Drives a team in worlds of one scenario and records its decisions before passages."""

    def __init__(
        self,
        agent: Agent,
        worlds: int,
        rollout: int,
        first_case: int,
        rewards: MacroRewards,
        discount: float,
    ) -> None:
        """Begin episodes in `worlds` worlds, from a training case on.

        Raises:
            ConfigurationError: nobody tells robots of `agent` who goes first.
        """
        self.agent, self.scenario, self.rewards = agent, agent.scenario, rewards
        self.guide = guide_of(agent)
        self.guide.chooser = self._decide
        self.rollout, self.discount = rollout, discount
        self.world = World(self.scenario, worlds)
        cases = Split.training.case(first_case) + np.arange(worlds, dtype=np.int64)
        self._next_case = int(cases[-1]) + 1
        self._observation = self.world.reset(cases)
        self._is_init = np.ones(worlds, np.bool_)
        e, n, k = worlds, self.scenario.robots, rollout + 2
        self.decisions = Decisions(
            own=np.zeros((e, n, k, OWN), np.float32),
            mates=np.zeros((e, n, k, n - 1, MATE), np.float32),
            truth=np.zeros((e, n, k, n - 1, MATE + TRUTH), np.float32),
            choice=np.zeros((e, n, k), np.int64),
            log_prob=np.zeros((e, n, k), np.float32),
            reward=np.zeros((e, n, k)),
            duration=np.zeros((e, n, k), np.int64),
            ended=np.zeros((e, n, k), np.bool_),
            number=np.zeros((e, n), np.int64),
        )

    def collect(self, choose: Choose) -> list[Episodes]:
        """Fill `decisions` with the next rollout; return the episodes that ended.

        Args:
            choose: returns choices [B] and their log-probabilities for own numbers [B, OWN] and
                those of mates [B, N - 1, MATE].
        """
        self._choose = choose
        self._keep_open_decisions()
        finished = []
        for _ in range(self.rollout):
            if self._is_init.any():
                self.agent.reset(self._is_init)
            action = act_and_tell(self.agent, self._observation, self.world)
            ended = self._step(action)
            self._is_init = ended
            if ended.any():
                finished.append(episodes_of(self.world.state, self.scenario, ended))
                cases = self.world.state.case.copy()
                cases[ended] = self._next_case + np.arange(ended.sum())
                self._next_case += int(ended.sum())
                self._observation = self.world.reset(cases, ended)
        return finished

    def _decide(self, due: Robots) -> NDArray[np.int64]:
        """Choose for the robots that have to, and begin their records."""
        own, mates, truth = self.guide.features()
        choice, log_prob = self._choose(own[due], mates[due])
        d = self.decisions
        slot = (*due, d.number[due])
        d.own[slot], d.mates[slot], d.truth[slot] = own[due], mates[due], truth[due]
        d.choice[slot], d.log_prob[slot] = choice, log_prob
        d.reward[slot], d.duration[slot], d.ended[slot] = 0.0, 0, False
        d.number[due] += 1
        return choice

    def _step(self, action: Floats) -> NDArray[np.bool_]:
        """Advance the worlds, and add the team's reward to the decisions that go on."""
        state, d = self.world.state, self.decisions
        arrived, left = state.arrived.copy(), np.where(state.arrived, 0.0, state.route_left)
        step = self.world.step(action)
        self._observation = step.observation
        ended = step.terminated | step.truncated
        reward = self._reward(arrived, left, ended)
        robot = np.nonzero(d.number > 0)
        slot = (*robot, d.number[robot] - 1)
        goes_on = ~d.ended[slot]
        slot = tuple(index[goes_on] for index in slot)
        d.reward[slot] += self.discount ** d.duration[slot] * reward[slot[0]]
        d.duration[slot] += 1
        d.ended[slot] |= ended[slot[0]]
        return ended

    def _reward(
        self,
        arrived: NDArray[np.bool_],
        left: NDArray[np.float64],
        ended: NDArray[np.bool_],
    ) -> NDArray[np.float64]:
        """Return the team's reward [E] of the step."""
        state, r = self.world.state, self.rewards
        left_now = np.where(state.arrived, 0.0, state.route_left)
        progress = np.clip(left - left_now, -_LONGEST_PROGRESS, _LONGEST_PROGRESS).sum(1)
        new = (state.arrived & ~arrived).sum(1)
        drives = (~state.arrived).mean(1)
        collided = (state.collision != 0).any(1)
        success = state.arrived.all(1) & ~collided
        reward = r.progress * progress + r.arrival * new + r.time * (0.5 + 0.5 * drives)
        at_end = r.success * success + r.collision * collided
        total: NDArray[np.float64] = reward + ended * at_end
        return total

    def _keep_open_decisions(self) -> None:
        """Move the decisions that go on to the first slots, and forget the others."""
        d = self.decisions
        open_ = d.is_filled & ~d.is_over
        robot = np.nonzero(open_.any(2))
        last = (*robot, d.number[robot] - 1)
        first = (*robot, np.zeros(len(robot[0]), np.int64))
        for array in d[:-1]:
            array[first] = array[last]
        d.number[:] = open_.any(2)
