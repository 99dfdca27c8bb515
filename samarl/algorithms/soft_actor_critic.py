"""Multi-robot soft actor-critic on sequences: MSA3C, and with other critics MLGA2C and MASAC.

The policy's encoder feeds actor and critics (MSA3C, Fig. 5). It is trained by the critics' loss
alone: the actor's loss does not change the features by which the actor is judged.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import torch
from tensordict import TensorDict
from torch import Tensor, nn
from torchrl.data import LazyTensorStorage, ReplayBuffer

from mrsan import ConfigurationError, Observation
from mrsan.fields import required
from samarl.algorithms.action_values import (
    Aggregation,
    AttentionCritic,
    ConcatenationCritic,
    TeamCritic,
)
from samarl.algorithms.advantages import streams
from samarl.algorithms.algorithm import ALGORITHMS, Algorithm
from samarl.distributed import all_gather_object, average_gradients
from samarl.launch import per_process
from samarl.policies.policy import Policy
from samarl.policies.squashed import SquashedPolicy
from samarl.policies.stochastic import Sequences
from samarl.registry import needed
from samarl.reward_shaping import RewardShaping
from samarl.rollout import Rollout


@dataclass
class SoftActorCriticConfig:
    """Hyperparameters of the update."""

    learning_rate: float = required(0.0, 1.0, help="initial learning rate; falls linearly to 0")
    discount: float = required(0.0, 0.9999, help="discount per step")
    temperature_start: float = required(
        1e-6, 100.0, help="initial temperature alpha, the weight of the entropy; it is learned"
    )
    target_rate: float = required(
        0.0, 1.0, help="share by which the target networks follow, per update"
    )
    policy_delay: int = required(1, 1000, help="critic updates per actor update")
    replay: int = required(1, 10**9, help="capacity of the replay buffer, environment steps")
    learning_starts: int = required(
        1, 10**9, help="environment steps in the buffer before updates begin, also after a resume"
    )
    batch: int = required(1, 10**6, help="sequences per update")
    updates: int = required(1, 10**6, help="updates per round")
    max_gradient_norm: float = required(
        0.0, 1e6, help="largest gradient norm, of the critics and of the actor separately"
    )
    critic: Aggregation = needed(help="how critics combine the robots")
    critic_width: int = required(8, 4096, help="width of the critics")
    critic_heads: int = required(1, 64, help="heads of the critics' attention")
    robots: int = required(1, 16, help="number of robots, which `concatenation` fixes")
    team_reward: bool = needed(help="every robot receives the sum of all rewards (MSA3C, Eq. 5)")


Statistics = dict[str, list[Tensor]]


@ALGORITHMS.register("soft_actor_critic", SoftActorCriticConfig)
class SoftActorCritic(Algorithm):
    """Twin critics, their target networks, and an actor with an entropy bonus.

    A sequence holds the steps of one world in one round, with the encoder's state from when it was
    collected. The replay buffer is not saved with the run: after a resume, updates continue once it
    holds `learning_starts` steps again.
    """

    policy: SquashedPolicy
    config: SoftActorCriticConfig
    supports_data_parallel = True
    updates: Tensor  # number of critic updates

    def __init__(self, policy: Policy, config: SoftActorCriticConfig) -> None:
        """See `Algorithm`.

        Raises:
            ConfigurationError: the policy's actions cannot be drawn with a gradient, `replay` is
                too small to begin, or the attention cannot be split into heads.
        """
        super().__init__(
            policy, per_process(config, "algorithm", "replay", "learning_starts", "batch")
        )
        team = config.team_reward
        self.reward_shaping = RewardShaping(team_bonus=team, shared=team)
        if not isinstance(policy, SquashedPolicy):
            raise ConfigurationError(
                "algorithm.name is soft_actor_critic; policy.name must be squashed"
            )
        for name, value, requirement, valid in (
            (
                "learning_starts",
                config.learning_starts,
                f"not exceed algorithm.replay ({config.replay})",
                config.learning_starts <= config.replay,
            ),
            (
                "critic_width",
                config.critic_width,
                f"be a multiple of algorithm.critic_heads ({config.critic_heads})",
                config.critic_width % config.critic_heads == 0,
            ),
        ):
            if not valid:
                raise ConfigurationError(f"algorithm.{name} is {value}; it must {requirement}")
        self.critics = nn.ModuleList(self._make_critic() for _ in range(2))
        self.target_critics = nn.ModuleList(self._make_critic() for _ in range(2))
        # For its encoders:
        self.target_policy = type(policy)(policy.config, policy.action_size, policy.sizes)
        self.target_critics.load_state_dict(self.critics.state_dict())
        self.target_policy.load_state_dict(policy.state_dict())
        self.target_critics.requires_grad_(False)
        self.target_policy.requires_grad_(False)
        self.log_temperature = nn.Parameter(torch.tensor(config.temperature_start).log())
        self.register_buffer("updates", torch.zeros((), dtype=torch.long))
        self.to(policy.device)
        self.critic_parameters = [
            *self.critics.parameters(),
            *(p for net in policy.networks for p in net.encoder.parameters()),
        ]
        self.actor_parameters = [p for net in policy.networks for p in net.heads.parameters()]  # type: ignore[attr-defined]
        rate = config.learning_rate
        self.optimisers_by_name = {
            "critics": torch.optim.Adam(self.critic_parameters, lr=rate),
            "actor": torch.optim.Adam(self.actor_parameters, lr=rate),
            "temperature": torch.optim.Adam([self.log_temperature], lr=rate),
        }
        self.replays: dict[tuple[int, ...], ReplayBuffer] = {}  # one for each shape of sequences
        self.steps_stored = 0  # environment steps since the run started or resumed

    def _make_critic(self) -> TeamCritic:
        c, policy = self.config, self.policy
        sizes = policy.networks[0].encoder.features, policy.action_size, c.critic_width
        if c.critic is Aggregation.attention:
            return AttentionCritic(*sizes, c.critic_heads)
        return ConcatenationCritic(*sizes, c.robots)

    @property
    def temperature(self) -> Tensor:
        """The weight of the entropy, alpha."""
        return self.log_temperature.detach().exp()

    def set_progress(self, progress: float) -> None:
        """Decay the learning rate linearly; the actor learns its own noise."""
        self._set_learning_rate(progress)

    def optimisers(self) -> dict[str, Any]:
        """See `Algorithm.optimisers`."""
        return dict(self.optimisers_by_name)

    def update(self, rollouts: list[Rollout]) -> dict[str, float]:
        """Store the sequences of a round, then learn from sampled ones."""
        c = self.config
        for rollout in rollouts:
            self._store(rollout)
        statistics: Statistics = defaultdict(list)
        statistics["charts/temperature"].append(self.temperature)
        if self.steps_stored >= c.learning_starts:
            for _ in range(c.updates):
                self._learn(self._sample(), statistics)
        return {name: float(torch.stack(values).mean()) for name, values in statistics.items()}

    def _learn(self, batch: TensorDict, statistics: Statistics) -> None:
        """Update the critics, and in every `policy_delay`-th call the actor."""
        y = features(self.policy, batch)
        current, following = y[:, :-1], y[:, 1:].detach()
        target = self.targets(batch, following)
        loss, value = self.critic_loss(batch, current, target)
        self._descend("critics", loss, self.critic_parameters, statistics)
        statistics["losses/critic"].append(loss.detach())
        statistics["losses/mean_value"].append(value.detach())
        statistics["losses/mean_target"].append(target[batch["valued"]].mean())
        self.updates += 1
        due = self.updates % self.config.policy_delay == 0
        if due and all(all_gather_object(bool(batch["acts"].any()))):
            loss, log_prob = self.actor_loss(batch, current.detach())
            self._descend("actor", loss, self.actor_parameters, statistics)
            statistics["losses/actor"].append(loss.detach())
            statistics["losses/entropy"].append(-log_prob.mean())
            self._descend("temperature", self.temperature_loss(log_prob), [], statistics)
        self._update_targets()

    @torch.no_grad()
    def targets(self, batch: TensorDict, following: Tensor) -> Tensor:
        """Return the targets of Q, [S, T, N]: r + discount (Q' - alpha log pi') (MSA3C, Eq. 15).

        Args:
            batch: sequences, see `sequences_of`.
            following: [S, T, N, F] the actor's features of the next steps.
        """
        active = batch["active"][:, 1:]
        action, log_prob = self.policy.draw(following)
        action, log_prob = action * active.unsqueeze(-1), log_prob * active
        y = features(self.target_policy, batch)[:, 1:]
        value = q_of(self.target_critics, y, action, action, active).amin(0)
        soft = value - self.temperature * log_prob
        return batch["reward"] + self.config.discount * batch["continues"] * soft

    def critic_loss(self, batch: TensorDict, y: Tensor, target: Tensor) -> tuple[Tensor, Tensor]:
        """Return the loss of both critics (MSA3C, Eq. 14) and the mean of their values."""
        action, where = batch["action"], batch["valued"]
        value = q_of(self.critics, y, action, action, batch["active"][:, :-1])[:, where]
        if not where.any():
            return y.sum() * 0.0, y.new_zeros(())
        return (value - target[where]).square().mean(1).sum(), value.mean()

    def actor_loss(self, batch: TensorDict, y: Tensor) -> tuple[Tensor, Tensor]:
        """Return the actor's loss (MSA3C, Eq. 16) and the log-probabilities of the P samples.

        Each robot's own action varies while those of the others stay as they were executed.
        """
        where, active = batch["acts"], batch["active"][:, :-1]
        action, log_prob = self.policy.draw(y)
        self.critics.requires_grad_(False)
        value = q_of(self.critics, y, action, batch["action"], active).amin(0)
        loss = (self.temperature * log_prob - value)[where].mean()
        self.critics.requires_grad_(True)
        return loss, log_prob[where].detach()

    def temperature_loss(self, log_prob: Tensor) -> Tensor:
        """Return the temperature's loss: alpha rises while the entropy is below -A."""
        return -self.log_temperature * (log_prob - self.policy.action_size).mean()

    def _descend(
        self, name: str, loss: Tensor, clipped: Sequence[Tensor], statistics: Statistics
    ) -> None:
        """Take a step of one optimiser."""
        optimiser = self.optimisers_by_name[name]
        optimiser.zero_grad(set_to_none=True)
        loss.backward()
        average_gradients(p for group in optimiser.param_groups for p in group["params"])
        if clipped:
            norm = nn.utils.clip_grad_norm_(clipped, self.config.max_gradient_norm)
            if not torch.isfinite(norm):
                raise FloatingPointError(f"the gradient of the {name} is not finite")
            statistics[f"losses/{name}_gradient_norm"].append(norm)
        optimiser.step()

    @torch.no_grad()
    def _update_targets(self) -> None:
        """Move the target networks towards the networks by `target_rate`."""
        for target, network in (
            (self.target_critics, self.critics),
            (self.target_policy, self.policy),
        ):
            for slow, fast in zip(target.parameters(), network.parameters(), strict=True):
                slow.lerp_(fast, self.config.target_rate)

    def _store(self, rollout: Rollout) -> None:
        """Add the sequences of a rollout to the replay buffer."""
        c = self.config
        if c.critic is Aggregation.concatenation and rollout.robots != c.robots:
            raise ConfigurationError(
                f"algorithm.robots is {c.robots}; it must be {rollout.robots}, as the scenario's, "
                "for algorithm.critic concatenation"
            )
        sequences = sequences_of(rollout, c.team_reward)
        shape = tuple(sequences["frames", "humans"].shape[1:])
        steps = sequences["reward"].shape[1]
        if shape not in self.replays:
            storage = LazyTensorStorage(max(c.replay // steps, 1), device=self.policy.device)
            self.replays[shape] = ReplayBuffer(storage=storage)
        self.replays[shape].extend(sequences)
        self.steps_stored += rollout.environment_steps

    def _sample(self) -> TensorDict:
        """Sample sequences of one shape; larger replay buffers are sampled more often."""
        replays = list(self.replays.values())
        sizes = torch.tensor([float(len(replay)) for replay in replays])
        batch: TensorDict = replays[int(sizes.multinomial(1))].sample(self.config.batch)
        return batch


def q_of(
    critics: Iterable[nn.Module], y: Tensor, own: Tensor, others: Tensor, active: Tensor
) -> Tensor:
    """Return Q of each critic, [2, ..., N]; see `TeamCritic.forward`."""
    return torch.stack([critic(y, own, others, active) for critic in critics])


def features(policy: SquashedPolicy, batch: TensorDict) -> Tensor:
    """Return Y of all robots in all steps and in the one after them, [S, T + 1, N, F]."""
    frames = Observation.from_arrays(batch["frames"]).apply(lambda part: part.flatten(0, 1))
    states = tuple(
        {name: part.flatten(0, 1) for name, part in batch.get(f"encoder {i}", {}).items()}
        for i in range(len(policy.networks))
    )
    y = policy.features(Sequences(frames, batch["is_init"].flatten(0, 1), states))
    return y.unflatten(0, batch["frames", "ego"].shape[:2]).transpose(1, 2)


def sequences_of(rollout: Rollout, team: bool) -> TensorDict:
    """Return the sequences of a rollout in the form of the replay buffer.

    A robot's own value ends when it arrives. The team's value continues without it, so the steps in
    which it waits have values too. Where the time limit or a team-mate's collision cut an episode
    short, the last step is removed (see `advantages.Streams`); such a collision ends the team's
    value.

    With `team` the reward is shared by the team.

    Returns:
        [S] with `frames` (the parts of `Frames`, [S, N, h + T + 1, ...]), `is_init` [S, N,
        h + T + 1], `encoder I`, the state of the encoder of set I of parameters, [S, N / sets,
        ...], if it has any; `action` [S, T, N, A] in [-1, 1]; `reward` [S, T, N]; `active` [S,
        T + 1, N]; `valued`, critics learn from the step; `acts`, the actor does; `continues`, the
        value does not end with it.
    """
    steps, s, n = rollout.steps, len(rollout.steps), rollout.robots
    after, active = steps["next", "agents"], steps["agents", "active_mask"]
    if team:
        ends = after["terminated"].any(-1, keepdim=True).expand_as(after["terminated"])
        steps = steps.clone(recurse=False)
        steps["next", "agents", "terminated"] = ends
        stream = streams(steps)
        valued, continues = stream.counts, ~stream.terminated
    else:
        stream = streams(steps)
        valued, continues = stream.acts, ~stream.terminated & active[:, 1:]
    sequences = TensorDict(
        {
            "frames": {
                k: part.unflatten(0, (s, n)) for k, part in rollout.frames.arrays("known").items()
            },
            "is_init": rollout.is_init.unflatten(0, (s, n)),
            "action": steps["agents", "action"][:, :-1].tanh(),
            "reward": after["reward"][:, :-1],
            "active": active,
            "valued": valued,
            "acts": stream.acts,
            "continues": continues,
        },
        [s],
    )
    for i, state in enumerate(rollout.encoder):
        if state:
            sequences[f"encoder {i}"] = {k: part.unflatten(0, (s, -1)) for k, part in state.items()}
    return sequences
