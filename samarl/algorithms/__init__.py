"""How policies learn."""

from samarl.algorithms import (  # noqa: F401 (makes them known)
    ippo,
    mappo,
    reppo,
    soft_actor_critic,
    value_learning,
)
from samarl.algorithms.algorithm import ALGORITHMS, Algorithm

__all__ = ["ALGORITHMS", "Algorithm"]
