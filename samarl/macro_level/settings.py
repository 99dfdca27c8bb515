"""Configuration of the training of the macro level."""

from __future__ import annotations

from dataclasses import dataclass

from mrsan.fields import check_numbers, required
from samarl.macro_level.network import NetworkConfig


@dataclass
class MacroRewards:
    """Rewards of the whole team."""

    success: float = required(-1e3, 1e3, help="of the end with all robots at their goals")
    arrival: float = required(-1e3, 1e3, help="per robot that arrives")
    collision: float = required(-1e3, 1e3, help="of the end with a collision")
    progress: float = required(-1e3, 1e3, help="per metre of route, summed over robots")
    time: float = required(-1e3, 1e3, help="per step; falls to half as robots arrive")


@dataclass
class MacroTraining:
    """Configuration of MAPPO on macro decisions."""

    rewards: MacroRewards
    network: NetworkConfig
    steps: int = required(1, 10**12, help="world-steps")
    worlds: int = required(1, 10**5, help="parallel worlds, shared equally by the scenarios")
    rollout: int = required(1, 10**5, help="steps of a world between two updates")
    epochs: int = required(1, 1000, help="passes over a rollout")
    minibatch: int = required(2, 10**7, help="decisions per gradient step")
    learning_rate: float = required(0.0, 1.0, help="initial; falls to a fifth")
    clip: float = required(0.0, 1.0, help="clipping range of the probability ratio")
    discount: float = required(0.0, 1.0, help="per step")
    gae_lambda: float = required(0.0, 1.0, help="lambda of generalised advantage estimation")
    entropy: float = required(0.0, 10.0, help="initial weight of the entropy")
    entropy_end: float = required(0.0, 10.0, help="its weight at the end")
    value_weight: float = required(0.0, 1e3, help="weight of the critic's loss")
    max_gradient_norm: float = required(0.0, 1e6, help="largest gradient norm")
    seed: int = required(0, 10**6, help="seed of the weights, choices and cases")

    def __post_init__(self) -> None:
        """Check every number.

        Raises:
            ConfigurationError: a number is out of range.
        """
        check_numbers(self, "training")
