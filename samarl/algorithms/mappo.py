"""MAPPO: critics that see the true state of the whole team (SAMARL, Eq. 9; Yu et al., 2022)."""

from __future__ import annotations

from dataclasses import dataclass

from samarl.algorithms.algorithm import ALGORITHMS
from samarl.algorithms.critics import CriticEncoder
from samarl.algorithms.ppo import PPO, PPOConfig
from samarl.observations.features import NETWORK_EGO_FEATURES, STATE_OTHER_FEATURES
from samarl.observations.frames import Frames
from samarl.rollout import Rollout


@dataclass
class MAPPOConfig(PPOConfig):
    """Hyperparameters of MAPPO."""


@ALGORITHMS.register("mappo", MAPPOConfig)
class MAPPO(PPO):
    """The critic of a robot sees the global state, relative to that robot."""

    uses_global_state = True

    def _make_critic(self, config: PPOConfig) -> CriticEncoder:
        sizes = config.critic_width, config.critic_features
        return CriticEncoder(NETWORK_EGO_FEATURES, STATE_OTHER_FEATURES, *sizes)

    def _critic_frames(self, rollout: Rollout) -> Frames:
        assert rollout.state is not None
        return rollout.state
