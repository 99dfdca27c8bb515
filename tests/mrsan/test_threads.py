"""How threads wait is decided whatever is imported first."""

import os
import subprocess
import sys

import pytest

PLAY = """
import numba, numpy, os
from mrsan import Scenario, World
numba.set_num_threads(2)
World(Scenario(humans=1, robots=1), 2).reset(numpy.arange(2))
print(numba.threading_layer(), os.environ.get("GOMP_SPINCOUNT"))
"""


@pytest.mark.skipif(sys.platform != "linux", reason="GNU's OpenMP is Linux's")
@pytest.mark.parametrize(
    ("first", "settings", "expected"),
    [
        ("import mrsan", {}, "omp 1000"),
        ("import samarl, torch", {}, "omp 20000"),
        ("import torch", {}, "workqueue None"),
        ("import torch, samarl", {}, "workqueue None"),
        ("import torch", {"NUMBA_THREADING_LAYER": "omp"}, "omp None"),
        ("import torch", {"GOMP_SPINCOUNT": "7"}, "omp 7"),
    ],
)
def test_kernels_never_run_on_threads_that_spin_for_long(
    first: str, settings: dict[str, str], expected: str
) -> None:
    unset = ("GOMP_SPINCOUNT", "OMP_WAIT_POLICY", "NUMBA_THREADING_LAYER")
    environment = {k: v for k, v in os.environ.items() if k not in unset} | settings
    done = subprocess.run(
        [sys.executable, "-c", f"{first}\n{PLAY}"],
        env=environment, capture_output=True, text=True, check=True,
    )  # fmt: skip
    assert done.stdout.strip() == expected


@pytest.mark.parametrize("first", ["import mrsan, torch", "import torch, mrsan"])
def test_kernels_leave_torch_the_threads_that_it_was_given(first: str) -> None:
    told = f"{first}\ntorch.set_num_threads(1)\n{PLAY}"
    told = told.replace("numba.set_num_threads(2)", "") + "print(torch.get_num_threads())"
    done = subprocess.run(
        [sys.executable, "-c", told],
        env=os.environ | {"NUMBA_NUM_THREADS": "2"}, capture_output=True, text=True, check=True,
    )  # fmt: skip
    assert done.stdout.split()[-1] == "1"
