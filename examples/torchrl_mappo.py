"""TorchRL's own parts learn MAPPO here: `python examples/torchrl_mappo.py`.

Nothing of `samarl` is used: the worlds are a TorchRL environment, the rest is what TorchRL's
tutorials do. Every robot is paid its own reward; one critic sees what all robots see.
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
    """All a robot observes as one row, [..., N, F]; who is not in view counts as zeros."""

    def forward(self, *parts: torch.Tensor) -> torch.Tensor:
        """Their own state, the people and the other robots."""
        ego, humans, humans_visible, robots, robots_visible = parts
        humans = humans * humans_visible.unsqueeze(-1)
        robots = robots * robots_visible.unsqueeze(-1)
        return torch.cat([ego, humans.flatten(-2), robots.flatten(-2)], -1)


def make_networks(env: TorchRLEnv) -> tuple[ProbabilisticActor, TensorDictSequential]:
    """The actor, whose weights the robots share, and the critic, which sees all of them."""
    scenario, spec = env.scenario, env.observation_spec[AGENTS]
    names = ("ego", "humans", "humans_visible", "robots", "robots_visible")
    flat = TensorDictModule(Flatten(), [(*AGENTS, name) for name in names], [("agents", "flat")])
    features = spec["ego"].shape[-1] + sum(spec[key].shape[-2:].numel() for key in names[1::2])

    def mlp(outputs: int, centralised: bool) -> MultiAgentMLP:
        return MultiAgentMLP(
            features, outputs, scenario.robots, centralized=centralised, share_params=True,
            depth=2, num_cells=128, activation_class=nn.Tanh,
        )  # fmt: skip

    size = scenario.action_size
    head = nn.Sequential(mlp(2 * size, centralised=False), NormalParamExtractor())
    parameters = [("agents", "loc"), ("agents", "scale")]
    actor = ProbabilisticActor(
        TensorDictSequential(flat, TensorDictModule(head, [("agents", "flat")], parameters)),
        in_keys=parameters, out_keys=[("agents", "action")], distribution_class=TanhNormal,
        return_log_prob=True, log_prob_key=("agents", "log_prob"),
    )  # fmt: skip
    value = TensorDictModule(mlp(1, centralised=True), [("agents", "flat")],
                             [("agents", "state_value")])  # fmt: skip
    return actor, TensorDictSequential(flat, value)


def explore(env: TorchRLEnv, actor: ProbabilisticActor, data: TensorDict) -> TensorDict:
    """Some steps of all worlds; outside of TorchRL's collectors an actor takes the mean else."""
    with set_exploration_type(ExplorationType.RANDOM):
        return env.rollout(STEPS, actor, auto_reset=False, tensordict=data,
                           break_when_any_done=False)  # fmt: skip


def train(humans: int, robots: int, steps: int) -> list[float]:
    """Train for that many steps of all worlds; returns the success rate of each batch, %."""
    env = TorchRLEnv(worlds=WORLDS, humans=humans, robots=robots, seed=0)
    actor, critic = make_networks(env)
    loss = ClipPPOLoss(
        actor, critic, clip_epsilon=0.2, entropy_coeff=1e-3, normalize_advantage=True
    )
    loss.set_keys(
        reward=("agents", "reward"), action=("agents", "action"), value=("agents", "state_value"),
        sample_log_prob=("agents", "log_prob"), done=("agents", "done"),
        terminated=("agents", "terminated"),
    )  # fmt: skip
    loss.make_value_estimator(ValueEstimators.GAE, gamma=0.99, lmbda=0.95)
    optimiser = torch.optim.Adam(loss.parameters(), lr=5e-4)
    data, rates = env.reset(), []
    for _ in tqdm(range(steps // (WORLDS * STEPS)), "training", unit="batch"):
        with torch.no_grad():
            batch = explore(env, actor, data)
            data = env.maybe_reset(step_mdp(batch[:, -1]))
            after = batch["next"]
            for key in ("done", "terminated"):  # of the team; the loss wants them of each robot
                of_each = after[key].unsqueeze(-1).expand_as(after["agents", "reward"])
                after["agents", key] = of_each
            loss.value_estimator(batch, params=loss.critic_network_params,
                                 target_params=loss.target_critic_network_params)  # fmt: skip
        ended = after["done"]
        rates.append(100.0 * (after["success"] & ended).sum().item() / max(ended.sum().item(), 1))
        samples = batch.reshape(-1)
        for _ in range(EPOCHS):
            for chosen in torch.randperm(len(samples)).split(MINIBATCH):
                losses = loss(samples[chosen])
                optimiser.zero_grad()
                total = sum(value for key, value in losses.items() if key.startswith("loss_"))
                total.backward()
                nn.utils.clip_grad_norm_(loss.parameters(), 1.0)
                optimiser.step()
    return rates


def main() -> None:
    """Train and print how the share of episodes in which all robots arrive grows."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--humans", type=int, default=0, help="people in each world")
    parser.add_argument("--robots", type=int, default=2, help="in each world")
    parser.add_argument("--steps", type=int, default=400_000, help="of all worlds together")
    wanted = parser.parse_args()
    rates = train(wanted.humans, wanted.robots, wanted.steps)
    tenths = np.array_split(rates, min(10, len(rates)))
    print("all arrived, % by tenths of the training:", *(f"{part.mean():.0f}" for part in tenths))


if __name__ == "__main__":
    main()
