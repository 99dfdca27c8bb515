"""Evaluate the sweeps of `results/sweeps/` (hours): `python -m tools.run_sweeps`.

The same command resumes an interrupted sweep: finished cells are not evaluated again.
"""

from __future__ import annotations

import shutil
import sys
from pathlib import Path

from tools.process import run

TEAM = ["agent=samarl_planned", "scenario.fov_degrees=90"]  # the policy that drives the teams
SHARED_TRACKS = "scenario.team_perception=tracks"

SWEEPS = {
    "crowds": [
        "agent=samarl_waypoints,perimeter,model_predictive",
        "scenario.fov_degrees=60,90,135,180,270,360",
        "scenario.humans=0,5,10,15,20",
        "scenario.robots=1,2,3,5,8",
    ],
    "team_view": [
        TEAM[0],
        "scenario.fov_degrees=60,90,120,180,270,360",
        "scenario.team_perception=none,tracks",
    ],
    "team_size": [*TEAM, "scenario.robots=2,3,5,8", "scenario.team_perception=none,tracks"],
    "team_range": [*TEAM, SHARED_TRACKS, "scenario.team_range=2,4,6,8,10,20"],
    "team_delay": [*TEAM, SHARED_TRACKS, "scenario.team_delay=0,0.25,0.5,1,2"],
    "team_loss": [*TEAM, SHARED_TRACKS, "scenario.team_loss=0,0.25,0.5,0.75,0.95"],
}


def main() -> None:
    """Run every sweep, then copy its table to `results/sweeps/`."""
    evaluate = str(Path(sys.executable).parent / "samarl-evaluate")
    results = Path("results/sweeps")
    results.mkdir(parents=True, exist_ok=True)
    for name, overrides in SWEEPS.items():
        folder = f"outputs/sweeps/{name}"
        run([evaluate, "-m", "evaluation.cases=200", f"hydra.sweep.dir={folder}", *overrides])
        shutil.copyfile(f"{folder}/table.json", results / f"{name}.json")


if __name__ == "__main__":
    main()
