"""Settings shared by all tests."""

import os

os.environ["NUMBA_NUM_THREADS"] = "2"  # on every machine: some tests compare one with two
os.environ["OMP_NUM_THREADS"] = "1"  # PyTorch's: tests run side by side

import hypothesis
import pytest

from mrsan import Crowd, CrowdReaction, Layout, Scenario
from mrsan.threads import use_threads
from tests.staging import step_once

# Kernels may compile inside the first example, and a suite must say the same twice.
hypothesis.settings.register_profile(
    "suite",
    deadline=None,
    derandomize=True,
    database=None,
    suppress_health_check=list(hypothesis.HealthCheck),
)
hypothesis.settings.load_profile("suite")
hypothesis.settings.register_profile(  # --hypothesis-profile=malformed: see test_malformed.py
    "malformed", hypothesis.settings.get_profile("suite"), max_examples=10_000, derandomize=False
)


@pytest.hookimpl(tryfirst=True)
def pytest_sessionstart(session: pytest.Session) -> None:
    """Compile the simulator once, before every worker would compile it for itself."""
    if not getattr(session.config.option, "numprocesses", None):
        return  # one process, or a worker
    scenarios = [
        Scenario(layout=Layout.rooms),  # takes longest
        Scenario(),
        Scenario(crowd_reaction=CrowdReaction.mixed),
        Scenario(crowd=Crowd.social_force),
    ]
    for scenario in scenarios:
        step_once(scenario, 2)


@pytest.fixture(autouse=True)
def one_thread() -> None:
    """Tests run side by side: more threads than cores would wait for each other."""
    use_threads(1)


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """What needs a browser runs on its own: `make test` must not ask for one."""
    for item in items:
        if "browser" in getattr(item, "fixturenames", ()):
            item.add_marker("browser")
