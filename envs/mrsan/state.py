"""The state of the worlds in flat arrays; `mrsan.world` explains letters and units."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mrsan.kernels.structs import KeepsStruct

Floats = NDArray[np.float32]
Bools = NDArray[np.bool_]
Ints = NDArray[np.integer]


class _Arrays(NamedTuple):
    case: NDArray[np.int64]  # [E]
    episode: NDArray[np.int64]  # [E] number of the episode of this case, from 0; -1: none yet
    key: NDArray[np.uint64]  # [E] key of the random numbers of the episode
    clock: NDArray[np.int32]  # [E] steps since the episode began
    terminated: Bools  # [E] all robots have arrived, or a collision ended the episode
    truncated: Bools  # [E] the time limit was reached
    human_present: Bools  # [E, M]; a slot is one person for the whole episode, present or not
    human_entry: NDArray[np.int32]  # [E, M] first step of its presence; -1: not again
    human_track: NDArray[np.int32]  # [E, M] index of the recorded person; -1: none
    record_step: NDArray[np.int32]  # [E] step of the recording at which the episode began
    human_position: Floats  # [E, M, 2]
    human_velocity: Floats  # [E, M, 2]
    human_goal: Floats  # [E, M, 2]
    human_past: Floats  # [E, M, H, 2] last positions, the present one last; H = 0 if unused
    human_past_valid: Bools  # [E, M, H] the person was present then, in this episode
    human_radius: Floats  # [E, M]
    human_speed: Floats  # [E, M] preferred speed
    human_space: Floats  # [E, M] margin added to every radius that the person avoids, m
    human_held_up: NDArray[np.int32]  # [E, M] steps for which it could not walk on; among walls
    human_social: NDArray[
        np.int32
    ]  # [E, M, 3] SOCIAL in `kernels.social_state`; [E, M, 0] if unused
    robot_position: Floats  # [E, N, 2]
    robot_velocity: Floats  # [E, N, 2]
    robot_heading: Floats  # [E, N]
    robot_goal: Floats  # [E, N, 2]
    robot_start: Floats  # [E, N, 2]
    route_length: Floats  # [E, N] of the shortest route from start to goal, m
    route_left: Floats  # [E, N] of the rest of the route, m; only with walls
    arrived: Bools  # [E, N]
    collision: NDArray[np.int8]  # [E, N] 0, or the first collision (kernels.step.HIT_*)
    last_contact: NDArray[np.int32]  # [E, N, M + N] clock at the last contact; -1: never
    robot_acceleration: Floats  # [E, N, 2] in the last step
    tally: Floats  # [E, N, 16] statistics of the episode, `mrsan.kernels.tally.TALLY`
    # Places with walls; W and V are zero without.
    place: Floats  # [E, 9] description of the place, columns in `mrsan.kernels.walls`
    walls: Floats  # [E, 12, W] segments, rows in `mrsan.kernels.walls`
    zones: Floats  # [E, 9, 4] left, bottom, right and top of where starts and goals are drawn
    corners: Floats  # [E, 6, V] nodes of the route graph, rows in `mrsan.kernels.routes`
    corner_distance: Floats  # [E, V, V] length of the shortest route between two corners; inf: none
    route_cost: Floats  # [E, M + N, V] length of the route from a corner to an agent's goal
    route_corner: NDArray[np.int32]  # [E, M + N] corner an agent heads for; -1: its goal
    route_next: NDArray[np.int32]  # [E, M + N] corner after that one; -1: its goal
    # The last reports of robots in the world frame, indexed by the clock modulo L:
    message_buffer: Floats  # [E, L, N, M + N, 5] OTHER_FEATURES; radius 0: not seen
    intent_buffer: Floats  # [E, L, N, 7] their last messages, `sensors.team.MESSAGE_FEATURES`
    macro_action: NDArray[np.int32]  # [E, N] that robots tell, `World.tell`; 0: none yet


class State(_Arrays, KeepsStruct):
    """The complete state of E worlds, which kernels update in place."""

    @property
    def done(self) -> Bools:
        """Return which worlds have ended, [E]."""
        return self.terminated | self.truncated
