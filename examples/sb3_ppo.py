"""Stable-Baselines3's PPO learns to drive one robot: `python examples/sb3_ppo.py --humans 5`.

With nobody there the library's defaults learn to arrive within a minute (40,000 steps). Among
people they end in waiting (`--naive`): collisions and nearness cost more than a beginner can win,
so it learns to stand still until the time is up, and who stands still meets nothing to learn from.
Three changes get it past that:

- A soft start. For the first third a collision costs little and nearness nothing, so that driving
  to the goal pays from the beginning; then the rewards are those of the task.
- Rewards scaled to about 1, so that the critic's error does not drown the actor's gradient.
- A network that looks at people one by one: what is learned of one holds for all.
"""

from __future__ import annotations

import argparse
from collections import Counter

import gymnasium
import torch
from stable_baselines3 import PPO
from stable_baselines3.common.env_util import make_vec_env
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor
from stable_baselines3.common.vec_env import VecNormalize
from torch import Tensor, nn

from mrsan import Reward, Split

NAME = "mrsan/SocialNavigation-v0"
DISCOUNT = 0.99
SOFT = Reward(collision=-5.0, discomfort=0.0)


class OneByOne(BaseFeaturesExtractor):
    """The same layers for every person who is seen; what stands out most of all of them."""

    def __init__(self, space: gymnasium.spaces.Dict, width: int = 64) -> None:
        """`width` is that of the layers."""
        ego, person = space["ego"].shape[-1], space["humans"].shape[-1]
        super().__init__(space, ego + width)
        self.of_each = nn.Sequential(
            nn.Linear(ego + person, width), nn.ReLU(), nn.Linear(width, width), nn.ReLU()
        )

    def forward(self, seen: dict[str, Tensor]) -> Tensor:
        """The robot's own state and the crowd, [B, features]."""
        ego, people = seen["ego"], seen["humans"]
        beside = ego[:, None].expand(-1, people.shape[1], -1)
        of_each = self.of_each(torch.cat([beside, people], -1)) * seen["humans_visible"][..., None]
        return torch.cat([ego, of_each.amax(1)], -1)


def make_envs(humans: int, seed: int, reward: Reward) -> VecNormalize:
    """32 worlds, each with one robot."""
    numbers = {"humans": humans, "reward": reward}
    envs = make_vec_env(NAME, n_envs=32, seed=seed, env_kwargs=numbers)
    return VecNormalize(envs, norm_obs=False, gamma=DISCOUNT)


def train(humans: int, steps: int, seed: int = 0) -> PPO:
    """PPO that gets past waiting."""
    network = {"features_extractor_class": OneByOne, "share_features_extractor": False}
    learner = PPO("MultiInputPolicy", make_envs(humans, seed, SOFT), n_steps=128, batch_size=512,
                  gamma=DISCOUNT, policy_kwargs=network, seed=seed, device="cpu")  # fmt: skip
    learner.learn(steps // 3, progress_bar=True)
    learner.set_env(make_envs(humans, seed, Reward()))
    return learner.learn(steps - steps // 3, reset_num_timesteps=False, progress_bar=True)


def train_naively(humans: int, steps: int, seed: int = 0) -> PPO:
    """PPO with the library's defaults, but for more worlds side by side."""
    envs = make_vec_env(NAME, n_envs=32, seed=seed, env_kwargs={"humans": humans})
    learner = PPO("MultiInputPolicy", envs, n_steps=128, batch_size=512, seed=seed, device="cpu")
    return learner.learn(steps, progress_bar=True)


def evaluate(learner: PPO, humans: int, cases: int) -> dict[str, float]:
    """How test episodes end, in % of them."""
    env = gymnasium.make(NAME, humans=humans)
    ends: Counter[str] = Counter()
    for index in range(cases):
        observation, _ = env.reset(seed=Split.test.case(index))
        over = False
        while not over:
            action, _ = learner.predict(observation, deterministic=True)
            observation, _, terminated, truncated, info = env.step(action)
            over = terminated or truncated
        ends[info["outcome"]] += 1
    return {name: 100.0 * count / cases for name, count in ends.most_common()}


def main() -> None:
    """Train, then print how test episodes end."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--humans", type=int, default=5, help="people in the world")
    parser.add_argument("--steps", type=int, default=300_000, help="of all robots together")
    parser.add_argument("--cases", type=int, default=100, help="test cases played in the end")
    parser.add_argument("--naive", action="store_true", help="the library's defaults")
    parser.add_argument("--seed", type=int, default=0, help="of the training")
    wanted = parser.parse_args()
    naive = wanted.naive or wanted.humans == 0
    learner = (train_naively if naive else train)(wanted.humans, wanted.steps, wanted.seed)
    print(evaluate(learner, wanted.humans, wanted.cases))


if __name__ == "__main__":
    main()
