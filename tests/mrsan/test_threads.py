"""Kernels run from any thread and in any child process, whatever is imported first."""

import os
import subprocess
import sys
from pathlib import Path

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
        env=environment,
        capture_output=True,
        text=True,
        check=True,
    )
    assert done.stdout.strip() == expected


@pytest.mark.parametrize("first", ["import mrsan, torch", "import torch, mrsan"])
def test_kernels_leave_torch_the_threads_that_it_was_given(first: str) -> None:
    program = f"{first}\ntorch.set_num_threads(1)\n{PLAY}"
    program = program.replace("numba.set_num_threads(2)", "") + "print(torch.get_num_threads())"
    done = subprocess.run(
        [sys.executable, "-c", program],
        env=os.environ | {"NUMBA_NUM_THREADS": "2"},
        capture_output=True,
        text=True,
        check=True,
    )
    assert done.stdout.split()[-1] == "1"


EVERYWHERE = """
import hashlib, multiprocessing, sys
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
import numpy as np
{first}
from mrsan import Scenario, World

def play(seed):
    world = World(Scenario(humans=6, robots=2), 32)
    world.reset(np.arange(32) + 100 * seed)
    for _ in range(60):
        world.step(np.zeros((32, 2, 3), np.float32))
    return hashlib.sha256(world.state.human_position.tobytes()).hexdigest()

class Episodes:  # of a DataLoader, which needs no more than these two methods
    def __len__(self):
        return 4

    def __getitem__(self, seed):
        return play(seed)

def in_processes(method):
    with ProcessPoolExecutor(2, mp_context=multiprocessing.get_context(method)) as pool:
        return list(pool.map(play, range(4)))

if __name__ == "__main__":
    before = in_processes("fork")  # this process has run nothing yet
    expected = [play(seed) for seed in range(4)]
    with ThreadPoolExecutor(4) as pool:
        in_threads = list(pool.map(play, range(4)))
    from torch.utils.data import DataLoader
    played = {{
        "fork at first": before, "threads": in_threads,
        **{{method: in_processes(method) for method in ("fork", "forkserver", "spawn")}},
        "DataLoader": [seed for (seed,) in DataLoader(Episodes(), batch_size=1, num_workers=2)],
    }}
    for name, states in played.items():
        assert states == expected, name
    print("same everywhere")
"""


@pytest.mark.slow
@pytest.mark.skipif(not hasattr(os, "fork"), reason="Windows has no fork")
@pytest.mark.parametrize("first", ["import mrsan, torch", "import torch, mrsan"])
def test_threads_and_processes_of_every_kind_play_the_same(first: str, tmp_path: Path) -> None:
    script = tmp_path / "everywhere.py"
    script.write_text(EVERYWHERE.format(first=first))
    done = subprocess.run([sys.executable, str(script)], capture_output=True, text=True)
    assert done.stdout.strip() == "same everywhere", done.stderr[-2000:]
