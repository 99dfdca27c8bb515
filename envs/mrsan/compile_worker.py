"""Compile kernels into the cache: `python -m mrsan.compile_worker NAME...`.

It reads the pickled scenario from its standard input; see `mrsan.compile_ahead`.
"""

import pickle
import sys

from mrsan.kernels import Version, replace_runs
from mrsan.scenario import Scenario
from mrsan.world import World


def compile_kernels(names: list[str], scenario: Scenario) -> None:
    """Compile the kernels of a scenario that have these names."""

    def load(version: Version) -> None:
        if version.name in names:
            version.load()

    with replace_runs(load):
        World(scenario).call_kernels()


if __name__ == "__main__":
    compile_kernels(sys.argv[1:], pickle.load(sys.stdin.buffer))
