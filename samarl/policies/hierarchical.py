"""SAMARL's two levels: a macro actor that picks waypoints, a local actor that drives to them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import Enum
from typing import Any

import numpy as np
import torch
from torch import Tensor
from torch.jit import is_tracing  # type: ignore[attr-defined]

from mrsan import Scenario
from mrsan.fields import required
from samarl.encoders import Encoder
from samarl.encoders.encoder import samples_of
from samarl.observations.features import (
    EGO_PLACE,
    EGO_TARGET,
    EGO_TIME,
    features_of_target,
    to_body,
    to_world,
)
from samarl.observations.frames import FeatureSizes, Frames
from samarl.policies.explanation import Explanation
from samarl.policies.flat import MEAN, STD
from samarl.policies.heads import Gaussian, log_prob
from samarl.policies.policy import (
    LOCAL,
    MACRO,
    POLICIES,
    Decision,
    LevelStep,
    Networks,
    PolicyConfig,
    PolicyState,
    PolicyStep,
)
from samarl.policies.stochastic import ExplorationNoise, StochasticPolicy
from samarl.registry import needed

REACHED = 0.3  # m; a waypoint that is nearer is replaced
WAYPOINT_FEATURES = 3  # see `encode_waypoint`
NEVER = 2**31 - 1  # steps until the next waypoint is due


class Waypoints(Enum):
    """Where the waypoints of the local level come from; all but the first are ablations."""

    learned = "the macro level"
    first = "the macro level, once in an episode"
    random = "anywhere the macro level could put them"
    shuffled = "the macro level's choice for the next robot"


@dataclass
class HierarchicalConfig(PolicyConfig):
    """Numbers of the two levels."""

    macro_steps: int = required(1, 200, help="steps between two waypoints, K")
    waypoint_ahead: float = required(
        0.1, 100.0, unit="m", help="distance of the default waypoint along the route"
    )
    waypoint_range: float = required(
        0.1, 100.0, unit="m", help="largest distance by which the macro level moves a waypoint"
    )
    waypoint_progress: float = required(
        0.0, 100.0, help="reward of the local level per metre towards its waypoint"
    )
    local_goal: bool = needed(help="the local level also observes the goal")
    arrival_bonus: float = required(
        0.0, 1000.0, help="additional reward of the local level for arriving"
    )


@POLICIES.register("hierarchical", HierarchicalConfig)
class HierarchicalPolicy(StochasticPolicy):
    """The macro level chooses waypoints and the local level drives to them (SAMARL, Fig. 2).

    Both read the same scene: the macro level with the goal in the query, the local level with the
    waypoint. Without `local_goal` the local level knows only its surroundings and its waypoint, so
    the macro level alone decides where the robot goes.
    """

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
            LOCAL: Gaussian(y + WAYPOINT_FEATURES, hidden, MEAN[n], STD[n]),
        }
        return Networks(encoder, heads)

    def action_sizes(self) -> dict[str, int]:
        """See `StochasticPolicy.action_sizes`; a macro action moves the waypoint in the plane."""
        return {MACRO: 2, LOCAL: self.action_size}

    def initial_policy_state(self, rows: int, scenario: Scenario) -> PolicyState:
        """See `StochasticPolicy.initial_policy_state`; with the waypoints and their clocks."""
        return {
            **super().initial_policy_state(rows, scenario),
            "waypoint": torch.zeros(rows, 2, device=self.device),  # in the world frame, m
            "steps_left": torch.zeros(rows, dtype=torch.long, device=self.device),
        }

    def step(
        self,
        features: Frames,
        pose: Tensor,
        route: Tensor,
        is_init: Tensor,
        state: PolicyState,
        noise: ExplorationNoise | None = None,
    ) -> tuple[PolicyStep, PolicyState]:
        """See `StochasticPolicy.step`. A waypoint is due after K steps, or when it is reached."""
        scene = self._encode(features, is_init, state)
        ego, rows = features.ego[:, 0], torch.arange(len(is_init), device=is_init.device)
        steps_left = torch.where(is_init, 0, state["steps_left"])
        due = steps_left <= 0
        if self.waypoint_source is not Waypoints.first:
            due = due | (to_body(state["waypoint"], pose).norm(dim=-1) < REACHED)
        macro = self._macro_step(scene, ego, rows, due, noise)
        chosen = to_world(self._waypoint_of(route, self._ablated(macro)), pose)
        waypoint = torch.where(due.unsqueeze(-1), chosen, state["waypoint"])
        period = NEVER if self.waypoint_source is Waypoints.first else self.config.macro_steps
        steps_left = torch.where(due, period, steps_left) - 1

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
        following = {"noise": current, "waypoint": waypoint, "steps_left": steps_left}
        return step, {**state, **following}

    def _macro_step(
        self, scene: Any, ego: Tensor, rows: Tensor, due: Tensor, noise: ExplorationNoise | None
    ) -> LevelStep:
        """Choose macro actions where they are due; elsewhere they are arbitrary."""
        # Few robots need a waypoint at a time: only their rows are computed, unless the graph is
        # traced for export or the ablation uses the choices of other robots.
        everybody = is_tracing() or self.waypoint_source is Waypoints.shuffled
        index = rows if everybody else due.nonzero().squeeze(1)
        if len(index) == 0:
            return LevelStep(ego.new_zeros(len(rows), 2), ego.new_zeros(len(rows)), due)
        embedding = self._embedding(samples_of(scene, index), ego[index], rows[index])
        mean, std = self.distribution(MACRO, embedding, rows[index])
        if noise is None:
            action, probability = mean, torch.zeros_like(mean[:, 0])
        else:
            action = mean + std * noise.fresh[MACRO][index]
            probability = log_prob(action, mean, std)
        if everybody:
            return LevelStep(action, probability, due)
        return LevelStep(
            action.new_zeros(len(rows), 2).index_copy(0, index, action),
            probability.new_zeros(len(rows)).index_copy(0, index, probability),
            due,
        )

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
        """Return the macro actions [B, 2] that are used."""
        action = macro.action
        if self.waypoint_source is Waypoints.shuffled:
            return action.view(-1, self.team_size, 2).roll(-1, 1).view_as(action)
        if self.waypoint_source is Waypoints.random and macro.decided.any():
            return torch.from_numpy(self._random.uniform(-1, 1, action.shape)).to(action)
        return action

    def _waypoint_of(self, route: Tensor, macro: Tensor) -> Tensor:
        """Return the waypoints [B, 2] in the body frame (m) of macro actions [B, 2].

        A waypoint is a point on the route, `waypoint_ahead` in front of the robot, moved by the
        macro action in [-1, 1] times `waypoint_range`; zero means "along the route". Where less
        than `waypoint_ahead` of the route remains, waypoints are moved by proportionally less:
        a local level that does not see the goal could not arrive otherwise.

        Args:
            route: [B, 2] where the route leads next in the body frame, m.
            macro: [B, 2] before clipping.
        """
        c = self.config
        distance = route.norm(dim=-1, keepdim=True).clamp(min=1e-6)
        share = (c.waypoint_ahead / distance).clamp(max=1.0)
        reach = c.waypoint_range
        if not c.local_goal:
            reach = reach * (distance / c.waypoint_ahead).clamp(max=1.0)
        return route * share + reach * macro.clamp(-1.0, 1.0)

    def _encoder_input(self, features: Frames) -> Frames:
        """Without `local_goal` the scene, which both levels share, must not reveal the goal."""
        if self.config.local_goal:
            return features
        return features._replace(ego=without_goal(features.ego))

    def _local_query(self, ego: Tensor, waypoint_features: Tensor) -> Tensor:
        """Return own states [P, F_e], with the waypoint in place of a goal that is hidden."""
        if self.config.local_goal:
            return ego
        query = without_goal(ego)
        query[..., EGO_TARGET] = features_of_target(decode_waypoint(waypoint_features))
        return query


def encode_waypoint(waypoint: Tensor) -> Tensor:
    """Return the features [..., 3] of a waypoint in the body frame [..., 2], m."""
    return torch.cat([waypoint / 2.0, torch.exp(-waypoint.norm(dim=-1, keepdim=True))], -1)


def decode_waypoint(features: Tensor) -> Tensor:
    """Return the waypoint in the body frame [..., 2], m; the inverse of `encode_waypoint`."""
    return 2.0 * features[..., 0:2]


def without_goal(ego: Tensor) -> Tensor:
    """Return own states [..., F_e] without the goal, the place and the time."""
    blind = ego.clone()
    for hidden in (EGO_TARGET, EGO_PLACE, EGO_TIME):
        blind[..., hidden] = 0.0
    return blind
