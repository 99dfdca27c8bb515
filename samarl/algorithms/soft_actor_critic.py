"""Multi-robot soft actor-critic on sequences: MSA3C, and with other critics MLGA2C and MASAC.

The encoder of the policy feeds actor and critics (MSA3C, Fig. 5). It learns from the critics alone:
the actor is given its features as they are, as it would otherwise change what it is judged by.
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

from mrsan import ConfigurationError
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
from samarl.observations.frames import Frames
from samarl.policies.policy import Policy
from samarl.policies.squashed import SquashedPolicy
from samarl.policies.stochastic import Sequences
from samarl.registry import needed
from samarl.rollout import Rollout


@dataclass
class SoftActorCriticConfig:
    """Numbers of the update."""

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


@ALGORITHMS.register("soft_actor_critic", SoftActorCriticConfig)
class SoftActorCritic(Algorithm):
    """Twin critics, their slow copies, and an actor that is paid for being undecided.

    A sequence is what a world did in one round, with the encoder's state as it was when collected.
    The replay is not saved with the run: after a resume it fills up to `learning_starts` again
    before updates go on.
    """

    policy: SquashedPolicy
    supports_data_parallel = True
    updates: Tensor  # until now

    def __init__(self, policy: Policy, config: Any) -> None:
        """See `Algorithm`.

        Raises:
            ConfigurationError: the policy's actions cannot be drawn with a gradient, `replay` is
                too small to begin, or the attention cannot be split into heads.
        """
        super().__init__(
            policy, per_process(config, "algorithm", "replay", "learning_starts", "batch")
        )
        if not isinstance(policy, SquashedPolicy):
            raise ConfigurationError(
                "algorithm.name is soft_actor_critic; policy.name must be squashed"
            )
        for name, value, right, good in (
            ("learning_starts", config.learning_starts, f"not exceed algorithm.replay "
             f"({config.replay})", config.learning_starts <= config.replay),
            ("critic_width", config.critic_width, f"be a multiple of algorithm.critic_heads "
             f"({config.critic_heads})", config.critic_width % config.critic_heads == 0),
        ):  # fmt: skip
            if not good:
                raise ConfigurationError(f"algorithm.{name} is {value}; it must {right}")
        self.critics = nn.ModuleList(self._make_critic() for _ in range(2))
        self.target_critics = nn.ModuleList(self._make_critic() for _ in range(2))
        self.target_policy = type(policy)(policy.config, policy.action_size)  # for its encoders
        self.target_critics.load_state_dict(self.critics.state_dict())
        self.target_policy.load_state_dict(policy.state_dict())
        self.target_critics.requires_grad_(False)
        self.target_policy.requires_grad_(False)
        self.log_temperature = nn.Parameter(torch.tensor(config.temperature_start).log())
        self.register_buffer("updates", torch.zeros((), dtype=torch.long))
        self.to(policy.device)
        self.valuing = [
            *self.critics.parameters(),
            *(p for net in policy.networks for p in net.encoder.parameters()),
        ]
        self.acting = [p for net in policy.networks for p in net.heads.parameters()]  # type: ignore[attr-defined]
        rate = config.learning_rate
        self.adams = {
            "critics": torch.optim.Adam(self.valuing, lr=rate),
            "actor": torch.optim.Adam(self.acting, lr=rate),
            "temperature": torch.optim.Adam([self.log_temperature], lr=rate),
        }
        self.replays: dict[tuple[int, ...], ReplayBuffer] = {}  # one for each shape of sequences
        self.kept = 0  # environment steps since the run began or went on

    def _make_critic(self) -> TeamCritic:
        c, policy = self.config, self.policy
        sizes = policy.networks[0].encoder.features, policy.action_size, c.critic_width
        if c.critic is Aggregation.attention:
            return AttentionCritic(*sizes, c.critic_heads)
        return ConcatenationCritic(*sizes, c.robots)

    @property
    def temperature(self) -> Tensor:
        """What entropy is worth, alpha."""
        return self.log_temperature.detach().exp()

    def set_progress(self, share: float) -> None:
        """The learning rate falls linearly; the actor sees to the noise."""
        self._set_learning_rate(share)

    def optimisers(self) -> dict[str, Any]:
        """See `Algorithm.optimisers`."""
        return dict(self.adams)

    def update(self, rollouts: list[Rollout]) -> dict[str, float]:
        """Keep the sequences of a round, then learn from drawn ones."""
        c = self.config
        for rollout in rollouts:
            self._keep(rollout)
        found: dict[str, list[Tensor]] = defaultdict(list)
        found["charts/temperature"].append(self.temperature)
        if self.kept >= c.learning_starts:
            for _ in range(c.updates):
                self._learn(self._draw(), found)
        return {name: float(torch.stack(values).mean()) for name, values in found.items()}

    def _learn(self, batch: TensorDict, found: dict[str, list[Tensor]]) -> None:
        """One update of the critics, and every `policy_delay` of them one of the actor."""
        y = features(self.policy, batch)
        now, later = y[:, :-1], y[:, 1:].detach()
        target = self.targets(batch, later)
        loss, value = self.critic_loss(batch, now, target)
        self._descend("critics", loss, self.valuing, found)
        found["losses/critic"].append(loss.detach())
        found["losses/mean_value"].append(value.detach())
        found["losses/mean_target"].append(target[batch["valued"]].mean())
        self.updates += 1
        due = self.updates % self.config.policy_delay == 0
        if due and all(all_gather_object(bool(batch["acts"].any()))):
            loss, log_prob = self.actor_loss(batch, now.detach())
            self._descend("actor", loss, self.acting, found)
            found["losses/actor"].append(loss.detach())
            found["losses/entropy"].append(-log_prob.mean())
            self._descend("temperature", self.temperature_loss(log_prob), [], found)
        self._follow()

    @torch.no_grad()
    def targets(self, batch: TensorDict, later: Tensor) -> Tensor:
        """What Q is regressed on, [S, T, N]: r + discount (Q' - alpha log pi') (MSA3C, Eq. 15).

        Args:
            batch: sequences, see `sequences_of`.
            later: [S, T, N, F] the actor's features of the next steps.
        """
        on_way = batch["active"][:, 1:]
        action, log_prob = self.policy.draw(later)
        action, log_prob = action * on_way.unsqueeze(-1), log_prob * on_way
        y = features(self.target_policy, batch)[:, 1:]
        value = q_of(self.target_critics, y, action, action, on_way).amin(0)
        soft = value - self.temperature * log_prob
        return batch["reward"] + self.config.discount * batch["going"] * soft

    def critic_loss(self, batch: TensorDict, y: Tensor, target: Tensor) -> tuple[Tensor, Tensor]:
        """The squared errors of both critics (MSA3C, Eq. 14), and the mean of their values."""
        action, where = batch["action"], batch["valued"]
        value = q_of(self.critics, y, action, action, batch["active"][:, :-1])[:, where]
        if not where.any():
            return y.sum() * 0.0, y.new_zeros(())
        return (value - target[where]).square().mean(1).sum(), value.mean()

    def actor_loss(self, batch: TensorDict, y: Tensor) -> tuple[Tensor, Tensor]:
        """What the actor makes small (MSA3C, Eq. 16), and the log-probabilities of the P samples.

        Every robot changes its own action among those that the others took.
        """
        where, on_way = batch["acts"], batch["active"][:, :-1]
        action, log_prob = self.policy.draw(y)
        self.critics.requires_grad_(False)
        value = q_of(self.critics, y, action, batch["action"], on_way).amin(0)
        loss = (self.temperature * log_prob - value)[where].mean()
        self.critics.requires_grad_(True)
        return loss, log_prob[where].detach()

    def temperature_loss(self, log_prob: Tensor) -> Tensor:
        """Entropy is worth more while there is less of it than -A."""
        return -self.log_temperature * (log_prob - self.policy.action_size).mean()

    def _descend(
        self, name: str, loss: Tensor, clipped: Sequence[Tensor], found: dict[str, list[Tensor]]
    ) -> None:
        """A step against the gradient."""
        optimiser = self.adams[name]
        optimiser.zero_grad(set_to_none=True)
        loss.backward()
        average_gradients(p for group in optimiser.param_groups for p in group["params"])
        if clipped:
            norm = nn.utils.clip_grad_norm_(clipped, self.config.max_gradient_norm)
            if not torch.isfinite(norm):
                raise FloatingPointError(f"the gradient of the {name} is not finite")
            found[f"losses/{name}_gradient_norm"].append(norm)
        optimiser.step()

    @torch.no_grad()
    def _follow(self) -> None:
        """The slow copies go `target_rate` of the way."""
        for slow, fast in (
            (self.target_critics, self.critics), (self.target_policy, self.policy)
        ):  # fmt: skip
            for behind, ahead in zip(slow.parameters(), fast.parameters(), strict=True):
                behind.lerp_(ahead, self.config.target_rate)

    def _keep(self, rollout: Rollout) -> None:
        """Keep the sequences of a rollout."""
        c = self.config
        if c.critic is Aggregation.concatenation and rollout.robots != c.robots:
            raise ConfigurationError(
                f"algorithm.robots is {c.robots}; it must be {rollout.robots}, as the scenario's, "
                "for algorithm.critic concatenation"
            )
        found = sequences_of(rollout, c.team_reward)
        shape = tuple(found["frames", "humans"].shape[1:])
        steps = found["reward"].shape[1]
        if shape not in self.replays:
            storage = LazyTensorStorage(max(c.replay // steps, 1), device=self.policy.device)
            self.replays[shape] = ReplayBuffer(storage=storage)
        self.replays[shape].extend(found)
        self.kept += rollout.environment_steps

    def _draw(self) -> TensorDict:
        """A batch of sequences of one shape; a replay that holds more is drawn from more often."""
        replays = list(self.replays.values())
        sizes = torch.tensor([float(len(replay)) for replay in replays])
        drawn: TensorDict = replays[int(sizes.multinomial(1))].sample(self.config.batch)
        return drawn


def q_of(
    critics: Iterable[nn.Module], y: Tensor, own: Tensor, others: Tensor, active: Tensor
) -> Tensor:
    """Q of each critic, [2, ..., N]; see `TeamCritic.forward`."""
    return torch.stack([critic(y, own, others, active) for critic in critics])


def features(policy: SquashedPolicy, batch: TensorDict) -> Tensor:
    """Y of all robots in all steps and in the one after them, [S, T + 1, N, F]."""
    frames = Frames(*(part.flatten(0, 1) for part in Frames(**batch["frames"])))
    states = tuple(
        {name: part.flatten(0, 1) for name, part in batch.get(f"encoder {i}", {}).items()}
        for i in range(len(policy.networks))
    )
    y = policy.features(Sequences(frames, batch["is_init"].flatten(0, 1), states))
    return y.unflatten(0, batch["frames", "ego"].shape[:2]).transpose(1, 2)


def sequences_of(rollout: Rollout, team: bool) -> TensorDict:
    """What there is to learn from a rollout.

    A robot's own value ends when it arrives. The team's goes on without it: then the steps in which
    it waits have values too. Where the time limit cut an episode short, or a team-mate's collision,
    the last step is left out (see `advantages.Streams`); that collision ends the team's value.

    Args:
        rollout: S sequences of T steps.
        team: robots are paid what all of them are paid.

    Returns:
        [S] with `frames` (the parts of `Frames`, [S, N, h + T + 1, ...]), `is_init` [S, N,
        h + T + 1], `encoder I`, the state of the encoder of set I of parameters, [S, N / sets,
        ...], if it has any; `action` [S, T, N, A] in [-1, 1]; `reward` [S, T, N]; `active` [S,
        T + 1, N]; `valued`, critics learn from the step; `acts`, the actor does; `going`, the value
        does not end with it.
    """
    steps, s, n = rollout.steps, len(rollout.steps), rollout.robots
    after, active = steps["next", "agents"], steps["agents", "active_mask"]
    if team:
        ends = after["terminated"].any(-1, keepdim=True).expand_as(after["terminated"])
        reward = after["reward"].sum(-1, keepdim=True).expand_as(after["reward"])
        steps = steps.clone(recurse=False)
        steps["next", "agents", "terminated"] = ends
        of = streams(steps)
        valued, going = of.counts, ~of.terminated
    else:
        of, reward = streams(steps), after["reward"] - after["team_reward"]
        valued, going = of.acts, ~of.terminated & active[:, 1:]
    found = TensorDict(
        {
            "frames": {
                k: part.unflatten(0, (s, n)) for k, part in rollout.frames._asdict().items()
            },
            "is_init": rollout.is_init.unflatten(0, (s, n)),
            "action": steps["agents", "action"][:, :-1].tanh(),
            "reward": reward[:, :-1],
            "active": active,
            "valued": valued,
            "acts": of.acts,
            "going": going,
        },
        [s],
    )
    for i, state in enumerate(rollout.encoder):
        if state:
            found[f"encoder {i}"] = {k: part.unflatten(0, (s, -1)) for k, part in state.items()}
    return found
