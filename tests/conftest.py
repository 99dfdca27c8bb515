"""Settings shared by all tests."""

import contextlib
import os

os.environ["NUMBA_NUM_THREADS"] = "2"  # on every machine: some tests compare one with two
os.environ["OMP_NUM_THREADS"] = "1"  # PyTorch's: tests run side by side

import hypothesis
import numpy as np
import pytest

from mrsan import Crowd, CrowdReaction, Layout, Scenario, World
from mrsan.compile_ahead import compile_ahead
from mrsan.threads import use_threads

# Kernels may compile inside the first example, and a suite must say the same twice.
hypothesis.settings.register_profile(
    "suite",
    deadline=None,
    derandomize=True,
    database=None,
    suppress_health_check=list(hypothesis.HealthCheck),
)
hypothesis.settings.load_profile("suite")


@pytest.hookimpl(tryfirst=True)
def pytest_sessionstart(session: pytest.Session) -> None:
    """Compile the simulator once, before every worker would compile it for itself."""
    if not getattr(session.config.option, "numprocesses", None):
        return  # one process, or a worker
    with compile_ahead(Scenario()):
        pass  # the others share most of what it needs
    others = [
        Scenario(crowd=Crowd.social_force),
        Scenario(crowd_reaction=CrowdReaction.mixed),
        Scenario(layout=Layout.rooms),
    ]
    with contextlib.ExitStack() as compiling:
        for scenario in others:
            compiling.enter_context(compile_ahead(scenario))
    for scenario in (Scenario(), *others):
        for worlds in (1, 2):  # the serial and the parallel kernels
            world = World(scenario, worlds)
            world.reset(range(worlds))
            world.step(np.zeros((worlds, scenario.robots, scenario.action_size), np.float32))


@pytest.fixture(autouse=True)
def one_thread() -> None:
    """Tests run side by side: more threads than cores would wait for each other."""
    use_threads(1)


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """What needs a browser runs on its own: `make test` must not ask for one."""
    for item in items:
        if "browser" in getattr(item, "fixturenames", ()):
            item.add_marker("browser")
