"""SAMARL's two levels: a macro actor that picks waypoints, a local actor that drives to them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.jit import is_tracing  # type: ignore[attr-defined]
from torch.linalg import vector_norm

from mrsan import Scenario
from samarl.encoders import Encoder
from samarl.encoders.encoder import samples_of
from samarl.observations.features import (
    EGO_TARGET,
    features_of_target,
    team_mates,
    to_body,
    to_world,
)
from samarl.observations.frames import FeatureSizes, Frames
from samarl.policies.explanation import Explanation
from samarl.policies.flat import MEAN, STD
from samarl.policies.heads import Gaussian, log_prob
from samarl.policies.macro_actions import (
    HierarchicalConfig,
    Waypoints,
    decode_waypoint,
    encode_waypoint,
    waypoint_of,
    without_goal,
)
from samarl.policies.policy import (
    LOCAL,
    MACRO,
    POLICIES,
    Decision,
    LevelStep,
    Networks,
    PolicyState,
    PolicyStep,
)
from samarl.policies.stochastic import ExplorationNoise, StochasticPolicy

REACHED = 0.3  # m; a waypoint that is nearer is replaced
NEVER = 2**31 - 1  # steps until the next waypoint is due


@POLICIES.register("hierarchical", HierarchicalConfig)
class HierarchicalPolicy(StochasticPolicy):
    """The macro level chooses waypoints and the local level drives to them (SAMARL, Fig. 2).

    Both read the same scene: the macro level with the goal in the query, the local level with the
    waypoint. Without `local_goal` the local level does not know the goal, so the macro level
    decides where the robot goes; in walled environments it still sees the next corner of the route.
    """

    config: HierarchicalConfig
    levels = (MACRO, LOCAL)
    waypoint_source = Waypoints.learned
    team_size = 1  # N, for shuffled waypoints

    def __init__(
        self, config: HierarchicalConfig, action_size: int, sizes: FeatureSizes | None = None
    ) -> None:
        """See `Policy`."""
        super().__init__(config, action_size, sizes)
        self._random = np.random.default_rng(0)  # of random waypoints

    def _make_networks(self, encoder: Encoder) -> Networks:
        n, y, hidden = self.action_size, encoder.features, self.config.hidden
        heads = {
            MACRO: Gaussian(y, hidden, (0.0, 0.0), (0.1, 0.1)),
            LOCAL: Gaussian(y + self.waypoint_size, hidden, MEAN[n], STD[n]),
        }
        return Networks(encoder, heads)

    def action_sizes(self) -> dict[str, int]:
        """See `StochasticPolicy.action_sizes`; a macro action moves the waypoint."""
        return {MACRO: 2, LOCAL: self.action_size}

    @property
    def _decides_independently(self) -> bool:
        """See there; robots may be given the waypoints of team-mates that arrived."""
        own = self.waypoint_source in (Waypoints.learned, Waypoints.first)
        return super()._decides_independently and own

    def initial_policy_state(self, rows: int, scenario: Scenario) -> PolicyState:
        """See `StochasticPolicy.initial_policy_state`; with the waypoints and their clocks."""
        return {
            **super().initial_policy_state(rows, scenario),
            "waypoint": torch.zeros(rows, 2, device=self.device),  # in the world frame, m
            "steps_left": torch.zeros(rows, dtype=torch.long, device=self.device),
        }

    def team_waypoints(self, state: PolicyState, ego: NDArray[np.float32]) -> NDArray[np.float32]:
        """See `Policy.team_waypoints`."""
        waypoint = state["waypoint"].view(*ego.shape[:2], 2).cpu().numpy()
        in_body = to_body(waypoint[:, team_mates(ego.shape[1])], ego[:, :, None])
        return encode_waypoint(torch.from_numpy(in_body)).numpy()

    def step(
        self,
        features: Frames,
        pose: Tensor,
        route: Tensor,
        is_init: Tensor,
        state: PolicyState,
        noise: ExplorationNoise | None = None,
    ) -> tuple[PolicyStep, PolicyState]:
        """See `StochasticPolicy.step`; waypoints are replaced after K steps, or when reached."""
        scene = self._encode(features, is_init, state)
        ego, rows = features.ego[:, 0], torch.arange(len(is_init), device=is_init.device)
        steps_left = torch.where(is_init, 0, state["steps_left"])
        due = steps_left <= 0
        if self.waypoint_source is not Waypoints.first:
            due = due | (vector_norm(to_body(state["waypoint"], pose), dim=-1) < REACHED)
        macro = self._macro_step(scene, ego, rows, due, noise)
        chosen = to_world(waypoint_of(self.config, route, self._ablated(macro)), pose)
        waypoint = torch.where(due.unsqueeze(-1), chosen, state["waypoint"])
        duration = NEVER if self.waypoint_source is Waypoints.first else self.config.macro_steps
        steps_left = torch.where(due, duration, steps_left) - 1

        waypoint_features = encode_waypoint(to_body(waypoint, pose))
        query = self._local_query(ego, waypoint_features)
        embedding = self._embedding(scene, query, rows, waypoint_features)
        distribution = self.distribution(LOCAL, embedding, rows)
        mean, local, previous, current = self._sample_local(distribution, is_init, state, noise)
        step = PolicyStep(
            action=local.action.clamp(-1.0, 1.0),
            mean=mean,
            levels={MACRO: macro, LOCAL: local},
            previous_noise=previous,
            waypoint_features=waypoint_features,
            scene=scene,
        )
        return step, {**state, "waypoint": waypoint, "steps_left": steps_left, "noise": current}

    def _macro_step(
        self, scene: Any, ego: Tensor, rows: Tensor, due: Tensor, noise: ExplorationNoise | None
    ) -> LevelStep:
        """Choose macro actions where they are due; the other rows must not be used."""
        # Few robots need a waypoint at a time: only their rows are computed, unless the graph is
        # traced for export or the ablation uses the choices of other robots.
        every_row = is_tracing() or self.waypoint_source is Waypoints.shuffled
        index = rows if every_row else due.nonzero().squeeze(1)
        size = self.action_sizes()[MACRO]
        if len(index) == 0:
            return LevelStep(ego.new_zeros(len(rows), size), ego.new_zeros(len(rows)), due)
        embedding = self._embedding(samples_of(scene, index), ego[index], rows[index])
        normal = None if noise is None else noise.innovation[MACRO][index]
        action, probability = self._sample_macro(embedding, rows[index], normal)
        if every_row:
            return LevelStep(action, probability, due)
        return LevelStep(
            action.new_zeros(len(rows), size).index_copy(0, index, action),
            probability.new_zeros(len(rows)).index_copy(0, index, probability),
            due,
        )

    def _sample_macro(
        self, embedding: Tensor, rows: Tensor, noise: Tensor | None
    ) -> tuple[Tensor, Tensor]:
        """Draw macro actions for embeddings [P, Y] with standard normal noise; None: the best.

        Returns:
            The actions [P, A], and their log-probabilities [P]; 0 without noise.
        """
        mean, std = self.distribution(MACRO, embedding, rows)
        if noise is None:
            return mean, torch.zeros_like(mean[:, 0])
        action = mean + std * noise
        return action, log_prob(action, mean, std)

    def _embeddings(
        self,
        scene: Any,
        ego: Tensor,
        rows: Tensor,
        waypoint_features: Tensor | None,
        decision_indices: Mapping[str, Tensor],
    ) -> dict[str, Tensor]:
        assert waypoint_features is not None
        due, query = decision_indices[MACRO], self._local_query(ego, waypoint_features)
        return {
            MACRO: self._embedding(samples_of(scene, due), ego[due], rows[due]),
            LOCAL: self._embedding(scene, query, rows, waypoint_features),
        }

    @torch.no_grad()
    def explain(self, decision: Decision) -> Explanation:
        """See `Policy.explain`; with the waypoints."""
        attention = super().explain(decision) or Explanation()
        features = decision.step.waypoint_features
        assert features is not None
        ego = decision.tracks.ego
        return attention._replace(waypoint=to_world(decode_waypoint(features).numpy(), ego))

    def _ablated(self, macro: LevelStep) -> Tensor:
        """Return the macro actions [B, A] that are used."""
        action = macro.action
        if self.waypoint_source is Waypoints.shuffled:
            return action.view(-1, self.team_size, action.shape[1]).roll(-1, 1).view_as(action)
        if self.waypoint_source is Waypoints.random and macro.decided.any():
            return torch.from_numpy(self._random.uniform(-1, 1, action.shape)).to(action)
        return action

    def _encoder_input(self, features: Frames) -> Frames:
        """Without `local_goal` the scene, which both levels share, must not reveal the goal."""
        if self.config.local_goal:
            return features
        return features._replace(ego=without_goal(features.ego))

    def _local_query(self, ego: Tensor, waypoint_features: Tensor) -> Tensor:
        """Return the own states [P, F_e] with which the local level queries the scene.

        Without `local_goal` the waypoint takes the place of the goal.
        """
        if self.config.local_goal:
            return ego
        query = without_goal(ego)
        query[..., EGO_TARGET] = features_of_target(decode_waypoint(waypoint_features))
        return query
