"""Train MAPPO with TorchRL's modules: `python examples/torchrl_mappo.py`.

The example does not use `samarl`: the worlds are a TorchRL environment, and the rest follows
TorchRL's tutorials. Every robot receives its own reward; one critic receives the observations of
all robots.
"""

from __future__ import annotations

import argparse

import numpy as np
import torch
from tensordict import TensorDict
from tensordict.nn import TensorDictModule, TensorDictSequential
from torch import nn
from torchrl.envs.utils import ExplorationType, set_exploration_type, step_mdp
from torchrl.modules import MultiAgentMLP, NormalParamExtractor, ProbabilisticActor, TanhNormal
from torchrl.objectives import ClipPPOLoss, ValueEstimators
from tqdm import tqdm

from mrsan.torchrl_env import TorchRLEnv

AGENTS = ("agents", "observation")
WORLDS, STEPS, EPOCHS, MINIBATCH = 64, 64, 4, 1024


class Flatten(nn.Module):
    """Concatenates all observations of a robot, [..., N, F]; zeros replace what is not visible."""

    def forward(self, *parts: torch.Tensor) -> torch.Tensor:
        """Return the own state, the people and the other robots as one tensor."""
        ego, humans, humans_visible, robots, robots_visible = parts
        humans = humans * humans_visible.unsqueeze(-1)
        robots = robots * robots_visible.unsqueeze(-1)
        return torch.cat([ego, humans.flatten(-2), robots.flatten(-2)], -1)


def make_networks(env: TorchRLEnv) -> tuple[ProbabilisticActor, TensorDictSequential]:
    """Return an actor with shared weights and a critic of all robots' observations."""
    scenario, spec = env.scenario, env.observation_spec[AGENTS]
    names = ("ego", "humans", "humans_visible", "robots", "robots_visible")
    flat = TensorDictModule(Flatten(), [(*AGENTS, name) for name in names], [("agents", "flat")])
    features = spec["ego"].shape[-1] + sum(spec[key].shape[-2:].numel() for key in names[1::2])

    def mlp(outputs: int, centralised: bool) -> MultiAgentMLP:
        return MultiAgentMLP(
            features,
            outputs,
            scenario.robots,
            centralized=centralised,
            share_params=True,
            depth=2,
            num_cells=128,
            activation_class=nn.Tanh,
        )

    size = scenario.action_size
    head = nn.Sequential(mlp(2 * size, centralised=False), NormalParamExtractor())
    parameters = [("agents", "loc"), ("agents", "scale")]
    actor = ProbabilisticActor(
        TensorDictSequential(flat, TensorDictModule(head, [("agents", "flat")], parameters)),
        in_keys=parameters,
        out_keys=[("agents", "action")],
        distribution_class=TanhNormal,
        return_log_prob=True,
        log_prob_key=("agents", "log_prob"),
    )
    value = TensorDictModule(
        mlp(1, centralised=True), [("agents", "flat")], [("agents", "state_value")]
    )
    return actor, TensorDictSequential(flat, value)


def explore(env: TorchRLEnv, actor: ProbabilisticActor, data: TensorDict) -> TensorDict:
    """Return `STEPS` steps of all worlds with sampled actions; the default would be their mean."""
    with set_exploration_type(ExplorationType.RANDOM):
        return env.rollout(
            STEPS, actor, auto_reset=False, tensordict=data, break_when_any_done=False
        )


def train(humans: int, robots: int, steps: int) -> list[float]:
    """Train for `steps` steps of all worlds; return the success rate of each batch, %."""
    env = TorchRLEnv(worlds=WORLDS, humans=humans, robots=robots, seed=0)
    actor, critic = make_networks(env)
    loss = ClipPPOLoss(
        actor, critic, clip_epsilon=0.2, entropy_coeff=1e-3, normalize_advantage=True
    )
    loss.set_keys(
        reward=("agents", "reward"),
        action=("agents", "action"),
        value=("agents", "state_value"),
        sample_log_prob=("agents", "log_prob"),
        done=("agents", "done"),
        terminated=("agents", "terminated"),
    )
    loss.make_value_estimator(ValueEstimators.GAE, gamma=0.99, lmbda=0.95)
    optimiser = torch.optim.Adam(loss.parameters(), lr=5e-4)
    data, rates = env.reset(), []
    for _ in tqdm(range(steps // (WORLDS * STEPS)), "training", unit="batch"):
        with torch.no_grad():
            batch = explore(env, actor, data)
            data = env.maybe_reset(step_mdp(batch[:, -1]))
            following = batch["next"]
            for key in ("done", "terminated"):  # the loss needs the team's flags for each robot
                per_robot = following[key].unsqueeze(-1).expand_as(following["agents", "reward"])
                following["agents", key] = per_robot
            loss.value_estimator(
                batch,
                params=loss.critic_network_params,
                target_params=loss.target_critic_network_params,
            )
        ended = following["done"]
        successes = (following["success"] & ended).sum().item()
        rates.append(100.0 * successes / max(ended.sum().item(), 1))
        samples = batch.reshape(-1)
        for _ in range(EPOCHS):
            for indices in torch.randperm(len(samples)).split(MINIBATCH):
                losses = loss(samples[indices])
                optimiser.zero_grad()
                total = sum(value for key, value in losses.items() if key.startswith("loss_"))
                total.backward()
                nn.utils.clip_grad_norm_(loss.parameters(), 1.0)
                optimiser.step()
    return rates


def main() -> None:
    """Train and print the success rate in each tenth of the training."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--humans", type=int, default=0, help="number of people in each world")
    parser.add_argument("--robots", type=int, default=2, help="number of robots in each world")
    parser.add_argument("--steps", type=int, default=400_000, help="steps of all worlds together")
    arguments = parser.parse_args()
    rates = train(arguments.humans, arguments.robots, arguments.steps)
    tenths = np.array_split(rates, min(10, len(rates)))
    print("success rate by tenths of the training, %:", *(f"{part.mean():.0f}" for part in tenths))


if __name__ == "__main__":
    main()
