"""E worlds of N robots and M humans in flat arrays.

The letters of every shape in this package: E worlds, N robots, M humans, A numbers per action.
Units are metres, seconds and radians; positions are in the world frame, observations in the body
frame of the robot that makes them (x ahead, y to the left).
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from mrsan.features import EGO_FEATURES, OTHER_FEATURES
from mrsan.fields import ConfigurationError
from mrsan.kernels.sensing import observe
from mrsan.kernels.spawn import NO_ROOM_FOR_ROBOTS, begin_episodes
from mrsan.kernels.step import advance
from mrsan.kernels.tally import TALLY
from mrsan.kernels.team import tell
from mrsan.lookahead import LookaheadReward
from mrsan.metrics import Episodes, episodes_of
from mrsan.parameters import Sensor, kernel_parameters
from mrsan.reward import RewardParts
from mrsan.scenario import Scenario
from mrsan.state import Bools, Floats, Ints, State

_INTERRUPTIBLE = 128  # worlds that begin an episode between two chances to stop with Ctrl-C


class ActionError(ValueError):
    """An action that cannot be executed; the message says whose and why."""


class Observation(NamedTuple):
    """What every robot knows. Slots belong to identities; what is not visible is zero.

    With team perception "visible" is also what team-mates see; the last two masks say what a robot
    was only told. Without, they are empty.
    """

    ego: Floats  # [E, N, 11], EGO_FEATURES
    humans: Floats  # [E, N, M, 5], OTHER_FEATURES
    humans_visible: Bools  # [E, N, M]
    robots: Floats  # [E, N, N - 1, 5], the others in the order of their numbers
    robots_visible: Bools  # [E, N, N - 1]
    humans_told: Bools  # [E, N, M] or [E, N, 0]
    robots_told: Bools  # [E, N, N - 1] or [E, N, 0]

    @property
    def known(self) -> tuple[Floats, Floats, Bools, Floats, Bools]:
        """What planners ask for: all but who saw it."""
        return self[:5]

    def of_worlds(self, worlds: Ints | Bools) -> Observation:
        """The rows of some worlds, copied."""
        return Observation._make(rows[worlds] for rows in self)


class Step(NamedTuple):
    """What one step of all worlds led to."""

    observation: Observation
    reward: Floats  # [E, N]
    reward_parts: RewardParts  # what it is the sum of
    terminated: Bools  # [E]
    truncated: Bools  # [E]
    # With auto-reset, of the worlds that ended in this step, in order (None if there are none):
    final_observation: Observation | None
    finished: Episodes | None


class World:
    """E independent worlds, stepped together.

    Examples:
        >>> world = World(Scenario(humans=5), worlds=2)
        >>> observation = world.reset(cases=[0, 1])
        >>> step = world.step(np.zeros((2, 3, 3), np.float32))
        >>> step.reward.shape
        (2, 3)
    """

    def __init__(self, scenario: Scenario, worlds: int = 1, auto_reset: bool = False) -> None:
        """Make room for `worlds` worlds.

        Raises:
            ConfigurationError: the scenario names a recording or a predictor that cannot be used.

        Args:
            scenario: the numbers of the task.
            worlds: E.
            auto_reset: begin the next episode of a world as soon as one ends; `Step` then keeps
                the last observation and the record of what ended. Without it a world that has
                ended stands still until it is reset.
        """
        if not isinstance(scenario, Scenario):
            raise TypeError(f"scenario is {scenario!r}; it must be a Scenario")
        if not isinstance(worlds, int | np.integer) or worlds < 1:
            raise ValueError(f"worlds is {worlds!r}; it must be a whole number of at least 1")
        self.scenario = scenario
        self.worlds = worlds
        self.auto_reset = auto_reset
        self._lookahead = LookaheadReward(scenario) if scenario.reward.lookahead else None
        looked_back = self._lookahead.predictor.history if self._lookahead else 0
        self.state = _empty_state(worlds, scenario, looked_back)
        self._parameters = kernel_parameters(scenario)
        self._recording = scenario.load_recording()
        self._sensor = Sensor.of(self._parameters)
        self._all_seeing = Sensor.of(kernel_parameters(_without_limits(scenario)))

    def reset(self, cases: ArrayLike | None = None, worlds: ArrayLike | None = None) -> Observation:
        """Begin an episode in every world, or in some.

        Args:
            cases: [E] case numbers. None: the next episode of the case each world has.
            worlds: [E] bool, the worlds to reset. None: all.

        Returns:
            The observation of all worlds.

        Raises:
            ConfigurationError: a case has no room for all robots or people of the scenario.
        """
        mask = self._mask(worlds)
        if cases is not None:
            numbers = np.asarray(cases)
            if numbers.shape != (self.worlds,) or not np.issubdtype(numbers.dtype, np.integer):
                raise ValueError(
                    f"cases is {cases!r}; it must be {self.worlds} whole numbers, one per world"
                )
            if (numbers < 0).any():
                raise ValueError(f"case is {numbers.min()}; it must be 0 or more")
            self.state.case[mask] = numbers[mask]
            self.state.episode[mask] = 0
        else:
            self.state.episode[mask] += 1
        self._begin(mask)
        return self.observe()

    def _begin(self, worlds: Bools) -> None:
        """Begin the episode that the state names in some worlds [E]."""
        numbers = np.flatnonzero(worlds)
        for first in range(0, len(numbers), _INTERRUPTIBLE):
            group = np.zeros_like(worlds)
            group[numbers[first : first + _INTERRUPTIBLE]] = True
            self._place_agents(group)
        if self._lookahead:
            self._lookahead.begin(self.state, worlds)

    def _place_agents(self, worlds: Bools) -> None:
        """Draw the starts and goals of everybody in some worlds [E]."""
        problem = np.zeros(self.worlds, np.int8)
        begin_episodes(self.worlds, worlds, self.state, self._parameters, self._recording, problem)
        if problem.any():
            world = int(np.flatnonzero(problem)[0])
            robots = problem[world] == NO_ROOM_FOR_ROBOTS
            raise ConfigurationError(
                self.scenario.describe_shortage(robots, int(self.state.case[world]))
            )

    def snapshot(self) -> State:
        """The whole state of all worlds, copied: what `restore` goes back to.

        Random numbers are drawn from the case, episode and step, so nothing else is to be kept.
        """
        return State._make(array.copy() for array in self.state)

    def restore(self, snapshot: State, worlds: ArrayLike | None = None) -> None:
        """Put worlds back into the state they had; the same actions then lead to the same bits.

        `observe()` gives what the robots see there.

        Args:
            snapshot: the state of E worlds, of this or of another `World` of the same shapes; it
                is copied and may be restored again.
            worlds: [E] bool, which worlds. None: all.

        Raises:
            TypeError: it is not a `State`.
            ValueError: an array has another shape or type, or worlds are not E booleans.
        """
        mask = self._mask(worlds)
        if not isinstance(snapshot, State):
            raise TypeError(f"snapshot is a {type(snapshot).__name__}; it must be a State")
        for name, mine in self.state._asdict().items():  # before anything is written
            kept = np.asarray(getattr(snapshot, name))
            if kept.shape != mine.shape:
                raise ValueError(
                    f"snapshot.{name} has shape {kept.shape}; it must have {mine.shape}"
                )
            if kept.dtype != mine.dtype:
                raise ValueError(f"snapshot.{name} is of {kept.dtype}; it must be of {mine.dtype}")
        for name, mine in self.state._asdict().items():
            mine[mask] = getattr(snapshot, name)[mask]

    def observe(self, all_seeing: bool = False) -> Observation:
        """What every robot sees now, in fresh arrays.

        Args:
            all_seeing: what a robot would see without any limit or noise: for central critics.
        """
        scenario, others = self.scenario, len(OTHER_FEATURES)
        robots = (self.worlds, scenario.robots)
        told = scenario.team_tracks and not all_seeing
        observation = Observation(
            ego=np.empty((*robots, len(EGO_FEATURES)), np.float32),
            humans=np.empty((*robots, scenario.humans, others), np.float32),
            humans_visible=np.empty((*robots, scenario.humans), np.bool_),
            robots=np.empty((*robots, scenario.robots - 1, others), np.float32),
            robots_visible=np.empty((*robots, scenario.robots - 1), np.bool_),
            humans_told=np.empty((*robots, scenario.humans * told), np.bool_),
            robots_told=np.empty((*robots, (scenario.robots - 1) * told), np.bool_),
        )
        everywhere = np.ones(self.worlds, np.bool_)
        if all_seeing:
            observe(self.worlds, everywhere, self.state, self._all_seeing, *observation.known)
        else:
            self._look(observation, everywhere)
        return observation

    def _look(self, observation: Observation, worlds: Bools) -> None:
        """Write what the robots of some worlds [E] see and are told."""
        observe(self.worlds, worlds, self.state, self._sensor, *observation.known)
        if self._parameters.team_tracks:
            tell(self.worlds, worlds, self.state, self._parameters, *observation[1:])

    def step(self, actions: ArrayLike) -> Step:
        """Move every world by one time step.

        Args:
            actions: [E, N, A] in [-1, 1]; those of parked robots and ended worlds have no effect.

        Raises:
            ActionError: an action is not a number, out of range or of the wrong shape.
        """
        state = self.state
        if (state.episode < 0).any():
            number = int(np.flatnonzero(state.episode < 0)[0])
            raise RuntimeError(f"world {number} has not been reset; call reset() before step()")
        action = self._checked(actions)
        reward = np.empty(action.shape[:2], np.float32)
        terms = np.zeros((len(RewardParts._fields), *reward.shape), np.float32)
        going = ~state.done
        advance(self.worlds, state, action, self._parameters, self._recording, reward, terms)
        parts = RewardParts(*terms)
        observation = self.observe()
        if self._lookahead:
            self._look_ahead(self._lookahead, observation, going, reward, parts)
        terminated, truncated = state.terminated.copy(), state.truncated.copy()
        done = terminated | truncated
        if not (self.auto_reset and done.any()):
            return Step(observation, reward, parts, terminated, truncated, None, None)
        final = observation.of_worlds(np.flatnonzero(done))
        finished = episodes_of(state, self.scenario, done)
        state.episode[done] += 1
        self._begin(done)
        self._look(observation, done)
        return Step(observation, reward, parts, terminated, truncated, final, finished)

    def _look_ahead(
        self, lookahead: LookaheadReward, observation: Observation, going: Bools,
        reward: Floats, parts: RewardParts,
    ) -> None:  # fmt: skip
        """Add what is paid for the near future to the reward of the worlds [E] that moved."""
        lookahead.follow(self.state, going)
        seen = observation.humans_visible
        if self.scenario.team_tracks:  # by itself: what it was only told does not count
            seen = seen & ~observation.humans_told
        parts.lookahead[going] = lookahead.reward(self.state, seen)[going]
        reward += parts.lookahead

    def _mask(self, worlds: ArrayLike | None) -> Bools:
        mask = np.ones(self.worlds, np.bool_) if worlds is None else np.asarray(worlds)
        if mask.shape != (self.worlds,) or mask.dtype != np.bool_:
            raise ValueError(f"worlds is {worlds!r}; it must be {self.worlds} booleans")
        return mask

    def _checked(self, actions: ArrayLike) -> Floats:
        try:
            action = np.ascontiguousarray(actions, np.float32)
        except (TypeError, ValueError) as error:
            raise ActionError(f"actions are not an array of numbers ({error})") from error
        shape = (self.worlds, self.scenario.robots, self.scenario.action_size)
        if action.shape != shape:
            raise ActionError(f"actions have shape {action.shape}; they must have {shape}")
        if not (np.abs(action) <= 1.0).all():  # also False for NaN
            e, n = np.argwhere(~(np.abs(action) <= 1.0).all(-1))[0]
            raise ActionError(
                f"action of robot {n} in world {e} is {action[e, n].tolist()}; "
                "every element must lie in [-1, 1]"
            )
        return action


def _without_limits(scenario: Scenario) -> Scenario:
    """The same scenario with a perfect sensor."""
    return replace(
        scenario,
        fov_degrees=360.0,
        sensing_range=1000.0,
        occlusion=False,
        position_noise=0.0,
        velocity_noise=0.0,
        radius_noise=0.0,
        missed_detection=0.0,
    )


def _empty_state(e: int, scenario: Scenario, looked_back: int) -> State:
    """Room for E worlds, with so many past positions of people."""
    f, n, m = np.float32, scenario.robots, scenario.humans
    telling = scenario.team_tracks
    kept = scenario.team_delay_steps + 1 if telling else 0
    return State(
        case=np.arange(e, dtype=np.int64),
        episode=np.full(e, -1, np.int64),
        key=np.zeros(e, np.uint64),
        clock=np.zeros(e, np.int32),
        terminated=np.zeros(e, np.bool_),
        truncated=np.zeros(e, np.bool_),
        human_present=np.zeros((e, m), np.bool_),
        human_entry=np.zeros((e, m), np.int32),
        human_track=np.full((e, m), -1, np.int32),
        record_step=np.zeros(e, np.int32),
        human_position=np.zeros((e, m, 2), f),
        human_velocity=np.zeros((e, m, 2), f),
        human_goal=np.zeros((e, m, 2), f),
        human_past=np.zeros((e, m, looked_back, 2), f),
        human_past_known=np.zeros((e, m, looked_back), np.bool_),
        human_radius=np.zeros((e, m), f),
        human_speed=np.zeros((e, m), f),
        robot_position=np.zeros((e, n, 2), f),
        robot_velocity=np.zeros((e, n, 2), f),
        robot_heading=np.zeros((e, n), f),
        robot_goal=np.zeros((e, n, 2), f),
        robot_start=np.zeros((e, n, 2), f),
        arrived=np.zeros((e, n), np.bool_),
        collision=np.zeros((e, n), np.int8),
        last_contact=np.full((e, n, m + n), -1, np.int32),
        robot_acceleration=np.zeros((e, n, 2), f),
        tally=np.zeros((e, n, len(TALLY)), f),
        said=np.zeros((e, kept, n, m + n, len(OTHER_FEATURES)), f),
    )
