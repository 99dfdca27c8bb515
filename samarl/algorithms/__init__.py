"""How policies learn."""

from samarl.algorithms import ppo, soft_actor_critic, value_learning  # noqa: F401 (registers them)
from samarl.algorithms.algorithm import ALGORITHMS, Algorithm

__all__ = ["ALGORITHMS", "Algorithm"]
