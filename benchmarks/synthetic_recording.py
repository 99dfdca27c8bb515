"""Generate the recording in the package: `python -m benchmarks.synthetic_recording`.

Simulated people cross in two streams. Some walk in pairs, stand or hurry, and they enter and leave.
The format is that of ETH and UCY: a line `frame id x y` per person every 10 frames, that is 0.4 s.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

from mrsan import Layout, Scenario, World
from mrsan.recording import SAMPLE

FRAMES = 10  # between two lines of one person
CROWD = Scenario(
    layout=Layout.crossing,
    robots=1,
    humans=64,
    time_step=0.2,
    time_limit=120.0,
    human_speed_min=0.8,
    human_speed_max=1.4,
    stand_probability=0.05,
    hurry_probability=0.1,
    pair_probability=0.3,
    late_probability=0.85,
    late_time=110.0,
    leave_probability=1.0,
)


def recording_text(crowd: Scenario = CROWD, case: int = 0) -> str:
    """Return the text of a recording of simulated people."""
    world = World(crowd)
    world.reset([case])
    state = world.state
    state.robot_position[:] = state.robot_goal[:] = 1000.0  # far from all people
    state.robot_goal[:] += 1000.0
    rest = np.zeros((1, 1, crowd.action_size), np.float32)
    lines = []
    for step in range(crowd.time_limit_steps):
        if step % 2 == 0:
            frame = step // 2 * FRAMES
            for person in np.flatnonzero(state.human_present[0]):
                x, y = state.human_position[0, person]
                lines.append(f"{frame} {person} {x:.3f} {y:.3f}\n")
        world.step(rest)
    return "".join(lines)


def main() -> None:
    """Write the recording."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--output", type=Path, default=SAMPLE)
    output = parser.parse_args().output
    output.parent.mkdir(parents=True, exist_ok=True)
    output.write_text(recording_text(), encoding="utf-8")
    print(f"written to {output}")


if __name__ == "__main__":
    main()
