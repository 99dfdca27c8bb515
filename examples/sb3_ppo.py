"""Train robots with PPO of Stable-Baselines3: `python examples/sb3_ppo.py --humans 5 --robots 2`.

All robots share the policy: each robot of each world is one environment of `SB3VecEnv`. Without
people, the default settings learn to reach the goal within a minute (40,000 steps). Among
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
from dataclasses import dataclass, replace

import gymnasium
import numpy as np
import torch
from numpy.typing import NDArray
from stable_baselines3 import PPO
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor
from stable_baselines3.common.vec_env import VecMonitor, VecNormalize
from torch import Tensor, nn

import samarl
from mrsan import Observation, Outcome, Reward, Scenario
from mrsan.gymnasium_env import arrays_in_space
from mrsan.sb3_env import SB3VecEnv
from samarl.agents import Agent

WORLDS = 32
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


@dataclass
class LearnedAgent(Agent):
    """The policy as an agent of the benchmark, which can be evaluated like every other."""

    learner: PPO

    def act(self, observation: Observation) -> NDArray[np.float32]:
        """Return the mean action of every robot, [E, N, A]."""
        arrays = arrays_in_space(observation)
        rows = {key: value.reshape(-1, *value.shape[2:]) for key, value in arrays.items()}
        actions, _ = self.learner.predict(rows, deterministic=True)
        return actions.reshape(*observation.ego.shape[:2], -1)


def make_envs(scenario: Scenario) -> VecNormalize:
    """Return the robots of all worlds, with rewards scaled to about 1."""
    envs = VecMonitor(SB3VecEnv(scenario, worlds=WORLDS))
    return VecNormalize(envs, norm_obs=False, gamma=DISCOUNT)


def train(scenario: Scenario, steps: int, seed: int = 0) -> PPO:
    """Train PPO with the three changes."""
    network = {"features_extractor_class": CrowdEncoder, "share_features_extractor": False}
    learner = PPO(
        "MultiInputPolicy",
        make_envs(replace(scenario, reward=EARLY_REWARD)),
        n_steps=128,
        batch_size=512,
        gamma=DISCOUNT,
        policy_kwargs=network,
        seed=seed,
        device="cpu",
    )
    learner.learn(steps // 3, progress_bar=True)
    learner.set_env(make_envs(scenario))
    return learner.learn(steps - steps // 3, reset_num_timesteps=False, progress_bar=True)


def train_naively(scenario: Scenario, steps: int, seed: int = 0) -> PPO:
    """Train PPO with the default settings except for larger batches."""
    envs = VecMonitor(SB3VecEnv(scenario, worlds=WORLDS))
    learner = PPO("MultiInputPolicy", envs, n_steps=128, batch_size=512, seed=seed, device="cpu")
    return learner.learn(steps, progress_bar=True)


def evaluate(learner: PPO, scenario: Scenario, cases: int) -> dict[str, float]:
    """Print the result on test cases; return the percentage of robots with each outcome."""
    result = samarl.evaluate(LearnedAgent(scenario, learner), cases=cases, name="sb3_ppo")
    print(result)
    outcomes = result.episodes.outcome
    counts = Counter(Outcome(value).name for value in outcomes.ravel().tolist())
    return {name: round(100.0 * n / outcomes.size, 1) for name, n in counts.most_common()}


def main() -> None:
    """Train, then print how often test episodes end with each outcome."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--humans", type=int, default=5, help="number of people")
    parser.add_argument("--robots", type=int, default=1, help="number of robots")
    parser.add_argument("--steps", type=int, default=300_000, help="steps of all robots together")
    parser.add_argument("--cases", type=int, default=100, help="number of test cases")
    parser.add_argument("--naive", action="store_true", help="use the default settings of PPO")
    parser.add_argument("--seed", type=int, default=0, help="seed of the training")
    arguments = parser.parse_args()
    scenario = Scenario(humans=arguments.humans, robots=arguments.robots)
    naive = arguments.naive or arguments.humans == 0
    learner = (train_naively if naive else train)(scenario, arguments.steps, arguments.seed)
    print(evaluate(learner, scenario, arguments.cases))


if __name__ == "__main__":
    main()
