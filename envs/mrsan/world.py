"""E worlds of N robots and M humans in flat arrays.

The letters of every shape in this package: E worlds, N robots, M humans, A numbers per action.
Units are metres, seconds and radians; positions are in the world frame, observations in the body
frame of the observing robot (x ahead, y to the left).
"""

from __future__ import annotations

import re
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from numba.core.errors import NumbaError
from numpy.typing import ArrayLike, NDArray

from mrsan.choices import Crowd
from mrsan.compile_ahead import compile_missing
from mrsan.crowds import begin_kernel, crowd_model, social_settings, step_kernel
from mrsan.features import OTHER_FEATURES
from mrsan.fields import ConfigurationError
from mrsan.kernels import kernel
from mrsan.kernels.along import PATH_COLUMNS
from mrsan.kernels.places import MOST_ZONES
from mrsan.kernels.routes import CORNER_ROWS
from mrsan.kernels.social_state import SOCIAL
from mrsan.kernels.spawn import NO_ROOM_FOR_ROBOTS
from mrsan.kernels.structs import by_reference
from mrsan.kernels.tally import TALLY
from mrsan.kernels.walls import PLACE_COLUMNS, WALL_ROWS, with_room_for_lanes
from mrsan.lookahead import LookaheadReward
from mrsan.metrics import Episodes, episodes_of
from mrsan.observation import KnownMap, Observation
from mrsan.parameters import kernel_parameters
from mrsan.place import place_parameters
from mrsan.plugin_values import PluginError, check_finite
from mrsan.reward import RewardParts
from mrsan.reward_terms import sum_of_terms
from mrsan.scenario import Scenario
from mrsan.script import Script
from mrsan.sensors.suite import SensorSuite
from mrsan.sensors.team import MESSAGE_FEATURES
from mrsan.state import Bools, Floats, State

_FINITE = (  # arrays of a snapshot
    "robot_position",
    "robot_velocity",
    "robot_heading",
    "robot_goal",
    "human_position",
    "human_velocity",
    "human_goal",
    "human_radius",
    "human_speed",
)
_RESET_BATCH = 128  # worlds that begin an episode between two chances to stop with Ctrl-C


class ActionError(ValueError):
    """An action that cannot be executed; the message says of which robot, and why."""


class Step(NamedTuple):
    """The result of one step of all worlds."""

    observation: Observation
    reward: Floats  # [E, N]
    reward_parts: RewardParts  # the terms of the reward
    terminated: Bools  # [E]
    truncated: Bools  # [E]
    # With auto-reset: of the worlds that ended in this step, in order; None if there are none.
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
        """Create the worlds; `reset` begins their episodes.

        Args:
            scenario: the task.
            worlds: their number E.
            auto_reset: begin the next episode of a world as soon as one ends; `Step` then has the
                last observation and the record of the episode. Without it a world that has ended
                does not move until it is reset.

        Raises:
            ConfigurationError: the scenario names a recording, a case file, a predictor or a crowd
                model that cannot be used.
        """
        if not isinstance(scenario, Scenario):
            raise TypeError(f"scenario is {scenario!r}; it must be a Scenario")
        if not isinstance(worlds, int | np.integer) or worlds < 1:
            raise ValueError(f"worlds is {worlds!r}; it must be a whole number of at least 1")
        self.scenario = scenario
        self.worlds = worlds
        self.auto_reset = auto_reset
        self._lookahead = LookaheadReward(scenario) if scenario.reward.lookahead else None
        history = self._lookahead.predictor.history if self._lookahead else 0
        self._parameters = by_reference(kernel_parameters(scenario))
        self._place = by_reference(place_parameters(scenario.place))
        self._map = by_reference(scenario.fixed_map)
        self.state = _empty_state(worlds, scenario, history)
        crowd = crowd_model(scenario.crowd)
        walled, social = scenario.has_walls, scenario.is_social
        self.script = Script(scenario, worlds) if scenario.case_file else None
        scripted = self.script is not None and scenario.crowd != Crowd.recorded
        self._step_kernel = partial(step_kernel, crowd, walled, social, scripted)
        self._advance = self._step_kernel()
        self._begin_episodes = begin_kernel(walled, social, scenario.crowd == Crowd.recorded)
        crowd_settings = crowd.kernel_settings(scenario)
        self._social = by_reference(social_settings(scenario, crowd_settings))
        self._crowd_settings = self._social or by_reference(crowd_settings)
        self._recording = by_reference(scenario.load_recording())
        self._tracks = self.script.argument if self.script and scripted else self._recording
        self._sensors = SensorSuite(scenario)
        self._privileged = SensorSuite(scenario, privileged=True)
        self._is_compiled = False

    def reset(self, cases: ArrayLike | None = None, worlds: ArrayLike | None = None) -> Observation:
        """Begin an episode in all or some worlds.

        Args:
            cases: [E] case numbers. None: the next episode of each world's case.
            worlds: [E] bool, the worlds to reset. None: all.

        Returns:
            The observation of all worlds.

        Raises:
            ConfigurationError: a case has no room for all robots or people of the scenario.
        """
        if not self._is_compiled:
            compile_missing(self)
            self._is_compiled = True
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
        """Begin the episode `state.episode` in some worlds [E]."""
        self.state.macro_action[worlds] = 0
        numbers = np.flatnonzero(worlds)
        for first in range(0, len(numbers), _RESET_BATCH):
            group = np.zeros_like(worlds)
            group[numbers[first : first + _RESET_BATCH]] = True
            self._place_agents(group)
        if self._lookahead:
            self._lookahead.begin(self.state, worlds)

    def _place_agents(self, worlds: Bools) -> None:
        """Draw the starts and goals of all agents in some worlds [E]."""
        problem = np.zeros(self.worlds, np.int8)
        self._begin_episodes(
            self.worlds,
            worlds,
            self.state,
            self._parameters,
            self._place,
            self._map,
            self._recording,
            self._social,
            problem,
        )
        if problem.any():
            world = int(np.flatnonzero(problem)[0])
            robots = problem[world] == NO_ROOM_FOR_ROBOTS
            raise ConfigurationError(
                self.scenario.describe_shortage(robots, int(self.state.case[world]))
            )
        if self.script:
            self.script.begin(self.state, worlds)

    def call_kernels(self) -> None:
        """Call the kernels of an episode; `mrsan.compile_ahead` lets none of them run."""
        nowhere = np.zeros(self.worlds, np.bool_)
        actions = np.zeros(
            (self.worlds, self.scenario.robots, self.scenario.action_size), np.float32
        )
        self._place_agents(nowhere)
        self._move(self._advance, actions)
        self._sensors.observe(self.state, nowhere, self._sensors.empty(self.worlds))

    def snapshot(self) -> State:
        """Return a copy of the state of all worlds, for `restore`.

        It is complete: random numbers depend only on the case, the episode and the step.
        """
        return State._make(array.copy() for array in self.state)

    def restore(self, snapshot: State, worlds: ArrayLike | None = None) -> None:
        """Restore the state of all or some worlds; the same actions then give the same bits.

        Args:
            snapshot: the state of E worlds, of this or of another `World` with the same shapes; it
                is copied, so it can be restored repeatedly.
            worlds: [E] bool, the worlds to restore. None: all.

        Raises:
            TypeError: the snapshot is not a `State`.
            ValueError: an array has another shape or type, an agent is not somewhere, or `worlds`
                is not E booleans.
        """
        mask = self._mask(worlds)
        if not isinstance(snapshot, State):
            raise TypeError(f"snapshot is a {type(snapshot).__name__}; it must be a State")
        for name, array in self.state._asdict().items():  # before anything is written
            saved = np.asarray(getattr(snapshot, name))
            if saved.shape != array.shape:
                raise ValueError(
                    f"snapshot.{name} has shape {saved.shape}; it must have {array.shape}"
                )
            if saved.dtype != array.dtype:
                raise ValueError(
                    f"snapshot.{name} has type {saved.dtype}; it must have {array.dtype}"
                )
            if name in _FINITE and not np.isfinite(saved[mask]).all():
                raise ValueError(f"snapshot.{name} is NaN or infinite; it must be finite")
        for name, array in self.state._asdict().items():
            array[mask] = getattr(snapshot, name)[mask]

    def __getstate__(self) -> dict[str, Any]:
        """Return what `__setstate__` needs: compiled kernels are found again by the scenario."""
        return {
            "scenario": self.scenario,
            "worlds": self.worlds,
            "auto_reset": self.auto_reset,
            "state": self.snapshot(),
        }

    def __setstate__(self, saved: dict[str, Any]) -> None:
        """Continue where the pickled or copied worlds were."""
        self.__init__(saved["scenario"], saved["worlds"], saved["auto_reset"])  # type: ignore[misc]
        self.restore(saved["state"])

    def observe(self, privileged: bool = False) -> Observation:
        """Return the observations of all robots in new arrays.

        `privileged` is without limits and noise, for central critics.
        """
        sensors = self._privileged if privileged else self._sensors
        observation = sensors.empty(self.worlds)
        sensors.observe(self.state, np.ones(self.worlds, np.bool_), observation)
        if not (self.scenario.has_walls and self.scenario.map_known):
            return observation
        s = self.state
        return observation._replace(map=KnownMap(s.place, s.walls, s.corners, s.corner_distance))

    def tell(self, macro_actions: ArrayLike) -> None:
        """Set what robots tell their team-mates that they are doing, until they tell otherwise.

        They are [E, N] whole numbers from 0 to 2^24, whose meaning is the agent's.

        Raises:
            ValueError: `scenario.team_messages` is false, or these are not such numbers.
        """
        if not self.scenario.team_messages:
            raise ValueError("scenario.team_messages is false; it must be true for World.tell")
        numbers, shape = np.asarray(macro_actions), (self.worlds, self.scenario.robots)
        if numbers.shape != shape or not np.issubdtype(numbers.dtype, np.integer):
            raise ValueError(
                f"macro_actions have shape {numbers.shape} and type {numbers.dtype}; they must be "
                f"{shape} whole numbers"
            )
        outside = numbers[(numbers < 0) | (numbers >= 2**24)]
        if outside.size:
            raise ValueError(f"macro_actions has {outside[0]}; it must lie in [0, 2^24)")
        self.state.macro_action[:] = numbers

    def step(self, actions: ArrayLike) -> Step:
        """Move every world by one time step.

        They are [E, N, A] in [-1, 1]; those of parked robots and ended worlds have no effect.

        Raises:
            ActionError: an action is not a number, is out of range or has the wrong shape.
        """
        motion = self._checked_actions(actions)
        if self.script:
            motion = self.script.act(self.state, motion)
        return self._step(self._advance, motion)

    def step_along(self, paths: ArrayLike) -> Step:
        """Move every world by one time step, its robots along paths from elsewhere.

        A physics engine drives robots this way: people, contacts, arrivals, rewards and records
        are those of `step`. Robots may leave the arena, and walls do not stop them.

        Args:
            paths: [E, N, K, 5] `mrsan.kernels.along.PATH_COLUMNS` of each robot at K evenly spaced
                moments, the last one at the end of the step; between them it moves straight.

        Raises:
            ActionError: a path is not finite or has the wrong shape.
        """
        path = np.ascontiguousarray(paths, np.float32)
        e, n, columns = self.worlds, self.scenario.robots, len(PATH_COLUMNS)
        if path.ndim != 4 or path.shape != (e, n, max(path.shape[2], 1), columns):
            raise ActionError(
                f"paths have shape {path.shape}; they must have ({e}, {n}, K, {columns})"
            )
        if not np.isfinite(path).all():
            e, n = np.argwhere(~np.isfinite(path).all((2, 3)))[0]
            raise ActionError(f"the path of robot {n} in world {e} is not finite; it must be")
        return self._step(self._step_kernel(along_paths=True), path)

    def _step(self, advance: kernel, motion: Floats) -> Step:
        """Move every world by one time step; `motion` is what the kernel `advance` takes."""
        state = self.state
        if (state.episode < 0).any():
            number = int(np.flatnonzero(state.episode < 0)[0])
            raise RuntimeError(f"world {number} has not been reset; call reset() before step()")
        running = ~state.done
        driving = running[:, None] & ~state.arrived
        reward, parts = self._move(advance, motion)
        if self.scenario.crowd not in Crowd.__members__:
            velocity = self.state.human_velocity
            check_finite(f"crowd {self.scenario.crowd}", velocity, state, state.human_present)
        if self.script:
            self.script.change(state, running)
        observation = self.observe()
        if self._lookahead:
            self._add_lookahead(self._lookahead, observation, running, reward, parts)
        if self.scenario.reward.terms:
            parts.custom[:] = sum_of_terms(state, self.scenario, driving)
            reward += parts.custom
        terminated, truncated = state.terminated.copy(), state.truncated.copy()
        done = terminated | truncated
        if not (self.auto_reset and done.any()):
            return Step(observation, reward, parts, terminated, truncated, None, None)
        final = observation.of_worlds(np.flatnonzero(done))
        finished = episodes_of(state, self.scenario, done)
        state.episode[done] += 1
        self._begin(done)
        self._sensors.observe(state, done, observation)
        return Step(observation, reward, parts, terminated, truncated, final, finished)

    def _move(self, advance: kernel, motion: Floats) -> tuple[Floats, RewardParts]:
        """Move every world that has not ended; return the reward [E, N] and its terms."""
        reward = np.empty(motion.shape[:2], np.float32)
        terms = np.zeros((len(RewardParts._fields), *reward.shape), np.float32)
        try:
            advance(
                self.worlds,
                self.state,
                motion,
                self._parameters,
                self._crowd_settings,
                self._tracks,
                reward,
                terms,
            )
        except NumbaError as error:
            if self.scenario.crowd in Crowd.__members__:
                raise
            raise PluginError(
                f"crowd {self.scenario.crowd} cannot be compiled; it must return two numbers, the "
                f"velocity of a person: {_reason(error):.200}"
            ) from None
        return reward, RewardParts(*terms)

    def _add_lookahead(
        self,
        lookahead: LookaheadReward,
        observation: Observation,
        running: Bools,
        reward: Floats,
        parts: RewardParts,
    ) -> None:
        """Add the lookahead term to the reward of the worlds [E] that moved."""
        lookahead.update(self.state, running)
        visible = observation.humans_visible
        if self.scenario.team_tracks:  # people who were only reported do not count
            visible = visible & ~observation.humans_reported
        parts.lookahead[running] = lookahead.reward(self.state, visible)[running]
        reward += parts.lookahead

    def _mask(self, worlds: ArrayLike | None) -> Bools:
        mask = np.ones(self.worlds, np.bool_) if worlds is None else np.asarray(worlds)
        if mask.shape != (self.worlds,) or mask.dtype != np.bool_:
            raise ValueError(f"worlds is {worlds!r}; it must be {self.worlds} booleans")
        return mask

    def _checked_actions(self, actions: ArrayLike) -> Floats:
        shape = (self.worlds, self.scenario.robots, self.scenario.action_size)
        return checked_actions(actions, shape, self.state.clock)


def checked_actions(
    actions: Any, shape: tuple[int, int, int], clock: NDArray[Any], source: str = ""
) -> Floats:
    """Return actions as an array.

    Args:
        actions: [E, N, A] of all robots.
        shape: that they must have.
        clock: [E] the steps of each world so far, for the message.
        source: who chose them, such as `agent orca: `.

    Raises:
        ActionError: an action is not a number, is out of range or has the wrong shape.
    """
    try:
        action = np.ascontiguousarray(actions, np.float32)
    except (TypeError, ValueError) as error:
        raise ActionError(f"{source}actions are not an array of numbers ({error})") from error
    if action.shape != shape:
        raise ActionError(f"{source}actions have shape {action.shape}; they must have {shape}")
    if not (np.abs(action) <= 1.0).all():  # also False for NaN
        e, n = np.argwhere(~(np.abs(action) <= 1.0).all(-1))[0]
        raise ActionError(
            f"{source}action of robot {n} in world {e} is {action[e, n].tolist()} at step "
            f"{clock[e]}; every element must lie in [-1, 1]"
        )
    return action


def _reason(error: NumbaError) -> str:
    """Return the line of a message of Numba that says what is wrong."""
    lines = re.sub(r"\x1b\[\d*m", "", str(error)).splitlines()  # without colours
    return next((line for line in lines if line and not line.startswith("Failed in")), lines[0])


def _empty_state(e: int, scenario: Scenario, history: int) -> State:
    """Allocate the state of E worlds, with `history` past positions of each person."""
    f, n, m = np.float32, scenario.robots, scenario.humans
    delay = scenario.team_delay_steps + 1
    reports, messages = delay * scenario.team_tracks, delay * scenario.team_messages
    walls, corners = with_room_for_lanes(scenario.most_walls), scenario.most_corners
    walled = int(walls > 0)
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
        human_past=np.zeros((e, m, history, 2), f),
        human_past_valid=np.zeros((e, m, history), np.bool_),
        human_radius=np.zeros((e, m), f),
        human_speed=np.zeros((e, m), f),
        human_space=np.zeros((e, m), f),
        human_held_up=np.zeros((e, m), np.int32),
        human_social=np.zeros((e, m, len(SOCIAL) * scenario.is_social), np.int32),
        robot_position=np.zeros((e, n, 2), f),
        robot_velocity=np.zeros((e, n, 2), f),
        robot_heading=np.zeros((e, n), f),
        robot_goal=np.zeros((e, n, 2), f),
        robot_start=np.zeros((e, n, 2), f),
        route_length=np.zeros((e, n), f),
        route_left=np.zeros((e, n), f),
        arrived=np.zeros((e, n), np.bool_),
        collision=np.zeros((e, n), np.int8),
        last_contact=np.full((e, n, m + n), -1, np.int32),
        robot_acceleration=np.zeros((e, n, 2), f),
        tally=np.zeros((e, n, len(TALLY)), f),
        place=np.zeros((e, PLACE_COLUMNS * walled), f),
        walls=np.zeros((e, WALL_ROWS, walls), f),
        zones=np.zeros((e, MOST_ZONES * walled, 4), f),
        corners=np.zeros((e, CORNER_ROWS, corners), f),
        corner_distance=np.zeros((e, corners, corners), f),
        route_cost=np.zeros((e, (m + n) * walled, corners), f),
        route_corner=np.zeros((e, (m + n) * walled), np.int32),
        route_next=np.zeros((e, (m + n) * walled), np.int32),
        message_buffer=np.zeros((e, reports, n, m + n, len(OTHER_FEATURES)), f),
        intent_buffer=np.zeros((e, messages, n, len(MESSAGE_FEATURES)), f),
        macro_action=np.zeros((e, n), np.int32),
    )
