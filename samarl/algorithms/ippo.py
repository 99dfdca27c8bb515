"""Independent PPO: every robot for itself, the paper's SAMARL-PPO (SAMARL, Sec. V)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from torch import Tensor

from mrsan.fields import setting
from samarl.algorithms.algorithm import ALGORITHMS
from samarl.algorithms.critics import SetEncoder
from samarl.algorithms.ppo import PPO, PPOConfig
from samarl.observations.features import NETWORK_EGO_FEATURES, NETWORK_OTHER_FEATURES
from samarl.observations.frames import Frames
from samarl.rollout import Rollout


@dataclass
class IPPOConfig(PPOConfig):
    """Hyperparameters of independent PPO."""

    team_reward: bool = setting(
        False, kw_only=True, help="reward every robot when all have arrived, as in MAPPO"
    )


@ALGORITHMS.register("ippo", IPPOConfig)
class IPPO(PPO):
    """The critic sees what its robot sees; rewards exclude the team bonus unless `team_reward`."""

    def _make_critic(self, config: Any) -> SetEncoder:
        sizes = config.critic_width, config.critic_heads, config.critic_features
        return SetEncoder(NETWORK_EGO_FEATURES, NETWORK_OTHER_FEATURES, *sizes)

    def _critic_frames(self, rollout: Rollout) -> Frames:
        return rollout.frames.at(slice(self.policy.history, None))

    def _level_reward(self, rollout: Rollout, level: str) -> Tensor:
        reward = super()._level_reward(rollout, level)
        if self.config.team_reward or level != self.policy.levels[0]:
            return reward  # only the top level receives the team bonus
        return reward - rollout.steps["next", "agents", "team_reward"][:, :-1]
