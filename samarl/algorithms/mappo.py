"""MAPPO: critics that see the true state of the whole team (SAMARL, Eq. 9; Yu et al., 2022)."""

from __future__ import annotations

from dataclasses import dataclass

from samarl.algorithms.algorithm import ALGORITHMS
from samarl.algorithms.ppo import PPO, PPOConfig


@dataclass
class MAPPOConfig(PPOConfig):
    """Hyperparameters of MAPPO."""


@ALGORITHMS.register("mappo", MAPPOConfig)
class MAPPO(PPO):
    """The critic of a robot sees the global state, relative to that robot."""
