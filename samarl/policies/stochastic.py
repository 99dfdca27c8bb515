"""Policies with action distributions: one decision, and its probability.

Shapes as in `samarl.policies.policy`.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.distributions import Normal
from torch.utils._pytree import tree_map

from mrsan import Observation, Scenario
from samarl.encoders.encoder import samples_of
from samarl.observations.frames import Frames
from samarl.policies.policy import (
    LOCAL,
    Decision,
    LevelStep,
    Policy,
    PolicyState,
    PolicyStep,
    empty_features,
)


class ExplorationNoise(NamedTuple):
    """Standard normal numbers of one step; see `StochasticPolicy.draw_noise`."""

    fresh: dict[str, Tensor]  # of each level, [B, A]
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


class ActionBatch(NamedTuple):
    """The actions of one level in Q of P samples."""

    decision_indices: Tensor  # [Q] which of the samples
    action: Tensor  # [Q, A] before it was bounded
    previous_noise: Tensor  # [Q, A] noise of the step before; unused by the macro level


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
    def _distributions(
        self,
        scene: Any,
        ego: Tensor,
        rows: Tensor,
        waypoint_features: Tensor | None,
        decision_indices: Mapping[str, Tensor],
    ) -> dict[str, Distribution]:
        """Return the distribution of each level in Q of the P samples.

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

    def initial_policy_state(self, rows: int, robots: int, humans: int) -> PolicyState:
        """Return the memory of B robots before their first step.

        Args:
            rows: B.
            robots: N, the robot itself included.
            humans: M.
        """
        example = empty_features(rows // len(self.networks), robots, humans, self.device)
        return {
            "encoder": tuple(net.encoder.initial_state(example) for net in self.networks),
            "noise": torch.zeros(rows, self.action_size, device=self.device),
        }

    def initial_state(self, worlds: int, scenario: Scenario) -> PolicyState:
        """See `Policy.initial_state`; with the memory of the networks."""
        n = scenario.robots
        return {
            **super().initial_state(worlds, scenario),
            **self.initial_policy_state(worlds * n, n, scenario.humans),
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
        """See `Policy.act`: `step` for all robots of E worlds."""
        shape = observation.ego.shape[:2]

        def per_row(values: NDArray[Any]) -> Tensor:
            return torch.from_numpy(np.ascontiguousarray(values)).flatten(0, 1).to(self.device)

        tracks, features = self._perceive(observation, state, is_init, scenario)
        policy_state = {name: value for name, value in state.items() if name != "tracks"}
        noise = None
        if correlation is not None:
            noise = self.draw_noise(len(features.ego), correlation)
        with self._precision():
            step, policy_state = self.step(
                features,
                per_row(observation.ego),
                per_row(self._route(observation.ego, scenario)),
                per_row(np.repeat(is_init[:, None], shape[1], 1)),
                policy_state,
                noise,
            )
        state.update(policy_state)
        scene = step.scene if noise is None else None

        def per_robot(tensor: Tensor | None) -> Tensor | None:
            return None if tensor is None else tensor.view(*shape, *tensor.shape[1:]).cpu()

        step = tree_map(per_robot, step._replace(scene=None))
        return Decision(step, tracks, features, scene)

    def draw_noise(self, rows: int, correlation: float) -> ExplorationNoise:
        """Draw the exploration noise of B robots in one step, on the CPU for reproducibility."""

        def normal(size: int) -> Tensor:
            return torch.randn(rows, size).to(self.device)

        fresh = {level: normal(size) for level, size in self.action_sizes().items()}
        return ExplorationNoise(fresh, normal(self.action_size), correlation)

    def evaluate(
        self,
        sequences: Sequences,
        samples: Tensor,
        waypoint_features: Tensor | None,
        actions: Mapping[str, ActionBatch],
        correlation: float,
    ) -> dict[str, ActionEvaluation]:
        """Recompute the distributions of `step` and the probability of what was done.

        Args:
            sequences: what B robots perceived in T steps.
            samples: [P] which of the steps, as b T + t.
            waypoint_features: [P, 3] of the local level; None without a macro level.
            actions: what each level did, and where.
            correlation: of the noise of the local level.
        """
        features, is_init, encoder_states = sequences
        steps, sets = features.ego.shape[1] - self.history, len(self.networks)
        rows, step = samples // steps, samples % steps
        visible = self._encoder_input(features)

        def observe(net: Any, i: int, samples_of_set: Any) -> Any:
            return net.encoder.observe(
                visible.of(slice(i, None, sets)),
                is_init[i::sets],
                encoder_states[i],
                rows[samples_of_set] // sets * steps + step[samples_of_set],
            )

        with self._precision():
            scene = self._per_parameter_set(rows, observe)
            ego = features.ego[rows, self.history + step]
            indices = {level: batch.decision_indices for level, batch in actions.items()}
            distributions = self._distributions(scene, ego, rows, waypoint_features, indices)
        evaluations = {}
        for level, (mean, std) in distributions.items():
            mean, std, batch = mean.float(), std.float(), actions[level]
            rho = correlation if level == LOCAL else 0.0
            normal = _given_previous_noise(mean, std, batch.previous_noise, rho)
            log_prob, entropy = normal.log_prob(batch.action).sum(-1), normal.entropy().sum(-1)
            evaluations[level] = ActionEvaluation(mean, std, log_prob, entropy)
        return evaluations

    def resume(self, features: Frames, is_init: Tensor, state: PolicyState, rows: Tensor) -> None:
        """Recompute the encoder memory of some robots from their last frames.

        See `Encoder.resume`; `rows` [R] are whole worlds, in order.
        """
        sets = len(self.networks)
        with torch.no_grad(), self._precision():
            for i, net in enumerate(self.networks):
                of_set = slice(i, None, sets)
                net.encoder.resume(
                    self._encoder_input(features).of(of_set),
                    is_init[of_set],
                    state["encoder"][i],
                    rows[of_set] // sets,
                )

    def memory(self, state: PolicyState) -> PolicyState:
        """Return the part of a state that `resume` cannot recompute; not copied."""
        encoder = tuple(
            net.encoder.memory(of_set)
            for net, of_set in zip(self.networks, state["encoder"], strict=True)
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
            of_set = slice(i, None, sets)
            return net.encoder.step(visible.of(of_set), is_init[of_set], state["encoder"][i])

        return self._per_parameter_set(rows, encode)

    def _encoder_input(self, features: Frames) -> Frames:
        """Return what the encoder may see of the features."""
        return features

    def _action_distribution(
        self,
        level: str,
        scene: Any,
        query: Tensor,
        rows: Tensor,
        waypoint_features: Tensor | None = None,
    ) -> Distribution:
        """Return the distribution of a level for the queries [P, F_e] to a scene [P, ...]."""

        def distribution(net: Any, index: int, samples: Any) -> Distribution:
            y = net.encoder.read(samples_of(scene, samples), query[samples])
            if waypoint_features is not None:
                y = torch.cat([y, waypoint_features[samples]], -1)
            return Distribution(*net.heads[level](y))

        result: Distribution = self._per_parameter_set(rows, distribution)
        return result

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
        mean, std = distribution.mean.float(), distribution.std.float()
        everywhere = torch.ones_like(is_init)
        if noise is None:
            zero = torch.zeros_like(mean[:, 0])
            return mean, LevelStep(mean, zero, everywhere), state["noise"], state["noise"]
        rho = noise.correlation
        previous = torch.where(is_init.unsqueeze(-1), noise.initial, state["noise"])
        current = rho * previous + (1.0 - rho**2) ** 0.5 * noise.fresh[LOCAL]
        action = mean + std * current
        normal = _given_previous_noise(mean, std, previous, rho)
        level = LevelStep(action, normal.log_prob(action).sum(-1), everywhere)
        return mean, level, previous, current


def _given_previous_noise(mean: Tensor, std: Tensor, previous: Tensor, rho: float) -> Normal:
    """Return the distribution of correlated actions: only the fresh part of the noise is random."""
    expected = mean + rho * std * previous if rho else mean
    return Normal(expected, (1.0 - rho**2) ** 0.5 * std, validate_args=False)
