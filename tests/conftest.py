"""Settings shared by all tests."""

import os

os.environ["NUMBA_NUM_THREADS"] = "2"  # on every machine: some tests compare one with two

import hypothesis
import numba
import pytest

# Kernels may compile inside the first example, and a suite must say the same twice.
hypothesis.settings.register_profile(
    "suite",
    deadline=None,
    derandomize=True,
    database=None,
    suppress_health_check=list(hypothesis.HealthCheck),
)
hypothesis.settings.load_profile("suite")


@pytest.fixture(autouse=True)
def one_thread() -> None:
    """Tests run side by side: more threads than cores would wait for each other."""
    numba.set_num_threads(1)


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """What needs a browser runs on its own: `make test` must not ask for one."""
    for item in items:
        if "browser" in getattr(item, "fixturenames", ()):
            item.add_marker("browser")
