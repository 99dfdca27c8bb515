"""Planners drive the same episodes, bit for bit, whatever vector instructions a processor has."""

import ast
import os
import subprocess
import sys
from pathlib import Path

import numpy as np

ROOT = Path(__file__).resolve().parents[2]
ROOMS = ("agents", "observations", "planning", "runtime")
VECTORISED = {  # functions whose last bit differs between NumPy's vector instructions
    *("sin", "cos", "tan", "arcsin", "arccos", "arctan", "arctan2", "sinh", "cosh", "tanh"),
    *("arcsinh", "arccosh", "arctanh", "exp", "exp2", "expm1", "log", "log2", "log10", "log1p"),
    *("power", "float_power", "cbrt"),
}
PLANNERS = ("perimeter", "orca", "straight", "social_force", "model_predictive")
EPISODES = """
import hashlib
import sys

import numpy as np

from mrsan import Layout, LidarSees, Reward, Scenario, World
from samarl.agents import build_agent
from samarl.configuration import load_agent_config

CASES = np.arange(12)
circle = Scenario(fov_degrees=90.0, position_noise=0.05, reward=Reward(lookahead=1.0))
doorway = Scenario(layout=Layout.doorway, humans=4, lidar_rays=90, lidar_sees=LidarSees.all)
for name in sys.argv[1:]:
    digest = hashlib.sha256()
    for scenario in (circle, doorway):
        world = World(scenario, len(CASES), auto_reset=False)
        agent = build_agent(load_agent_config(name), scenario)
        observation = world.reset(CASES)
        agent.reset(np.ones(len(CASES), np.bool_))
        for _ in range(200):
            step = world.step(agent.act(observation))
            observation = step.observation
            for array in (step.reward, *world.state, *observation.arrays().values()):
                digest.update(np.ascontiguousarray(array).tobytes())
    print(name, digest.hexdigest())
"""


def digests(**variables: str) -> dict[str, str]:
    """Return a digest of all states, observations and rewards of some episodes, by planner."""
    done = subprocess.run(
        [sys.executable, "-c", EPISODES, *PLANNERS],
        env={**os.environ, "NUMBA_NUM_THREADS": "1", **variables},
        capture_output=True,
        text=True,
        check=True,
        cwd=ROOT,
    )
    return dict(line.split() for line in done.stdout.splitlines())  # type: ignore[misc]


def test_episodes_do_not_depend_on_vector_instructions() -> None:
    extensions = np.show_config(mode="dicts")["SIMD Extensions"]["found"]
    with_extensions = digests()
    assert set(with_extensions) == set(PLANNERS)
    assert with_extensions == digests(
        NPY_DISABLE_CPU_FEATURES=" ".join(extensions),
        GLIBC_TUNABLES="glibc.cpu.hwcaps=-AVX2,-FMA,-AVX512F,-AVX512VL",
    )


def test_only_pictures_use_numpys_transcendental_functions() -> None:
    folders = ("envs/mrsan", *(f"samarl/{room}" for room in ROOMS))
    calls = [
        f"{path.relative_to(ROOT)}: np.{node.attr}"
        for folder in folders
        for path in sorted((ROOT / folder).rglob("*.py"))
        for node in ast.walk(ast.parse(path.read_text()))
        if isinstance(node, ast.Attribute) and node.attr in VECTORISED
        if isinstance(node.value, ast.Name) and node.value.id == "np"
    ]
    assert {call.partition(":")[0] for call in calls} == {"envs/mrsan/rendering.py"}
