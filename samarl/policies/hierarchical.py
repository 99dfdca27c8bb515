"""SAMARL's two levels: a macro actor that picks waypoints, a local actor that drives to them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import Enum
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from mrsan import Observation, RewardParts, Scenario
from mrsan.fields import required
from samarl.encoders import Encoder
from samarl.encoders.encoder import samples_of
from samarl.observations.features import (
    EGO_PLACE,
    EGO_TARGET,
    EGO_TIME,
    A,
    features_of_target,
    to_body,
    to_world,
)
from samarl.observations.frames import Frames
from samarl.policies.explanation import Explanation
from samarl.policies.flat import MEAN, STD
from samarl.policies.heads import Gaussian, log_prob
from samarl.policies.policy import (
    LOCAL,
    MACRO,
    POLICIES,
    TOLD,
    Decision,
    Known,
    Level,
    Networks,
    Policy,
    PolicyConfig,
    State,
    progress_to,
)
from samarl.registry import needed

REACHED = 0.3  # m, a waypoint


class Waypoints(Enum):
    """Where the waypoints of the local level come from; all but the first are ablations."""

    learned = "the macro level"
    first = "the macro level, once in an episode"
    random = "anywhere the macro level could put them"
    shuffled = "the macro level, which answers for the next robot instead"


@dataclass
class HierarchicalConfig(PolicyConfig):
    """Numbers of the two levels."""

    macro_steps: int = required(1, 200, help="steps K for which a waypoint is kept")
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
class HierarchicalPolicy(Policy):
    """The macro level asks the scene with the goal, the local one with the waypoint (Fig. 2).

    Without `local_goal` the local level knows of the world only what surrounds it and its
    waypoint: where the robot goes is decided by the macro level alone.
    """

    levels = (MACRO, LOCAL)
    waypoints = Waypoints.learned

    def _make_networks(self, encoder: Encoder) -> Networks:
        n, y, hidden = self.action_size, encoder.features, self.config.hidden
        heads = {
            MACRO: Gaussian(y, hidden, (0.0, 0.0), (0.1, 0.1)),
            LOCAL: Gaussian(y + TOLD, hidden, MEAN[n], STD[n]),
        }
        return Networks(encoder, heads)

    def __init__(self, config: HierarchicalConfig, action_size: int) -> None:
        """See `Policy`."""
        super().__init__(config, action_size)
        self._random = np.random.default_rng(0)  # of random waypoints

    def initial_state(self, worlds: int, scenario: Scenario) -> State:
        """See `Policy.initial_state`; with the waypoints in the world frame and their clocks."""
        return {
            **super().initial_state(worlds, scenario),
            "waypoint": np.zeros((worlds, scenario.robots, 2), np.float32),
            "clock": np.zeros((worlds, scenario.robots), np.int32),
        }

    def _decide(
        self, scene: Any, ego: Tensor, rows: Tensor, known: Known, state: State, explore: bool
    ) -> tuple[dict[str, Level], Tensor, Tensor, Tensor]:
        """A waypoint is due after K steps, or where the last one was reached."""
        state["clock"][known.is_init] = 0
        due = known.active & (state["clock"] <= 0)
        if self.waypoints is not Waypoints.first:
            distance = np.linalg.norm(to_body(state["waypoint"], known.ego), axis=-1)
            due |= known.active & (distance < REACHED)
        macro, probability = torch.zeros(*due.shape, 2), torch.zeros(due.shape)
        if due.any():
            asked = known.active if self.waypoints is Waypoints.shuffled else due
            asking = torch.from_numpy(asked[known.active]).to(rows.device)
            mean, std = self._ask(MACRO, samples_of(scene, asking), ego[asking], None, rows[asking])
            mean, std = mean.float().cpu(), std.float().cpu()
            action = mean + std * torch.randn(mean.shape) if explore else mean
            where = torch.from_numpy(asked)
            macro[where], probability[where] = action, log_prob(action, mean, std)
            self._set_waypoints(state, known, due, self._ablated(macro.numpy()))
        state["clock"] -= 1
        told = told_of(torch.from_numpy(to_body(state["waypoint"], known.ego)))
        active = torch.from_numpy(known.active)
        mine = told[active].to(ego.device)
        mean, std = self._ask(LOCAL, scene, self._local_query(ego, mine), mine, rows)
        return {MACRO: Level(macro, probability, torch.from_numpy(due))}, told, mean, std

    def _choices(
        self, scene: Any, ego: Tensor, rows: Tensor, told: Tensor, asked: Mapping[str, Tensor]
    ) -> dict[str, tuple[Tensor, Tensor]]:
        due = asked[MACRO]
        return {
            MACRO: self._ask(MACRO, samples_of(scene, due), ego[due], None, rows[due]),
            LOCAL: self._ask(LOCAL, scene, self._local_query(ego, told), told, rows),
        }

    def memory_alone(self, robots: int, humans: int) -> dict[str, Tensor]:
        """See `Policy.memory_alone`; with the waypoint in the world frame and its clock."""
        return {
            **super().memory_alone(robots, humans),
            "waypoint": torch.zeros(1, 2),
            "clock": torch.zeros(1, dtype=torch.long),
        }

    def drive_alone(
        self, frames: Frames, ego: Tensor, aim: Tensor, begins: Tensor, state: State
    ) -> Tensor:
        """See `Policy.drive_alone`; the same as `_decide`."""
        scene, row = self._seen_alone(frames, begins, state), torch.zeros(1, dtype=torch.long)
        own, clock = frames.ego[:, 0], torch.where(begins, 0, state["clock"])
        due = (clock <= 0) | (to_body(state["waypoint"], ego).norm(dim=-1) < REACHED)
        macro, _ = self._ask(MACRO, scene, own, None, row)
        proposed = to_world(self._target(aim, macro), ego)
        state["waypoint"] = torch.where(due.unsqueeze(-1), proposed, state["waypoint"])
        state["clock"] = torch.where(due, self.config.macro_steps, clock) - 1
        told = told_of(to_body(state["waypoint"], ego))
        mean, _ = self._ask(LOCAL, scene, self._local_query(own, told), told, row)
        return mean

    def rewards(
        self, reward: NDArray[np.float32], parts: RewardParts, before: Observation,
        after: Observation, state: State, scenario: Scenario,
    ) -> dict[str, NDArray[np.float32]]:  # fmt: skip
        """The task's reward to the macro level; the local one is paid for following waypoints.

        It is paid for arriving as well, by more than following waypoints for ever would be worth:
        else it circles.
        """
        nearer = np.float32(self.config.waypoint_progress) * progress_to(
            state["waypoint"], before, after
        )
        local = parts.collision + parts.discomfort + parts.lookahead
        local += np.where(parts.progress != 0.0, nearer, np.float32(0.0))
        arrived = parts.arrival > 0.0
        local += parts.arrival + np.float32(self.config.arrival_bonus) * arrived
        return {MACRO: self._route_reward(reward, parts, before, after, scenario), LOCAL: local}

    @torch.no_grad()
    def explain(self, decision: Decision, state: State) -> Explanation:
        """See `Policy.explain`; with the waypoints."""
        attention = super().explain(decision, state) or Explanation()
        return attention._replace(waypoint=state["waypoint"].copy())

    def _ablated(self, macro: NDArray[np.float32]) -> NDArray[np.float32]:
        """The macro actions [E, N, 2] that are taken up."""
        if self.waypoints is Waypoints.shuffled:
            return np.roll(macro, -1, axis=1)
        if self.waypoints is Waypoints.random:
            return self._random.uniform(-1, 1, macro.shape).astype(np.float32)
        return macro

    def _set_waypoints(
        self, state: State, known: Known, due: NDArray[np.bool_], macro: NDArray[np.float32]
    ) -> None:
        """Take up macro actions [E, N, 2] where they are due."""
        target = self._target(self._route(known.ego, known.scenario), macro)
        state["waypoint"][due] = to_world(target, known.ego)[due]
        once = self.waypoints is Waypoints.first
        state["clock"][due] = np.iinfo(np.int32).max if once else self.config.macro_steps

    def _target(self, aim: A, macro: A) -> A:
        """The waypoints [..., 2] in the body frame that macro actions [..., 2] mean.

        The waypoint is a point on the route, as far ahead as `waypoint_ahead`, moved by the macro
        action in [-1, 1] times `waypoint_range`: zero means "along the route". A local level that
        is not told the goal could not arrive if waypoints were moved as far there: where less than
        `waypoint_ahead` is left they are moved by so much less.

        Args:
            aim: where the route leads next in the body frame, [..., 2] in m.
            macro: before clipping.
        """
        c, x, y = self.config, aim[..., 0], aim[..., 1]
        left = ((x * x + y * y) ** 0.5).clip(min=1e-6)[..., None]
        share = (c.waypoint_ahead / left).clip(max=1.0)
        reach = c.waypoint_range
        if not c.local_goal:
            reach = reach * (left / c.waypoint_ahead).clip(max=1.0)
        return aim * share + reach * macro.clip(-1.0, 1.0)

    def _given(self, frames: Frames) -> Frames:
        """Without `local_goal` the scene does not tell the goal either: both levels share it."""
        if self.config.local_goal:
            return frames
        return frames._replace(ego=without_goal(frames.ego))

    def _local_query(self, ego: Tensor, told: Tensor) -> Tensor:
        """The robot's own state [P, F_e] with the waypoint in the place of the goal."""
        if self.config.local_goal:
            return ego
        query = without_goal(ego)
        query[..., EGO_TARGET] = features_of_target(2.0 * told[..., 0:2])
        return query


def told_of(waypoint: Tensor) -> Tensor:
    """What the local level is told, [..., TOLD], of a waypoint in the body frame [..., 2], m."""
    return torch.cat([waypoint / 2.0, torch.exp(-waypoint.norm(dim=-1, keepdim=True))], -1)


def without_goal(ego: Tensor) -> Tensor:
    """Own states [..., F_e] that tell neither the goal nor the place nor the time."""
    blind = ego.clone()
    for hidden in (EGO_TARGET, EGO_PLACE, EGO_TIME):
        blind[..., hidden] = 0.0
    return blind
