"""Policies with action distributions: one decision, and its probability.

Shapes as in `samarl.policies.policy`.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.utils._pytree import tree_map

from mrsan import Observation, Scenario
from samarl.encoders.encoder import samples_of
from samarl.observations.frames import Frames
from samarl.planning.velocity_control import stop_fully
from samarl.policies.heads import given_previous_noise, log_prob
from samarl.policies.policy import (
    LOCAL,
    Decision,
    LevelStep,
    Policy,
    PolicyState,
    PolicyStep,
)

if TYPE_CHECKING:
    from tensordict import TensorDict
    from torchrl.modules import ProbabilisticActor


class ExplorationNoise(NamedTuple):
    """Standard normal numbers of one step; see `StochasticPolicy.draw_noise`."""

    innovation: dict[str, Tensor]  # of each level, [B, A], independent of the step before
    initial: Tensor  # [B, A] the local level's noise before the first step of an episode
    correlation: float  # of the local level's noise from step to step


class Distribution(NamedTuple):
    """A diagonal Gaussian over actions before they are bounded, in P samples."""

    mean: Tensor  # [P, A]
    std: Tensor  # [P, A]


class Sequences(NamedTuple):
    """What B robots perceived in T steps."""

    features: Frames  # [B, h + T, ...] the first h are history
    is_init: Tensor  # [B, h + T] whether an episode begins with a frame
    encoder_states: tuple[Any, ...]  # of each set of parameters, before the first step


class ActionEvaluation(NamedTuple):
    """Distribution and probability of the actions of one level in Q samples."""

    mean: Tensor  # [Q, A]
    std: Tensor  # [Q, A]
    log_prob: Tensor  # [Q]
    entropy: Tensor  # [Q]


class StochasticPolicy(Policy):
    """A policy with a Gaussian head for each level, which policy gradients can train."""

    @abstractmethod
    def step(
        self,
        features: Frames,
        pose: Tensor,
        route: Tensor,
        is_init: Tensor,
        state: PolicyState,
        noise: ExplorationNoise | None = None,
    ) -> tuple[PolicyStep, PolicyState]:
        """Decide for B robots: all robots of E worlds, or one.

        Args:
            features: [B, 1, ...] the robots' view of themselves and of others.
            pose: [B, 11] their own states as observed, `mrsan.EGO_FEATURES`.
            route: [B, 2] where their routes lead next in the body frame, m.
            is_init: [B] bool; these rows begin an episode and their memory is cleared.
            state: from `initial_policy_state` or the previous step. Its tensors may be written to,
                so it must not be used afterwards.
            noise: for exploration; None: take the means.

        Returns:
            What was decided, and the next state.
        """

    @abstractmethod
    def _embeddings(
        self,
        scene: Any,
        ego: Tensor,
        rows: Tensor,
        waypoint_features: Tensor | None,
        decision_indices: Mapping[str, Tensor],
    ) -> dict[str, Tensor]:
        """Return the embedding of each level in Q of the P samples, [Q, Y].

        Args:
            scene: [P, ...].
            ego: [P, F_e].
            rows: [P] see `Policy._per_parameter_set`.
            waypoint_features: [P, 3]; None without a macro level.
            decision_indices: [Q] which of the samples, for each level.
        """

    def action_sizes(self) -> dict[str, int]:
        """Return how many numbers an action of each level has."""
        return {LOCAL: self.action_size}

    def initial_policy_state(self, rows: int, scenario: Scenario) -> PolicyState:
        """Return the memory of B robots before their first step."""
        example = self.empty_frames(scenario, rows // len(self.networks))
        return {
            "encoder": tuple(net.encoder.initial_state(example) for net in self.networks),
            "noise": torch.zeros(rows, self.action_size, device=self.device),
        }

    def initial_state(self, worlds: int, scenario: Scenario) -> PolicyState:
        """See `Policy.initial_state`; with the memory of the networks."""
        return {
            **super().initial_state(worlds, scenario),
            **self.initial_policy_state(worlds * scenario.robots, scenario),
        }

    @torch.no_grad()
    def act(
        self,
        observation: Observation,
        state: PolicyState,
        is_init: NDArray[np.bool_],
        scenario: Scenario,
        correlation: float | None = None,
        active: NDArray[np.bool_] | None = None,
    ) -> Decision:
        """See `Policy.act`: `step` for all robots of E worlds.

        Without exploration, only active robots are computed where robots decide independently.
        """
        shape, device = observation.ego.shape[:2], self.device

        def per_row(values: NDArray[Any]) -> Tensor:
            return torch.from_numpy(np.ascontiguousarray(values)).flatten(0, 1).to(device)

        route = self.route(observation, scenario)
        tracks = self._track(observation, state, is_init, scenario)
        if self.observes_route:
            tracks = tracks._replace(sensors={**tracks.sensors, "route": route})
        policy_state = {name: value for name, value in state.items() if name != "tracks"}
        noise = None
        if correlation is not None:
            noise = self.draw_noise(shape[0] * shape[1], correlation)
        inputs = (
            per_row(observation.ego),
            per_row(route),
            per_row(np.repeat(is_init[:, None], shape[1], 1)),
            policy_state,
        )
        if noise is not None or not self._decides_independently:
            active = None
        seen = tracks if active is None else tracks.of_robots(active)
        features = self.extract_features(seen, scenario)
        if active is None:
            step, policy_state = self.step(features, *inputs, noise)
        else:
            step, policy_state = self._step_of(per_row(active), features, *inputs)
        state.update(policy_state)
        scene = step.scene if noise is None else None

        def per_robot(tensor: Tensor | None) -> Tensor | None:
            return None if tensor is None else tensor.view(*shape, *tensor.shape[1:]).cpu()

        step = tree_map(per_robot, step._replace(scene=None))
        action = stop_fully(step.action.numpy(), observation.ego, self.config.stop_speed, scenario)
        step = step._replace(action=torch.from_numpy(action))
        return Decision(step, tracks, features, scene)

    @property
    def _decides_independently(self) -> bool:
        """Return whether what a robot does is the same whatever others are computed with it."""
        return len(self.networks) == 1

    def _step_of(
        self,
        active: Tensor,
        features: Frames,
        pose: Tensor,
        route: Tensor,
        is_init: Tensor,
        state: PolicyState,
    ) -> tuple[PolicyStep, PolicyState]:
        """Return `step` of the active robots; others get zeros, and keep their memory.

        Args:
            active: [B] bool, true for R of them.
            features: [R, 1, ...]; the following are as in `step`, [B, ...].
            pose: own states.
            route: where the routes lead next.
            is_init: an episode begins.
            state: the memory.
        """
        rows = active.nonzero().squeeze(1)
        step, state_of_rows = self.step(
            features,
            pose[rows],
            route[rows],
            is_init[rows],
            tree_map(lambda tensor: tensor[rows], state),
        )

        def spread(tensor: Tensor | None) -> Tensor | None:
            if tensor is None:
                return None
            return tensor.new_zeros(len(active), *tensor.shape[1:]).index_copy(0, rows, tensor)

        def updated(before: Tensor, after: Tensor) -> Tensor:
            return before.index_copy_(0, rows, after)

        step = tree_map(spread, step._replace(scene=None))
        return step, tree_map(updated, state, state_of_rows)

    def draw_noise(self, rows: int, correlation: float) -> ExplorationNoise:
        """Draw the exploration noise of B robots in one step, on the CPU for reproducibility."""

        def normal(size: int) -> Tensor:
            return torch.randn(rows, size).to(self.device)

        innovation = {level: normal(size) for level, size in self.action_sizes().items()}
        return ExplorationNoise(innovation, normal(self.action_size), correlation)

    def embed(
        self,
        sequences: Sequences,
        samples: Tensor,
        waypoint_features: Tensor | None,
        decision_indices: Mapping[str, Tensor],
    ) -> dict[str, Tensor]:
        """Encode whole sequences as `step` did; return the input of each level's `actor`.

        Args:
            sequences: what B robots perceived in T steps.
            samples: [P] which of the steps, as b T + t.
            waypoint_features: [P, 3] of the local level; None without a macro level.
            decision_indices: [Q] in which of the samples each level decided.

        Returns:
            [Q, Y] for each level.
        """
        features, is_init, encoder_states = sequences
        steps, sets = features.ego.shape[1] - self.history, len(self.networks)
        rows, step = samples // steps, samples % steps
        visible = self._encoder_input(features)

        def observe(net: Any, i: int, samples: Any) -> Any:
            return net.encoder.observe(
                visible.select(slice(i, None, sets)),
                is_init[i::sets],
                encoder_states[i],
                rows[samples] // sets * steps + step[samples],
            )

        scene = self._per_parameter_set(rows, observe)
        ego = features.ego[rows, self.history + step]
        return self._embeddings(scene, ego, rows, waypoint_features, decision_indices)

    def actor(self, level: str) -> ProbabilisticActor:
        """Return a level as TorchRL's actor, which its losses accept; see `make_actor`."""
        # Imported here because it imports TorchRL, which takes seconds and only training needs.
        from samarl.policies.torchrl_actor import make_actor

        return make_actor(self, level)

    def evaluate(
        self,
        sequences: Sequences,
        samples: Tensor,
        waypoint_features: Tensor | None,
        decisions: Mapping[str, TensorDict],
    ) -> dict[str, ActionEvaluation]:
        """Recompute the distributions of `step` and the probability of what was done.

        Args:
            sequences: what B robots perceived in T steps.
            samples: [P] which of the steps, as b T + t.
            waypoint_features: [P, 3] of the local level; None without a macro level.
            decisions: of each level: TensorDicts [Q] with `index` (which of the samples),
                `action`, and for the local level `previous_noise` and `noise_correlation`.
        """
        indices = {level: batch["index"] for level, batch in decisions.items()}
        embeddings = self.embed(sequences, samples, waypoint_features, indices)
        steps = sequences.features.ego.shape[1] - self.history
        evaluations = {}
        for level, embedding in embeddings.items():
            rows = samples[indices[level]] // steps
            batch = decisions[level].clone(False).update({"embedding": embedding, "row": rows})
            distribution = self.actor(level).get_dist(batch)
            evaluations[level] = ActionEvaluation(
                batch["mean"],
                batch["std"],
                distribution.log_prob(batch["action"]),
                distribution.entropy(),
            )
        return evaluations

    @torch.no_grad()
    def resume(self, features: Frames, is_init: Tensor, state: PolicyState, rows: Tensor) -> None:
        """Recompute the encoder memory of some robots from their last frames.

        See `Encoder.resume`; `rows` [R] are whole worlds, in order.
        """
        sets = len(self.networks)
        for i, net in enumerate(self.networks):
            own_rows = slice(i, None, sets)
            net.encoder.resume(
                self._encoder_input(features).select(own_rows),
                is_init[own_rows],
                state["encoder"][i],
                rows[own_rows] // sets,
            )

    def memory(self, state: PolicyState) -> PolicyState:
        """Return the part of a state that `resume` cannot recompute; not copied."""
        encoder = tuple(
            net.encoder.memory(encoder_state)
            for net, encoder_state in zip(self.networks, state["encoder"], strict=True)
        )
        return {**state, "encoder": encoder}

    def bound_std(self, level: str, least: float, largest: float) -> None:
        """Clamp the standard deviation of a level; `largest` wins where the two disagree."""
        for net in self.networks:
            net.heads[level].bound_std(least, largest)

    # Parts of `step`

    def _encode(self, features: Frames, is_init: Tensor, state: PolicyState) -> Any:
        """Return the scene [B, ...] of one more frame; the encoder's memory is written to."""
        sets, visible = len(self.networks), self._encoder_input(features)
        rows = torch.arange(len(is_init), device=is_init.device)

        def encode(net: Any, i: int, samples: Any) -> Any:
            own_rows = slice(i, None, sets)
            return net.encoder.step(
                visible.select(own_rows), is_init[own_rows], state["encoder"][i]
            )

        return self._per_parameter_set(rows, encode)

    def _encoder_input(self, features: Frames) -> Frames:
        """Return what the encoder may see of the features."""
        return features

    def _embedding(
        self, scene: Any, query: Tensor, rows: Tensor, waypoint_features: Tensor | None = None
    ) -> Tensor:
        """Return the embedding [P, Y] of a scene [P, ...] for the queries [P, F_e] of a level."""

        def read(net: Any, index: int, samples: Any) -> Tensor:
            y: Tensor = net.encoder.read(samples_of(scene, samples), query[samples])
            return y

        embedding: Tensor = self._per_parameter_set(rows, read)
        if waypoint_features is None:
            return embedding
        return torch.cat([embedding, waypoint_features], -1)

    def distribution(self, level: str, embedding: Tensor, rows: Tensor) -> Distribution:
        """Return the distribution of a level's actions for embeddings [P, Y], without condition."""

        def head(net: Any, index: int, samples: Any) -> Distribution:
            return Distribution(*net.heads[level](embedding[samples]))

        return Distribution(*self._per_parameter_set(rows, head))

    def _sample_local(
        self,
        distribution: Distribution,
        is_init: Tensor,
        state: PolicyState,
        noise: ExplorationNoise | None,
    ) -> tuple[Tensor, LevelStep, Tensor, Tensor]:
        """Draw the local level's actions with noise that is correlated from step to step.

        Returns:
            The means, what was drawn, the noise of the step before, and that of this step.
        """
        mean, std = distribution
        everywhere = torch.ones_like(is_init)
        if noise is None:
            zero = torch.zeros_like(mean[:, 0])
            return mean, LevelStep(mean, zero, everywhere), state["noise"], state["noise"]
        rho = noise.correlation
        previous = torch.where(is_init.unsqueeze(-1), noise.initial, state["noise"])
        current = rho * previous + (1.0 - rho**2) ** 0.5 * noise.innovation[LOCAL]
        action = mean + std * current
        loc, scale = given_previous_noise(mean, std, previous, rho)
        level = LevelStep(action, log_prob(action, loc, scale), everywhere)
        return mean, level, previous, current
