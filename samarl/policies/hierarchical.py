"""SAMARL's two levels: a macro actor that picks waypoints, a local actor that drives to them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.jit import is_tracing  # type: ignore[attr-defined]

from mrsan import ConfigurationError, Observation, Scenario
from samarl.encoders import Encoder
from samarl.encoders.encoder import samples_of
from samarl.observations.features import (
    AGENT_SIZES,
    EGO_ROUTE,
    EGO_TARGET,
    NETWORK_OTHER_FEATURES,
    features_of_target,
    team_mates,
    to_body,
    to_world,
)
from samarl.observations.frames import FeatureSizes, Frames
from samarl.observations.tracker import TRACK_FEATURES, Tracks
from samarl.policies.explanation import Explanation
from samarl.policies.flat import MEAN, STD
from samarl.policies.heads import Gaussian, ModeAndOffset, ModeGaussian, log_prob
from samarl.policies.macro_actions import (
    HierarchicalConfig,
    Mode,
    Waypoints,
    decode_waypoint,
    encode_macro_action,
    is_blocked,
    makes_way,
    waypoint_of,
    waypoint_size,
    with_waypoints,
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
PATIENCE = 4  # steps after a decision before a robot that is blocked decides again
NEVER = 2**31 - 1  # steps until the next waypoint is due


@POLICIES.register("hierarchical", HierarchicalConfig)
class HierarchicalPolicy(StochasticPolicy):
    """The macro level chooses waypoints and the local level drives to them (SAMARL, Fig. 2).

    Both read the same scene: the macro level with the goal in the query, the local level with the
    waypoint. Without `local_goal` the local level does not know the goal, so the macro level
    decides where the robot goes; in places with walls it still sees the next corner of the route,
    unless the policy has modes.
    """

    config: HierarchicalConfig
    levels = (MACRO, LOCAL)
    waypoint_source = Waypoints.learned
    team_size = 1  # N, for shuffled waypoints

    def __init__(
        self, config: HierarchicalConfig, action_size: int, sizes: FeatureSizes | None = None
    ) -> None:
        """See `Policy`."""
        sizes = AGENT_SIZES if sizes is None else sizes
        if config.observes_intent and sizes.entities["robots"] == NETWORK_OTHER_FEATURES:
            robots = NETWORK_OTHER_FEATURES + waypoint_size(config)
            sizes = replace(sizes, entities=sizes.entities | {"robots": robots})
        super().__init__(config, action_size, sizes)
        self._random = np.random.default_rng(0)  # of random waypoints

    def _make_networks(self, encoder: Encoder) -> Networks:
        n, y, hidden = self.action_size, encoder.features, self.config.hidden
        offset = y, hidden, (0.0, 0.0), (0.1, 0.1)
        heads = {
            MACRO: ModeGaussian(*offset, len(Mode)) if self.config.modes else Gaussian(*offset),
            LOCAL: Gaussian(y + self.waypoint_size, hidden, MEAN[n], STD[n]),
        }
        return Networks(encoder, heads)

    @property
    def _replaces_route(self) -> bool:
        """Return whether the local level has its waypoint in place of the route round walls.

        It has with modes; policies without modes were trained with the route.
        """
        return bool(self.config.modes) and self.observes_route

    @property
    def waypoint_size(self) -> int:
        """See `Policy.waypoint_size`."""
        return waypoint_size(self.config)

    def has_modes(self, level: str) -> bool:
        """See `Policy.has_modes`."""
        return level == MACRO and bool(self.config.modes)

    def action_sizes(self) -> dict[str, int]:
        """See `StochasticPolicy.action_sizes`.

        A macro action is the mode, if the policy has modes, and by how much the waypoint is moved.
        """
        return {MACRO: 2 + self.config.modes, LOCAL: self.action_size}

    @property
    def _decides_independently(self) -> bool:
        """See there; robots may observe or be given the waypoints of team-mates that arrived."""
        own = self.waypoint_source in (Waypoints.learned, Waypoints.first)
        return super()._decides_independently and own and not self.config.observes_intent

    def check(self, scenario: Scenario) -> None:
        """See `Policy.check`; intent is not delayed, limited or lost as other reports are.

        Raises:
            ConfigurationError: as there, or robots observe intent and reports are limited.
        """
        super().check(scenario)
        if not (self.config.observes_intent and scenario.team_tracks):
            return
        for name in ("team_range", "team_delay", "team_loss"):
            value, default = getattr(scenario, name), getattr(Scenario, name)
            if value != default:
                raise ConfigurationError(
                    f"scenario.{name} is {value}; it must be {default} with "
                    "policy.observes_intent=true: intent reaches every team-mate, at once"
                )

    def initial_policy_state(self, rows: int, scenario: Scenario) -> PolicyState:
        """See `StochasticPolicy.initial_policy_state`; with the waypoints and their clocks."""
        state = {
            **super().initial_policy_state(rows, scenario),
            "waypoint": torch.zeros(rows, 2, device=self.device),  # in the world frame, m
            "steps_left": torch.zeros(rows, dtype=torch.long, device=self.device),
        }
        if self.config.modes:
            state["mode"] = torch.zeros_like(state["steps_left"])
        return state

    def _as_trained(self, tracks: Tracks) -> Tracks:
        """See `Policy._as_trained`; the waypoints of team-mates are zero unless they are known."""
        tracks = super()._as_trained(tracks)
        features, known = tracks.entities["robots"]
        if not self.config.observes_intent or features.shape[-1] > len(TRACK_FEATURES):
            return tracks
        return with_waypoints(tracks, np.zeros((*known.shape, self.waypoint_size), np.float32))

    def _track(
        self,
        observation: Observation,
        state: PolicyState,
        is_init: NDArray[np.bool_],
        scenario: Scenario,
    ) -> Tracks:
        """See `Policy._track`; team-mates report the waypoints they had in the step before."""
        tracks = super()._track(observation, state, is_init, scenario)
        if not (self.config.observes_intent and scenario.team_tracks):
            return tracks
        waypoints = self.team_waypoints(state, tracks.ego)
        waypoints[is_init] = 0.0
        return with_waypoints(tracks, waypoints)

    def team_waypoints(self, state: PolicyState, ego: NDArray[np.float32]) -> NDArray[np.float32]:
        """See `Policy.team_waypoints`."""
        worlds, n = ego.shape[:2]
        others = team_mates(n)
        waypoint = state["waypoint"].view(worlds, n, 2).cpu().numpy()
        in_body = to_body(waypoint[:, others], ego[:, :, None])
        mode = None
        if self.config.modes:
            mode = state["mode"].view(worlds, n)[:, others].cpu()
        return encode_macro_action(torch.from_numpy(in_body), mode).numpy()

    def step(
        self,
        features: Frames,
        pose: Tensor,
        route: Tensor,
        is_init: Tensor,
        state: PolicyState,
        noise: ExplorationNoise | None = None,
    ) -> tuple[PolicyStep, PolicyState]:
        """See `StochasticPolicy.step`. A new waypoint is due after K steps, or when it is reached.

        With `ends_when_blocked` it is also due when somebody stands in the way. A robot that waits
        or yields does so for all steps of its macro action.
        """
        scene = self._encode(features, is_init, state)
        ego, rows = features.ego[:, 0], torch.arange(len(is_init), device=is_init.device)
        steps_left = torch.where(is_init, 0, state["steps_left"])
        due = steps_left <= 0
        if self.waypoint_source is not Waypoints.first:
            reached = to_body(state["waypoint"], pose).norm(dim=-1) < REACHED
            if self.config.modes:
                reached = reached & ~makes_way(state["mode"])
            due = due | reached
        if self.config.ends_when_blocked:
            due = due | self._blocked(features, pose, state)
        macro = self._macro_step(scene, ego, rows, due, noise)
        macro_action = self._ablated(macro)
        chosen = to_world(waypoint_of(self.config, route, macro_action, features), pose)
        waypoint = torch.where(due.unsqueeze(-1), chosen, state["waypoint"])
        steps_left = torch.where(due, self._duration(macro_action), steps_left) - 1

        following = {"waypoint": waypoint, "steps_left": steps_left}
        if self.config.modes:
            following["mode"] = torch.where(due, macro_action[:, 0].long(), state["mode"])
        waypoint_features = encode_macro_action(to_body(waypoint, pose), following.get("mode"))
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
        return step, {**state, **following, "noise": current}

    def _blocked(self, features: Frames, pose: Tensor, state: PolicyState) -> Tensor:
        """Return which robots [B] go, but have been stopped `PATIENCE` steps after they decided."""
        c = self.config
        blocked = is_blocked(features, to_body(state["waypoint"], pose))
        blocked = blocked & (state["steps_left"] <= c.macro_steps - PATIENCE)
        return blocked & ~makes_way(state["mode"]) if c.modes else blocked

    def _duration(self, macro: Tensor) -> Tensor:
        """Return the largest number of steps [B] of macro actions [B, A]."""
        c = self.config
        duration = torch.full_like(macro[:, 0], c.macro_steps).long()
        if self.waypoint_source is Waypoints.first:
            return torch.full_like(duration, NEVER)
        if c.modes:
            duration = torch.where(makes_way(macro[:, 0]), c.making_way_steps, duration)
        return duration

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
        fresh = None if noise is None else noise.fresh[MACRO][index]
        action, probability = self._sample_macro(embedding, rows[index], fresh)
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
        zero = torch.zeros_like(mean[:, 0])
        if not self.config.modes:
            if noise is None:
                return mean, zero
            action = mean + std * noise
            return action, log_prob(action, mean, std)
        distribution = ModeAndOffset(self.mode_logits(MACRO, embedding, rows), mean, std)
        if noise is None:
            return distribution.deterministic_sample, zero
        action = distribution.from_noise(noise)
        return action, distribution.log_prob(action)

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
            drawn = torch.from_numpy(self._random.uniform(-1, 1, action.shape)).to(action)
            if self.config.modes:
                modes = self._random.integers(len(Mode), size=len(action))
                drawn[:, 0] = torch.from_numpy(modes).to(drawn)
            return drawn
        return action

    def _encoder_input(self, features: Frames) -> Frames:
        """Without `local_goal` the scene, which both levels share, must not reveal the goal."""
        if self.config.local_goal:
            return features
        return features._replace(ego=without_goal(features.ego, self._replaces_route))

    def _local_query(self, ego: Tensor, waypoint_features: Tensor) -> Tensor:
        """Return the own states [P, F_e] with which the local level queries the scene.

        The waypoint takes the place of the goal and, with modes, of the route; with `local_goal`
        and without modes they are unchanged.
        """
        c = self.config
        if c.local_goal and not c.modes:
            return ego
        query = ego.clone() if c.local_goal else without_goal(ego, self._replaces_route)
        target = features_of_target(decode_waypoint(waypoint_features))
        query[..., EGO_TARGET] = target
        if self._replaces_route:
            query[..., EGO_ROUTE] = target
        return query
