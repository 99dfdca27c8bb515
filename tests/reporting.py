"""Helpers for the tests of the report."""

import subprocess
from pathlib import Path

from mrsan import Scenario
from samarl.agents import build_agent
from samarl.evaluation.trajectory import Trajectory, record_episode
from tests.commands import run_module

STRAIGHT = {"_target_": "samarl.agents.planners.straight.Straight"}


def report(*arguments: str, cwd: Path, code: int = 0) -> subprocess.CompletedProcess[str]:
    done = run_module("samarl.commands.report", *arguments, cwd=cwd)
    assert done.returncode == code, done.stderr
    return done


def straight_trajectory() -> Trajectory:
    scenario = Scenario(fov_degrees=90.0)
    return record_episode(build_agent(STRAIGHT, scenario), scenario, 2**41)
