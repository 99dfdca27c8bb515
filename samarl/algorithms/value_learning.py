"""Value learning with a replay buffer and a target network, after imitating ORCA.

This is how CADRL (Chen et al., 2017) and SARL (Chen et al., 2019) learn: V of a state is regressed
on the reward of the step plus the discounted target value of the next state.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import torch
from tensordict import TensorDict
from torch import Tensor, nn
from torch.nn import functional
from torchrl.data import LazyTensorStorage, ReplayBuffer

from mrsan import ConfigurationError, Observation
from mrsan.fields import required
from samarl.algorithms.advantages import streams
from samarl.algorithms.algorithm import ALGORITHMS, Algorithm
from samarl.distributed import all_gather_object, average_gradients
from samarl.launch import per_process
from samarl.policies.lookahead import LookaheadPolicy
from samarl.policies.policy import Policy
from samarl.reward_shaping import RewardShaping
from samarl.rollout import Rollout

OTHERS = ("humans", "humans_known", "robots", "robots_known")  # `Frames` with slots for others


@dataclass
class ValueLearningConfig:
    """Hyperparameters of the update; the discount is the policy's."""

    learning_rate: float = required(0.0, 1.0, help="initial learning rate; falls linearly to 0")
    imitation: float = required(0.0, 1.0, help="training progress until which ORCA drives")
    epsilon_start: float = required(
        0.0, 1.0, help="probability of a random command after imitation"
    )
    epsilon_end: float = required(0.0, 1.0, help="final probability of a random command")
    epsilon_share: float = required(
        0.0, 1.0, help="training progress over which the probability falls linearly"
    )
    replay: int = required(1, 10**8, help="capacity of the replay buffer, steps of one robot")
    learning_starts: int = required(
        1, 10**8, help="samples in the buffer before updates begin, also after a resume"
    )
    batch: int = required(1, 10**6, help="samples per gradient step")
    updates: int = required(1, 10**6, help="gradient steps per round")
    max_gradient_norm: float = required(0.0, 1e6, help="largest gradient norm")


@ALGORITHMS.register("value_learning", ValueLearningConfig)
class ValueLearning(Algorithm):
    """Learn values without the team bonus: a robot cannot predict when the others arrive.

    The replay buffer is not saved with the run: after a resume, updates continue once it holds
    `learning_starts` samples again.
    """

    policy: LookaheadPolicy
    config: ValueLearningConfig
    supports_data_parallel = True

    def __init__(self, policy: Policy, config: ValueLearningConfig) -> None:
        """See `Algorithm`.

        Raises:
            ConfigurationError: the policy has no values, or `replay` is too small to begin.
        """
        super().__init__(
            policy, per_process(config, "algorithm", "replay", "learning_starts", "batch")
        )
        self.reward_shaping = RewardShaping(team_bonus=False)
        if not isinstance(policy, LookaheadPolicy):
            raise ConfigurationError(
                "algorithm.name is value_learning; policy.name must be one with values: lookahead"
            )
        if config.learning_starts > config.replay:
            raise ConfigurationError(
                f"algorithm.learning_starts is {config.learning_starts}; it must not exceed "
                f"algorithm.replay ({config.replay})"
            )
        self.target = type(policy)(policy.config, policy.action_size, policy.sizes)
        self.target.load_state_dict(policy.state_dict())
        self.target.requires_grad_(False)
        self.to(policy.device)
        self.optimiser = torch.optim.Adam(policy.parameters(), lr=config.learning_rate)
        self.slots = [0] * len(OTHERS)  # of the replay buffer's samples, for each of `OTHERS`
        self.replay = self._empty_replay()
        self.set_progress(0.0)

    def set_progress(self, progress: float) -> None:
        """Let ORCA drive first, then decay epsilon linearly; the learning rate always decays."""
        c = self.config
        self._set_learning_rate(progress)
        decayed = min(max(progress - c.imitation, 0.0) / max(c.epsilon_share, 1e-6), 1.0)
        self.policy.imitating = progress < c.imitation
        self.policy.epsilon = c.epsilon_start + (c.epsilon_end - c.epsilon_start) * decayed

    def optimisers(self) -> dict[str, Any]:
        """See `Algorithm.optimisers`."""
        return {"adam": self.optimiser}

    def update(self, rollouts: list[Rollout]) -> dict[str, float]:
        """Store the samples of a round, then take `updates` gradient steps."""
        c = self.config
        self._store([samples_of(rollout) for rollout in rollouts])
        statistics = {"charts/epsilon": 0.0 if self.policy.imitating else self.policy.epsilon}
        if not all(all_gather_object(len(self.replay) >= c.learning_starts)):
            return statistics
        total = torch.zeros(4, device=self.policy.device)
        for _ in range(c.updates):
            batch = self.replay.sample(c.batch)
            value = self.policy.value(Observation.from_arrays(batch["now"]), batch["robot"])
            target = self.targets(batch)
            loss = functional.mse_loss(value, target)
            self.optimiser.zero_grad(set_to_none=True)
            loss.backward()
            average_gradients(self.policy.parameters())
            norm = nn.utils.clip_grad_norm_(self.policy.parameters(), c.max_gradient_norm)
            if not torch.isfinite(norm):
                raise FloatingPointError("the gradient of the value is not finite")
            self.optimiser.step()
            total += torch.stack([loss.detach(), value.detach().mean(), target.mean(), norm])
        self.target.load_state_dict(self.policy.state_dict())
        names = ("value", "mean_value", "mean_target", "gradient_norm")
        means = zip(names, (total / c.updates).tolist(), strict=True)
        return statistics | {f"losses/{name}": mean for name, mean in means}

    @torch.no_grad()
    def targets(self, samples: TensorDict) -> Tensor:
        """Return the targets of the values of samples [P]: r + discount V(next), [P]."""
        following = self.target.value(Observation.from_arrays(samples["next"]), samples["robot"])
        return samples["reward"] + self.policy.config.discount * following * samples["continues"]

    def _empty_replay(self) -> ReplayBuffer:
        storage = LazyTensorStorage(self.config.replay, device=self.policy.device)
        return ReplayBuffer(storage=storage)

    def _store(self, parts: list[TensorDict]) -> None:
        """Add samples to the replay buffer, which is widened for more people or robots."""
        shapes = [[samples["now", part].shape[2] for part in OTHERS] for samples in parts]
        slots = [max(sizes) for sizes in zip(self.slots, *shapes, strict=True)]
        if slots != self.slots:
            parts = [*([self.replay[:]] if len(self.replay) else []), *parts]
            self.slots, self.replay = slots, self._empty_replay()
        samples = torch.cat([widened(part, slots) for part in parts])
        if len(samples) > 0:
            self.replay.extend(samples)


def samples_of(rollout: Rollout) -> TensorDict:
    """Return the samples of a rollout: one for each step of an active robot.

    Where the time limit or a team-mate's collision cut its episode short, the last step is removed,
    as its continuation is unknown (see `advantages.Streams`).

    Returns:
        [P] with `now` and `next` (the parts of `Frames`, [P, 1, ...]), `reward`, `robot` and
        `continues`: the robot was still active in the next step.
    """
    steps, stream, n = rollout.steps, streams(rollout.steps), rollout.robots
    world, step, robot = stream.acts.nonzero(as_tuple=True)
    at, row = (world, step, robot), world * n + robot
    continues = steps["agents", "active_mask"][:, 1:] & ~stream.terminated

    def frames(step: Tensor) -> TensorDict:
        parts = rollout.frames.arrays("known").items()
        return TensorDict({name: part[row, step, None] for name, part in parts}, [len(row)])

    return TensorDict(
        {
            "now": frames(step),  # encoders without history: frame t is that of step t
            "next": frames(step + 1),
            "reward": steps["next", "agents", "reward"][at],
            "continues": continues[at],
            "robot": robot,
        },
        [len(row)],
    )


def widened(samples: TensorDict, slots: Sequence[int]) -> TensorDict:
    """Return samples with `slots` slots for each of `OTHERS`; additional ones are masked out."""
    wide = samples.clone()
    for frames in (wide["now"], wide["next"]):
        for part, most in zip(OTHERS, slots, strict=True):
            p, t, m, *features = frames[part].shape
            unknown = frames[part].new_zeros(p, t, most - m, *features)
            frames[part] = torch.cat([frames[part], unknown], 2)
    return wide
