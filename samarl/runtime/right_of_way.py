"""Drive one robot of a team through a known map, with right of way at doors and corridors."""

from __future__ import annotations

import math
import zlib
from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mrsan import EGO_FEATURES, OTHER_FEATURES, Kinematics, Scenario
from mrsan.kernels.team import MACRO_ACTION, PRIORITY, THROUGH
from mrsan.kernels.walls import WALLS
from mrsan.observation import KnownMap as MapArrays
from mrsan.parameters import Parameters, kernel_parameters
from mrsan.passages import find_passages, open_width, wall_distance
from mrsan.se2 import unrotate
from mrsan.sensors.team import MESSAGE_FEATURES
from samarl.planning.passage_driving import drive
from samarl.planning.passage_features import MATE, OWN, TRUTH, write_features
from samarl.planning.passage_memory import empty_memory, mouths_of_worlds
from samarl.planning.team_beliefs import perceive
from samarl.runtime.driver import Command, command_for, ego_features
from samarl.runtime.inputs import (
    Detection,
    InputError,
    OwnState,
    number_above,
    shown,
    validated,
    validated_number,
)
from samarl.runtime.macro_level import MacroLevel
from samarl.runtime.team import Message, Team, validated_messages
from samarl.runtime.walls import KnownMap

FORGET_AFTER = 10.0  # s
_WALL_ROOM = 0.02  # m, more than rollouts keep from walls
_LEEWAY = 0.1  # m, by which a robot that is too close to a wall is taken to be smaller


class RightOfWayDriver:
    """The planner `right_of_way` for one robot, which exchanges messages with its team.

    The kernels of the planner work on a world in which the robot is the first of the team. They
    only read what it believes of the others, whose own rows are those of robots that have arrived.
    """

    def __init__(
        self,
        known_map: KnownMap,
        robot: str,
        scenario: Scenario | None = None,
        macro_level: str | Path | None = None,
        forget_after: float = FORGET_AFTER,
    ) -> None:
        """Find the passages of the map and compile the kernels.

        Args:
            known_map: the same for all robots of the team.
            robot: its name; those of a team differ.
            scenario: limits, radius and time step of the robot. None: those of `Scenario()`.
            macro_level: a file that `samarl-export` wrote, which decides who enters a passage.
                None: the rule.
            forget_after: time after which a silent team-mate is forgotten, s. Until then it
                keeps its passage.

        Raises:
            ConfigurationError: the file cannot be used.
            InputError: the name is not a string, or the time is not positive.
        """
        if not isinstance(robot, str):
            raise InputError(f"robot is {shown(robot)}; it must be a string")
        self.robot, self.scenario = robot, scenario or Scenario()
        self._known_map = known_map
        self._macro_level = None if macro_level is None else MacroLevel(macro_level)
        self._forget_after = number_above("forget_after", forget_after, 0.0)
        self._parameters = kernel_parameters(self.scenario)
        local = known_map.local
        self._map = MapArrays(
            *(array[None].copy() for array in (local.place, local.walls)),
            *(array[None].copy() for array in (local.corners, local.corner_distance)),
        )
        self._walls = local.walls[:, : int(local.place[WALLS])].astype(float)
        widest = open_width(self.scenario.robot_radius)
        passages = find_passages(local.walls, local.place, widest)
        self._mouths = mouths_of_worlds([passages])
        # Of what the numbers of mouths in messages depend on.
        self.passages = zlib.crc32(local.walls[:4].tobytes() + repr(widest).encode())
        self._random = np.random.default_rng()
        self.reset()
        x, y = known_map.centre
        self.step(OwnState(x, y, 0.0, 0.0, 0.0, x + 1.0, y), [Detection(x + 2.0, y, 0.0, 0.0)], 0.0)
        self.reset()
        if self._macro_level:
            ego, nobody = np.zeros((1, 1, len(EGO_FEATURES))), np.zeros((1, 1, 0))
            humans = np.zeros((1, 1, 0, len(OTHER_FEATURES)), np.float32)
            self._choose(ego.astype(np.float32), humans, nobody.astype(np.bool_))
            self.reset()

    def reset(self, priority: float | None = None) -> None:
        """Clear all memory: for a new goal, after a pause, or when the frame has moved.

        Args:
            priority: in [0, 1); those of a team must differ. None: draw one.

        Raises:
            InputError: the priority lies outside.
        """
        drawn = float(self._random.random(dtype=np.float32))
        chosen = drawn if priority is None else validated_number("priority", priority)
        if not 0.0 <= chosen < 1.0:
            raise InputError(f"priority is {priority}; it must lie in [0, 1)")
        self.priority = chosen
        self._team = Team(self._forget_after)
        self._memory = empty_memory(1, 1)
        self._last_time: float | None = None

    def step(
        self,
        own: OwnState,
        detections: Iterable[Detection],
        time: float,
        messages: Iterable[Message] = (),
    ) -> tuple[Command, Message]:
        """Decide what to do now, and what to tell the team-mates.

        Args:
            own: the robot and its goal, in the frame of the map.
            detections: everybody who is visible now. A robot that has not spoken is treated like a
                person.
            time: of these measurements, on a clock that the team shares, s.
            messages: those received since the last step, in any order; lost and late ones do no
                harm, and those of the robot itself are ignored.

        Returns:
            The command until the next step, which brakes at the goal, and a message to send now.

        Raises:
            InputError: names the input that cannot be used; the driver is unchanged.
        """
        own, agents, time = validated(own, detections, time)
        heard = validated_messages(messages, self.robot, time, self.passages)
        if self._last_time is not None and time <= self._last_time:
            raise InputError(
                f"time is {time}; it must be later than that of the step before, {self._last_time} "
                "(call reset() to start again)"
            )
        self._last_time = time
        people = self._team.update(heard, agents, time)
        action, ego = self._decide(own, people, time)
        command = command_for(action, ego, own.heading, self._parameters)
        return command, self._message(own, time)

    def _decide(
        self, own: OwnState, people: Sequence[Detection], time: float
    ) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Return the action [1, 1, A], and what the robot observes of itself [1, 1, 11]."""
        n = 1 + len(self._team.mates)
        if self._memory.due.shape[1] != n:
            memory = empty_memory(1, n)
            for array, old in zip(memory, self._memory, strict=True):
                common = tuple(slice(size) for size in np.minimum(array.shape, old.shape))
                array[common] = old[common]
            self._memory = memory
        self._memory.known[:] = False
        x, y = (float(number) for number in self._known_map.centre)
        ego = np.zeros((1, n, len(EGO_FEATURES)), np.float32)
        ego[0, 0] = ego_features(own, (x, y), self.scenario, 0.0)
        messages = np.zeros((1, n, n - 1, len(MESSAGE_FEATURES)), np.float32)
        is_received = np.zeros((1, n, n - 1), np.bool_)
        is_received[0, 0] = True
        for slot, mate in enumerate(self._team.mates.values()):
            row = messages[0, 0, slot]
            place = *mate.position(time), mate.velocity_x, mate.velocity_y
            row[:4] = _in_body_frame(own, *place)
            row[PRIORITY], row[THROUGH] = mate.message.priority, mate.message.through
            row[MACRO_ACTION] = mate.message.macro_action
        humans = np.zeros((1, n, len(people), len(OTHER_FEATURES)), np.float32)
        is_visible = np.zeros((1, n, len(people)), np.bool_)
        is_visible[0, 0] = True
        for slot, d in enumerate(people):
            place = _in_body_frame(own, d.x, d.y, d.velocity_x, d.velocity_y)
            humans[0, 0, slot] = *place, d.radius
        perceive(
            1,
            ego,
            np.zeros((1, n, n - 1, len(OTHER_FEATURES)), np.float32),
            np.zeros((1, n, n - 1), np.bool_),
            messages,
            is_received,
            np.full((1, n, 1), self.priority, np.float32),
            self._map,
            *self._mouths,
            self._memory,
            False,
            self._parameters,
        )
        if self._macro_level and self._memory.due[0, 0]:
            self._choose(ego, humans, is_visible)
        action = np.zeros((1, n, self.scenario.action_size), np.float32)
        drive(
            1,
            ego,
            humans,
            is_visible,
            self._map,
            *self._mouths,
            self._memory,
            False,
            self._parameters_near_walls(own),
            action,
        )
        if self._memory.arrived[0, 0]:
            action[0, 0] = self._brake(math.hypot(own.velocity_x, own.velocity_y))
        return action[:, :1].copy(), ego[:, :1].copy()

    def _choose(
        self,
        ego: NDArray[np.float32],
        humans: NDArray[np.float32],
        is_visible: NDArray[np.bool_],
    ) -> None:
        """Let the macro level choose whether the robot enters its next passage or queues.

        Args:
            ego: [1, N, 11] the robot, first.
            humans: [1, N, M, 5] people.
            is_visible: [1, N, M].
        """
        assert self._macro_level is not None
        n = ego.shape[1]
        own, mates = np.zeros((1, n, OWN), np.float32), np.zeros((1, n, n - 1, MATE), np.float32)
        truth = np.zeros((1, n, n - 1, MATE + TRUTH), np.float32)
        write_features(1, ego, humans, is_visible, *self._mouths, self._memory, own, mates, truth)
        self._memory.choice[0, 0] = self._macro_level.choose(own[0, 0], mates[0, 0])

    def _parameters_near_walls(self, own: OwnState) -> Parameters:
        """Return the parameters, with a smaller radius if the robot is too close to a wall.

        A base does not execute commands exactly, as in the simulator. Every motion of a robot a
        millimetre too close to a wall would be forbidden, also those that lead away from it.
        """
        radius, here = self.scenario.robot_radius, np.array([own.x, own.y])
        distance = float(wall_distance(self._walls, here - self._known_map.centre))
        if (room := distance - _WALL_ROOM) >= radius:
            return self._parameters
        smaller = max(room, radius - min(_LEEWAY, 0.5 * radius))
        return self._parameters._replace(robot_radius=np.float32(smaller))

    def _brake(self, speed: float) -> NDArray[np.float32]:
        """Return the action that stops the robot, [A]."""
        s = self.scenario
        action = np.zeros(s.action_size, np.float32)
        if s.kinematics is Kinematics.acceleration_heading:
            action[0] = -min(speed / (s.max_acceleration * s.time_step), 1.0)
        elif s.kinematics is Kinematics.unicycle:
            action[0] = -1.0
        return action

    def _message(self, own: OwnState, time: float) -> Message:
        """Return what the robot tells after a step."""
        towards = self._known_map.with_route(own)
        is_clear = (towards.next_x, towards.next_y) == (own.goal_x, own.goal_y)
        return Message(
            self.robot,
            time,
            own.x,
            own.y,
            own.velocity_x,
            own.velocity_y,
            self.priority,
            bool(is_clear or self._memory.arrived[0, 0]),
            int(self._memory.macro_action[0, 0]),
            self.passages,
        )


def _in_body_frame(
    own: OwnState, x: float, y: float, velocity_x: float, velocity_y: float
) -> tuple[float, float, float, float]:
    """Return the position (m) and the relative velocity (m/s) of an agent in the body frame."""
    cos, sin = math.cos(own.heading), math.sin(own.heading)
    return (
        *unrotate(cos, sin, x - own.x, y - own.y),
        *unrotate(cos, sin, velocity_x - own.velocity_x, velocity_y - own.velocity_y),
    )
