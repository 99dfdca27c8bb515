"""How policies learn."""

from samarl.algorithms import ippo, mappo, value_learning  # noqa: F401 (makes them known)
from samarl.algorithms.algorithm import ALGORITHMS, Algorithm

__all__ = ["ALGORITHMS", "Algorithm"]
