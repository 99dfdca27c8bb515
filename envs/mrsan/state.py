"""What is true of the worlds, in flat arrays; letters and units of `mrsan.world`."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float32]
Bools = NDArray[np.bool_]
Ints = NDArray[np.integer]


class State(NamedTuple):
    """Everything that is true of E worlds; the kernels read and write it in place."""

    case: NDArray[np.int64]  # [E]
    episode: NDArray[np.int64]  # [E] how often the case has been begun again
    key: NDArray[np.uint64]  # [E] of the random numbers of the episode
    clock: NDArray[np.int32]  # [E] steps taken
    terminated: Bools  # [E] all have arrived, or somebody collided and that ends it
    truncated: Bools  # [E] the time limit was reached
    human_present: Bools  # [E, M] a slot is one person for the whole episode, there or not
    human_entry: NDArray[np.int32]  # [E, M] the step from which on it may be there; -1: not again
    human_track: NDArray[np.int32]  # [E, M] which person of a recording it is; -1: none
    record_step: NDArray[np.int32]  # [E] the step of the recording at which the episode began
    human_position: Floats  # [E, M, 2]
    human_velocity: Floats  # [E, M, 2]
    human_goal: Floats  # [E, M, 2]
    human_past: Floats  # [E, M, H, 2] where people were, now last; H = 0 if nothing needs it
    human_past_known: Bools  # [E, M, H] they were there, in this episode
    human_radius: Floats  # [E, M]
    human_speed: Floats  # [E, M] preferred
    robot_position: Floats  # [E, N, 2]
    robot_velocity: Floats  # [E, N, 2]
    robot_heading: Floats  # [E, N]
    robot_goal: Floats  # [E, N, 2]
    robot_start: Floats  # [E, N, 2]
    arrived: Bools  # [E, N]
    collision: NDArray[np.int8]  # [E, N] 0, or whom it ran into first (kernels.step.HIT_*)
    last_contact: NDArray[np.int32]  # [E, N, M + N] the clock when they last touched; -1: never
    robot_acceleration: Floats  # [E, N, 2] of the last step
    tally: Floats  # [E, N, 13] what happened so far, `mrsan.kernels.tally.TALLY`
    # What robots told each other lately, in the world frame, by the clock modulo its length L:
    said: Floats  # [E, L, N, M + N, 5] OTHER_FEATURES; a radius of 0: it was not seen

    @property
    def done(self) -> Bools:
        """Which worlds have ended, [E]."""
        return self.terminated | self.truncated
