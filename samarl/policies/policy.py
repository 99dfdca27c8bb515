"""The interface of what has parameters and drives.

The same object collects experience, is trained and is deployed, so all of them see the same.
Shapes: E worlds, N robots, B = E N robots of all worlds (robot n of world e is e N + n), A numbers
per action, P samples, each one step of one robot.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn
from torch.distributions import Normal
from torch.utils._pytree import tree_map

from mrsan import ConfigurationError, Observation, RewardParts, Scenario
from mrsan.features import GOAL
from mrsan.scenario import required
from samarl.encoders import ENCODERS, Encoder
from samarl.encoders.encoder import samples_of
from samarl.observations.features import (
    NETWORK_EGO_FEATURES,
    NETWORK_OTHER_FEATURES,
    frames_of,
    to_world,
)
from samarl.observations.frames import Frames
from samarl.observations.route import route
from samarl.observations.tracker import Tracker, Tracks
from samarl.policies.explanation import Explanation
from samarl.policies.heads import log_prob
from samarl.registry import Registry, needed

POLICIES: Registry[Policy] = Registry("policy")

LOCAL = "local"  # the level that drives; every policy has it
TOLD = 3  # numbers that it is told of its waypoint
MACRO = "macro"  # the level above, which picks waypoints
State = dict[str, Any]  # nested dicts and tuples of tensors and arrays, [E, ...] or [B, ...]


@dataclass
class PolicyConfig:
    """What all policies share."""

    actors: int = required(1, 16)  # sets of parameters: 1 for all robots, or one for each
    hidden: int = required(8, 4096)  # of the heads
    track_time: float = required(0.0, 1000.0)  # those out of view are remembered so long, s
    round_below: float = required(0.0, 360.0)  # a narrower view goes round the crowd, degrees ...
    round_radius: float = required(0.1, 1000.0)  # ... on a circle about the origin, m
    encoder: dict[str, Any] = needed()  # its name and numbers
    known_origin: bool = field(default=True, kw_only=True)  # of the map; where its middle is


class Level(NamedTuple):
    """What one level decided, of E worlds or of P samples."""

    action: Tensor  # [E, N, A] before it is bounded
    log_prob: Tensor  # [E, N] given the noise of the step before
    decided: Tensor  # [E, N] bool: it decided something in this step

    @property
    def bounded(self) -> Tensor:
        """The action as it is carried out, [E, N, A] in [-1, 1]."""
        return self.action.clamp(-1.0, 1.0)


class Decision(NamedTuple):
    """What was decided for all robots in one step."""

    levels: dict[str, Level]
    noise: Tensor  # [E, N, A] of the local level in the step before, in standard deviations
    target: Tensor  # [E, N, TOLD] what the local level was told
    mean: Tensor  # [E, N, A] what the local level would do without noise
    tracks: Tracks  # [E, N, ...] what was known
    frames: Frames  # [B, 1, ...] the same, as the encoders are given it
    scene: Any = ()  # [B, ...] what the encoders made of it; kept when not exploring

    @property
    def action(self) -> NDArray[np.float32]:
        """The action of every robot, [E, N, A] in [-1, 1]."""
        return self.levels[LOCAL].bounded.numpy()


class Known(NamedTuple):
    """What is given to `Policy._decide` besides the scenes."""

    ego: NDArray[np.float32]  # [E, N, 11] own states as observed
    active: NDArray[np.bool_]  # [E, N] the robots to decide for
    is_init: NDArray[np.bool_]  # [E]
    scenario: Scenario


class Sequences(NamedTuple):
    """What B robots knew in T steps."""

    frames: Frames  # [B, h + T, ...] the first h are history
    is_init: Tensor  # [B, h + T] whether an episode begins with a frame
    states: tuple[Any, ...]  # of the encoder of each set of parameters, before the first step


class Taken(NamedTuple):
    """What a level did in Q of P samples."""

    where: Tensor  # [Q] which of the samples
    action: Tensor  # [Q, A] before clipping
    noise: Tensor  # [Q, A] of the step before; nothing to the macro level


class Choice(NamedTuple):
    """How likely a level is to do what it did, in P samples."""

    mean: Tensor  # [P, A]
    std: Tensor  # [P, A]
    log_prob: Tensor  # [P]
    entropy: Tensor  # [P]


class Networks(nn.Module):
    """An encoder and a head for each level, a `Gaussian` unless the policy needs no noise."""

    heads: Mapping[str, Any]

    def __init__(self, encoder: Encoder, heads: Mapping[str, nn.Module]) -> None:
        super().__init__()
        self.encoder = encoder
        self.heads = nn.ModuleDict(heads)  # type: ignore[assignment]


class Policy(nn.Module, ABC):
    """Drives all robots of E worlds, each from its own observations alone."""

    levels: tuple[str, ...] = (LOCAL,)
    networks: Sequence[Networks]

    def __init__(self, config: Any, action_size: int) -> None:
        """Make the networks.

        Args:
            config: its numbers, an instance of the dataclass it is registered with.
            action_size: A.
        """
        super().__init__()
        self.config, self.action_size = config, action_size
        sizes = ENCODERS.config(config.encoder)
        entry = ENCODERS[config.encoder["name"]]
        self.networks = nn.ModuleList(  # type: ignore[assignment]
            self._make_networks(entry.cls(sizes, NETWORK_EGO_FEATURES, NETWORK_OTHER_FEATURES))
            for _ in range(config.actors)
        )
        self.low_precision = False  # encode with bfloat16

    # What a policy adds to the encoder

    @abstractmethod
    def _make_networks(self, encoder: Encoder) -> Networks:
        """The encoder with the heads of all levels."""

    @abstractmethod
    def _decide(
        self, scene: Any, ego: Tensor, rows: Tensor, known: Known, state: State, explore: bool
    ) -> tuple[dict[str, Level], Tensor, Tensor, Tensor]:
        """Decide from the scenes of the R active robots.

        Args:
            scene: [R, ...].
            ego: [R, F_e] their own states.
            rows: [R] which of the B robots.
            known: what all robots know, and which are active.
            state: updated in place.
            explore: draw instead of taking the mean.

        Returns:
            What the levels above the local one decided; what the local one is told,
            [E, N, TOLD]; and its mean and standard deviation, [R, A].
        """

    @abstractmethod
    def _choices(
        self, scene: Any, ego: Tensor, rows: Tensor, told: Tensor, asked: Mapping[str, Tensor]
    ) -> dict[str, tuple[Tensor, Tensor]]:
        """Mean and standard deviation, [Q, A], of each level in some of the P samples.

        Args:
            scene: [P, ...].
            ego: [P, F_e].
            rows: [P].
            told: [P, TOLD].
            asked: [Q] which of the samples, for each level.
        """

    def rewards(
        self, reward: NDArray[np.float32], parts: RewardParts, before: Observation,
        after: Observation, state: State, scenario: Scenario,
    ) -> dict[str, NDArray[np.float32]]:  # fmt: skip
        """What each level is paid for a step, [E, N].

        Args:
            reward: of the task, [E, N].
            parts: what it is the sum of.
            before: what was seen when it was decided.
            after: what is seen after the step, before any reset.
            state: after the decision.
            scenario: the task.
        """
        return {LOCAL: self._route_reward(reward, parts, before, after, scenario)}

    # What all policies share

    @property
    def device(self) -> torch.device:
        """Where the networks are."""
        return next(self.parameters()).device

    @property
    def history(self) -> int:
        """Frames that the encoder needs before the first, h."""
        return int(self.networks[0].encoder.history)

    def initial_state(self, worlds: int, scenario: Scenario) -> State:
        """What is remembered before the first step of E worlds."""
        self.check(scenario)
        n, m, sets = scenario.robots, scenario.humans, len(self.networks)
        example = no_frames(worlds * n // sets, n, m, self.device)
        return {
            "tracks": Tracker(self.config.track_time, scenario.time_step).initial(worlds, n, m),
            "noise": torch.zeros(worlds, n, self.action_size),
            "encoder": tuple(net.encoder.initial_state(example) for net in self.networks),
        }

    @torch.no_grad()
    def act(
        self,
        observation: Observation,
        state: State,
        is_init: NDArray[np.bool_],
        scenario: Scenario,
        correlation: float | None = None,
        active: NDArray[np.bool_] | None = None,
    ) -> Decision:
        """Decide for all robots.

        Args:
            observation: of E worlds.
            state: of the same worlds, updated in place.
            is_init: [E] the worlds in which an episode begins; they remember nothing.
            scenario: the task.
            correlation: explore with noise that is correlated from step to step by so much; None:
                take the means.
            active: [E, N] the robots to decide for; the actions of others are zero. None: all.
        """
        e, n = observation.ego.shape[:2]
        active = np.ones((e, n), np.bool_) if active is None else active
        explore, where = correlation is not None, torch.from_numpy(active)
        rows = torch.from_numpy(np.flatnonzero(active)).to(self.device)
        tracks, frames = self._perceive(observation, state, is_init, scenario)
        now = frames.of(rows)
        begins = torch.from_numpy(np.repeat(is_init, n)).to(self.device)[rows]
        sets = len(self.networks)
        with self._precision():
            scene = self._by_set(
                rows,
                lambda net, i, mine: net.encoder.step(
                    self._given(now).of(mine), begins[mine], state["encoder"][i],
                    rows[mine] // sets,
                ),
            )  # fmt: skip
            known = Known(observation.ego, active, is_init, scenario)
            levels, told, mean, std = self._decide(
                scene, now.ego[:, 0], rows, known, state, explore
            )
        mean, std = mean.float().cpu(), std.float().cpu()
        before = state["noise"]
        means, probability = torch.zeros(e, n, self.action_size), torch.zeros(e, n)
        means[where] = mean
        action = means.clone()
        if correlation is not None:
            began = torch.from_numpy(is_init)
            before = torch.where(began[:, None, None], torch.randn(before.shape), before)
            kept, fresh = correlation * before[where], (1.0 - correlation**2) ** 0.5
            noise = kept + fresh * torch.randn(mean.shape)
            action[where] = mean + std * noise
            probability[where] = log_prob(action[where], mean + std * kept, fresh * std)
            state["noise"] = before.clone()
            state["noise"][where] = noise
        levels[LOCAL] = Level(action, probability, where)
        return Decision(levels, before, told, means, tracks, frames, () if explore else scene)

    def evaluate(
        self, sequences: Sequences, samples: Tensor, told: Tensor, taken: Mapping[str, Taken],
        correlation: float,
    ) -> dict[str, Choice]:  # fmt: skip
        """How likely each level is to do what it did in P samples, as in `act`.

        Args:
            sequences: what B robots knew in T steps.
            samples: [P] which of the steps, as b T + t.
            told: [P, TOLD] what the local level was told.
            taken: what each level did, and where.
            correlation: of the noise of the local level.
        """
        frames, is_init, states = sequences
        steps, sets = frames.ego.shape[1] - self.history, len(self.networks)
        rows, step = samples // steps, samples % steps
        given = self._given(frames)
        with self._precision():
            scene = self._by_set(
                rows,
                lambda net, i, mine: net.encoder.observe(
                    given.of(slice(i, None, sets)), is_init[i::sets], states[i],
                    rows[mine] // sets * steps + step[mine],
                ),
            )  # fmt: skip
            ego = frames.ego[rows, self.history + step]
            asked = {name: did.where for name, did in taken.items()}
            found = self._choices(scene, ego, rows, told, asked)
        choices = {}
        for name, (mean, std) in found.items():
            did, kept = taken[name], correlation if name == LOCAL else 0.0
            mean, std = mean.float(), std.float()
            # The noise of the step before is known, so only the fresh part of it is random.
            expected = mean + kept * std * did.noise if kept else mean
            normal = Normal(expected, (1.0 - kept**2) ** 0.5 * std, validate_args=False)
            choices[name] = Choice(
                mean, std, normal.log_prob(did.action).sum(-1), normal.entropy().sum(-1)
            )
        return choices

    def resume(self, frames: Frames, is_init: Tensor, state: State, rows: Tensor) -> None:
        """Bring the encoders of some robots to what they are after their last frames.

        See `Encoder.resume`; `rows` [R] are whole worlds, in order.
        """
        sets = len(self.networks)
        with torch.no_grad(), self._precision():
            for i, net in enumerate(self.networks):
                mine = slice(i, None, sets)
                net.encoder.resume(
                    self._given(frames).of(mine), is_init[mine], state["encoder"][i],
                    rows[mine] // sets,
                )  # fmt: skip

    def memory(self, state: State) -> State:
        """What must be kept to go back to this state, with the last `history` frames; no copy."""
        kept = tuple(
            net.encoder.memory(of_set)
            for net, of_set in zip(self.networks, state["encoder"], strict=True)
        )
        return {**{k: v for k, v in state.items() if k != "encoder"}, "encoder": kept}

    @torch.no_grad()
    def explain(self, decision: Decision, state: State) -> Explanation | None:
        """What led to a decision without exploration, for pictures: the robots' attention."""
        every = torch.arange(len(decision.frames.ego), device=self.device)
        ego = decision.frames.ego[:, 0]

        def attention(net: Any, i: int, mine: Any) -> Any:
            return net.encoder.attention(samples_of(decision.scene, mine), ego[mine])

        if attention(self.networks[0], 0, slice(0, 1)) is None:
            return None
        found = self._by_set(every, attention)
        robots, humans = (
            share.view(*decision.target.shape[:2], -1).float().cpu().numpy() for share in found
        )
        return Explanation(None, humans, robots)

    def bound_std(self, level: str, least: float, largest: float) -> None:
        """Bring the standard deviation of a level between the two; `largest` wins."""
        for net in self.networks:
            net.heads[level].bound_std(least, largest)

    def check(self, scenario: Scenario) -> None:
        """Refuse a scenario whose robots it cannot drive.

        Raises:
            ConfigurationError: their kinematics or their number is another.
        """
        if self.action_size != scenario.action_size:
            raise ConfigurationError(
                f"scenario.kinematics is {scenario.kinematics.name} with {scenario.action_size} "
                f"numbers per action; this policy has {self.action_size}"
            )
        actors = self.config.actors
        if actors not in (1, scenario.robots):
            raise ConfigurationError(
                f"scenario.robots is {scenario.robots}; it must be {actors} for a policy with "
                "parameters of their own for so many robots"
            )

    # One robot alone, of tensors alone: what is exported, see `samarl.export`

    def memory_alone(self, robots: int, humans: int) -> dict[str, Tensor]:
        """What one robot that knows of `robots` others and `humans` remembers, besides tracks."""
        example = no_frames(1, 1 + robots, humans, self.device)
        return dict(self.networks[0].encoder.initial_state(example))

    def drive_alone(
        self, frames: Frames, ego: Tensor, aim: Tensor, begins: Tensor, state: State
    ) -> Tensor:
        """What `act` decides without exploration, [1, A] before clipping.

        Args:
            frames: [1, 1, ...] what the robot knows.
            ego: [1, 11] its own state as observed.
            aim: [1, 2] where its route leads next in the body frame, m.
            begins: [1] bool: it remembers nothing.
            state: what `memory_alone` describes, updated in place.
        """
        raise ConfigurationError(
            f"{type(self).__name__} has no `drive_alone`, so it cannot be exported"
        )

    # Helpers of the policies

    def _seen_alone(self, frames: Frames, begins: Tensor, state: State) -> Any:
        return self.networks[0].encoder.step(self._given(frames), begins, state)

    def _perceive(
        self, observation: Observation, state: State, is_init: NDArray[np.bool_],
        scenario: Scenario,
    ) -> tuple[Tracks, Frames]:  # fmt: skip
        """What all robots know now, and the same as the encoders are given it; see `act`."""
        tracker = Tracker(self.config.track_time, scenario.time_step)
        tracks = tracker.update(observation, state["tracks"], is_init)
        return tracks, frames_of(tracks, scenario, self.config.known_origin).to(self.device)

    def _given(self, frames: Frames) -> Frames:
        """What the encoder may observe of the frames."""
        return frames

    def _ask(
        self, level: str, scene: Any, query: Tensor, told: Tensor | None, rows: Tensor
    ) -> tuple[Tensor, Tensor]:
        """Mean and standard deviation [P, A] of a level that asks the scene a query [P, F_e]."""

        def ask(net: Any, i: int, mine: Any) -> tuple[Tensor, Tensor]:
            y = net.encoder.read(samples_of(scene, mine), query[mine])
            inputs = y if told is None else torch.cat([y, told[mine]], -1)
            result: tuple[Tensor, Tensor] = net.heads[level](inputs)
            return result

        found: tuple[Tensor, Tensor] = self._by_set(rows, ask)
        return found

    def _by_set(self, rows: Tensor, call: Callable[[Any, int, Any], Any]) -> Any:
        """Let each set of parameters answer for its own robots, and put the answers together.

        Args:
            rows: [P] robots b; row b is of robot b % N and of the set b % sets.
            call: gives the answers of the networks, their number, and which of the P are its own.
        """
        sets = len(self.networks)
        if sets == 1:
            return call(self.networks[0], 0, slice(None))
        mine = [(rows % sets == i).nonzero().squeeze(1) for i in range(sets)]
        found = [call(net, i, mine[i]) for i, net in enumerate(self.networks)]
        order = torch.cat(mine).argsort()
        return tree_map(lambda *parts: torch.cat(parts)[order], *found)

    def _route(self, ego: NDArray[np.float32], scenario: Scenario) -> NDArray[np.float32]:
        """See `route`."""
        c = self.config
        return route(ego, scenario.fov_degrees, c.round_below, c.round_radius)

    def _route_reward(
        self, reward: NDArray[np.float32], parts: RewardParts, before: Observation,
        after: Observation, scenario: Scenario,
    ) -> NDArray[np.float32]:  # fmt: skip
        """The task's reward, [E, N], with progress along the route instead of to the goal."""
        if scenario.fov_degrees >= self.config.round_below:
            return reward
        target = to_world(self._route(before.ego, scenario), before.ego)
        nearer = progress_to(target, before, after)
        paid = parts.progress != 0.0
        return np.where(
            paid, reward - parts.progress + np.float32(scenario.reward.progress) * nearer, reward
        )

    def _precision(self) -> torch.autocast:
        return torch.autocast(self.device.type, torch.bfloat16, enabled=self.low_precision)


def progress_to(
    target: NDArray[np.float32], before: Observation, after: Observation
) -> NDArray[np.float32]:
    """By how many metres each robot came nearer to a target in the world frame, [E, N]."""
    here, there = (to_world(np.zeros_like(o.ego[..., GOAL]), o.ego) for o in (before, after))
    nearer: NDArray[np.float32] = np.linalg.norm(here - target, axis=-1) - np.linalg.norm(
        there - target, axis=-1
    )
    return nearer


def no_frames(rows: int, robots: int, humans: int, device: torch.device) -> Frames:
    """A frame [B, 1, ...] in which nothing is known."""

    def zeros(*shape: int, dtype: torch.dtype = torch.float32) -> Tensor:
        return torch.zeros(rows, 1, *shape, dtype=dtype, device=device)

    return Frames(
        zeros(NETWORK_EGO_FEATURES),
        zeros(humans, NETWORK_OTHER_FEATURES),
        zeros(humans, dtype=torch.bool),
        zeros(robots - 1, NETWORK_OTHER_FEATURES),
        zeros(robots - 1, dtype=torch.bool),
    )
