"""Train one robot with PPO of Stable-Baselines3: `python examples/sb3_ppo.py --humans 5`.

Without people, the default settings learn to reach the goal within a minute (40,000 steps). Among
people they learn to stand still until the time limit (`--naive`): an untrained policy loses more
reward by collisions and proximity than it gains by progress, and a robot that stands still collects
no experience of moving. Three changes solve this:

- Small penalties at first: during the first third of the training, collisions cost little and
  proximity nothing, so driving to the goal pays from the start. Then the rewards are those of the
  task.
- Rewards are scaled to about 1, so that the critic's loss does not dominate the actor's gradient.
- The network processes every person with the same layers, so that experience with one person
  applies to all.
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
EARLY_REWARD = Reward(collision=-5.0, discomfort=0.0)


class CrowdEncoder(BaseFeaturesExtractor):
    """Applies the same layers to every visible person and takes the maximum of each feature."""

    def __init__(self, space: gymnasium.spaces.Dict, width: int = 64) -> None:
        """Create layers of `width` units."""
        ego, person = space["ego"].shape[-1], space["humans"].shape[-1]
        super().__init__(space, ego + width)
        self.person_layers = nn.Sequential(
            nn.Linear(ego + person, width), nn.ReLU(), nn.Linear(width, width), nn.ReLU()
        )

    def forward(self, observation: dict[str, Tensor]) -> Tensor:
        """Return the features [B, F] of the robot's own state and the crowd."""
        ego, people = observation["ego"], observation["humans"]
        repeated_ego = ego[:, None].expand(-1, people.shape[1], -1)
        features = self.person_layers(torch.cat([repeated_ego, people], -1))
        features = features * observation["humans_visible"][..., None]
        return torch.cat([ego, features.amax(1)], -1)


def make_envs(humans: int, seed: int, reward: Reward) -> VecNormalize:
    """Return 32 worlds with one robot each."""
    settings = {"humans": humans, "reward": reward}
    envs = make_vec_env(NAME, n_envs=32, seed=seed, env_kwargs=settings)
    return VecNormalize(envs, norm_obs=False, gamma=DISCOUNT)


def train(humans: int, steps: int, seed: int = 0) -> PPO:
    """Train PPO with the three changes."""
    network = {"features_extractor_class": CrowdEncoder, "share_features_extractor": False}
    envs = make_envs(humans, seed, EARLY_REWARD)
    learner = PPO(
        "MultiInputPolicy",
        envs,
        n_steps=128,
        batch_size=512,
        gamma=DISCOUNT,
        policy_kwargs=network,
        seed=seed,
        device="cpu",
    )
    learner.learn(steps // 3, progress_bar=True)
    learner.set_env(make_envs(humans, seed, Reward()))
    return learner.learn(steps - steps // 3, reset_num_timesteps=False, progress_bar=True)


def train_naively(humans: int, steps: int, seed: int = 0) -> PPO:
    """Train PPO with the default settings except for more parallel worlds."""
    envs = make_vec_env(NAME, n_envs=32, seed=seed, env_kwargs={"humans": humans})
    learner = PPO("MultiInputPolicy", envs, n_steps=128, batch_size=512, seed=seed, device="cpu")
    return learner.learn(steps, progress_bar=True)


def evaluate(learner: PPO, humans: int, cases: int) -> dict[str, float]:
    """Return the percentage of test episodes with each outcome."""
    env = gymnasium.make(NAME, humans=humans)
    outcomes: Counter[str] = Counter()
    for index in range(cases):
        observation, _ = env.reset(seed=Split.test.case(index))
        done = False
        while not done:
            action, _ = learner.predict(observation, deterministic=True)
            observation, _, terminated, truncated, info = env.step(action)
            done = terminated or truncated
        outcomes[info["outcome"]] += 1
    return {name: 100.0 * count / cases for name, count in outcomes.most_common()}


def main() -> None:
    """Train, then print how often test episodes end with each outcome."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--humans", type=int, default=5, help="number of people")
    parser.add_argument("--steps", type=int, default=300_000, help="steps of all worlds together")
    parser.add_argument("--cases", type=int, default=100, help="number of test cases")
    parser.add_argument("--naive", action="store_true", help="use the default settings of PPO")
    parser.add_argument("--seed", type=int, default=0, help="seed of the training")
    arguments = parser.parse_args()
    naive = arguments.naive or arguments.humans == 0
    learner = (train_naively if naive else train)(arguments.humans, arguments.steps, arguments.seed)
    print(evaluate(learner, arguments.humans, arguments.cases))


if __name__ == "__main__":
    main()
