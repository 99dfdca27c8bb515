"""Independent PPO: every robot for itself, the paper's SAMARL-PPO (SAMARL, Sec. V)."""

from __future__ import annotations

from dataclasses import dataclass

from torchrl.objectives.multiagent import IPPOLoss

from mrsan.fields import setting
from samarl.algorithms.algorithm import ALGORITHMS
from samarl.algorithms.critics import CriticEncoder
from samarl.algorithms.on_policy import OnPolicyConfig
from samarl.algorithms.ppo import PPO, PPOConfig
from samarl.observations.frames import Frames
from samarl.policies.policy import Policy
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

    config: IPPOConfig
    loss_class = IPPOLoss
    uses_global_state = False

    def __init__(self, policy: Policy, config: IPPOConfig) -> None:
        """See `PPO`."""
        super().__init__(policy, config)
        self.reward_shaping.team_bonus = config.team_reward

    def _make_critic_encoder(self, config: OnPolicyConfig) -> CriticEncoder:
        sizes = config.critic_width, config.critic_features
        return CriticEncoder(self.policy.sizes, *sizes)

    def _critic_frames(self, rollout: Rollout) -> Frames:
        return rollout.frames.at(slice(self.policy.history, None))
