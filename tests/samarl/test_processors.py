"""Planners drive the same episodes, bit for bit, whatever vector instructions a processor has."""

import ast
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from mrsan import Scenario
from samarl.agents.learned import Learned
from samarl.agents.shielded import Shielded
from samarl.export import export_agent
from samarl.planning.shield import Shield
from samarl.policies.checkpoint import save_policy
from tests import learning

ROOT = Path(__file__).resolve().parents[2]
ROOMS = ("agents", "observations", "planning", "runtime")
VECTORISED = {  # functions whose last bit differs between NumPy's vector instructions
    *("sin", "cos", "tan", "arcsin", "arccos", "arctan", "arctan2", "sinh", "cosh", "tanh"),
    *("arcsinh", "arccosh", "arctanh", "exp", "exp2", "expm1", "log", "log2", "log10", "log1p"),
    *("power", "float_power", "cbrt"),
}
PLANNERS = (
    "perimeter",
    "perimeter shield=true",
    "orca",
    "straight",
    "social_force",
    "model_predictive",
    "model_predictive shield=true",
    "model_predictive predictor=recurrent",
)
EPISODES = """
import hashlib
import sys

import numpy as np

from mrsan import Layout, LidarTargets, Reward, Scenario, World
from samarl.agents import build_agent
from samarl.configuration import load_method_config
from samarl.runtime import Detection, Driver, OwnState

CASES = np.arange(12)
circle = Scenario(fov_degrees=90.0, position_noise=0.05, reward=Reward(lookahead=1.0))
doorway = Scenario(layout=Layout.doorway, humans=4, lidar_rays=90, lidar_targets=LidarTargets.all)
exported, *planners = sys.argv[1:]
for name in planners:
    digest = hashlib.sha256()
    for scenario in (circle, doorway):
        world = World(scenario, len(CASES), auto_reset=False)
        agent = build_agent(load_method_config(name), scenario)
        observation = world.reset(CASES)
        agent.reset(np.ones(len(CASES), np.bool_))
        for _ in range(40 if name.startswith("model_predictive ") else 200):  # these are slow
            step = world.step(agent.act(observation))
            observation = step.observation
            for array in (step.reward, *world.state, *observation.arrays().values()):
                digest.update(np.ascontiguousarray(array).tobytes())
    print(name, digest.hexdigest(), sep=":")
driver, digest = Driver.load(exported), hashlib.sha256()
for k in range(8):
    people = [Detection(4.0 - 0.3 * k, 3.0, -1.2, 0.2, id="anna"), Detection(5.0, 1.7, -0.4, 0.1)]
    command = driver.step(OwnState(1.0, 2.0, 0.1, 0.5, 0.3, 6.0, 2.0), people, 0.25 * k)
    digest.update(command.action.tobytes() + repr(command[1:]).encode())
print("driver", digest.hexdigest(), sep=":")
"""


@pytest.fixture
def exported(tmp_path: Path) -> Path:
    """An exported policy with the shield."""
    save_policy(tmp_path / "policy.safetensors", learning.policy("flat", gain=100.0), "flat", {})
    scenario = Scenario(humans=3, robots=2)
    agent = Learned(scenario, str(tmp_path / "policy.safetensors"))
    export_agent(tmp_path / "policy.onnx", Shielded(scenario, agent, Shield()), "mine")
    return tmp_path / "policy.onnx"


def digests(exported: Path, **variables: str) -> dict[str, str]:
    """Return a digest of all states, observations and rewards of some episodes, by planner.

    That of `driver` is of the commands of the runtime's driver with the exported policy.
    """
    done = subprocess.run(
        [sys.executable, "-c", EPISODES, str(exported), *PLANNERS],
        env={**os.environ, "NUMBA_NUM_THREADS": "1", **variables},
        capture_output=True,
        text=True,
        check=True,
        cwd=ROOT,
    )
    return dict(line.split(":") for line in done.stdout.splitlines())  # type: ignore[misc]


@pytest.mark.slow
def test_episodes_do_not_depend_on_vector_instructions(exported: Path) -> None:
    extensions = np.show_config(mode="dicts")["SIMD Extensions"]["found"]
    with_extensions = digests(exported)
    assert set(with_extensions) == {*PLANNERS, "driver"}
    assert with_extensions == digests(
        exported,
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
