"""Rollouts of both levels.

Shapes: E worlds, N robots, T steps, K macro decisions, H frames of history, B = E N robots.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields, replace
from typing import Any, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.utils._pytree import tree_map_only

from mrsan import Episodes, Scenario, Split, World
from mrsan.metrics import episodes_of
from samarl.encoders import Frames
from samarl.observations.features import frames_of, state_of, to_world
from samarl.observations.tracker import Tracker, Tracks
from samarl.policies.hierarchical import HierarchicalPolicy, Waypoints, decide
from samarl.training.curriculum import Group
from samarl.training.starts import Crowd, Past

RETRY_STEPS = 16  # a collision is taken back by at most so many


class Steps(NamedTuple):
    """T steps of E worlds; each field is [E, T, N] unless said otherwise."""

    driving: Tensor  # the robot was on its way: the steps that count
    due: Tensor  # a macro decision was taken
    macro: Tensor  # [E, T, N, 2] before clipping to [-1, 1]
    macro_log_prob: Tensor
    waypoint: Tensor  # [E, T, N, 3] what the local level was told
    action: Tensor  # [E, T, N, A] before clipping to [-1, 1]
    action_log_prob: Tensor
    speed: Tensor  # before the step, m/s
    macro_reward: Tensor
    local_reward: Tensor
    done: Tensor  # the robot's stream ends with this step
    terminated: Tensor  # by its arrival or collision; else the time or a team-mate cut it short


@dataclass
class Batch:
    """What happened in one rollout; a row of robot `n` of world `e` is `e * N + n`."""

    scenario: Scenario
    frames: Frames  # [B, T + H - 1, ...] what was known; the first H - 1 are history
    begins: Tensor  # [B, T + H - 1]
    state: Frames  # [B, T + 1, ...] the true state, also after the last step
    steps: Steps
    last_waypoint: Tensor  # [E, N, 3] after the last step
    ends: Tensor  # [R, 2] world and step of the R episodes that ended
    final_state: Frames  # [R N, 1, ...] in which they ended
    final_waypoint: Tensor  # [R, N, 3]
    episodes: list[Episodes]  # their records

    @property
    def environment_steps(self) -> int:
        """E T."""
        return self.steps.done[:, :, 0].numel()

    def to(self, device: torch.device) -> Batch:
        """The same on another device."""

        def move(value: Any) -> Any:
            return tree_map_only(Tensor, lambda tensor: tensor.to(device), value)

        return replace(self, **{f.name: move(getattr(self, f.name)) for f in fields(self)})


class Rollout:
    """Keeps E worlds of one scenario going and collects T steps of them at a time."""

    def __init__(
        self,
        group: Group,
        policy: HierarchicalPolicy,
        steps: int,
        first: int,
        local_discount: float,
        waypoint_progress: float,
    ) -> None:
        """Begin the training cases `first`, `first + 1`, ... in the worlds of `group`.

        Args:
            group: the task, E, and how its episodes begin and actions are explored.
            policy: the networks.
            steps: T.
            first: the first case number within the training split.
            local_discount: per step, of the local level.
            waypoint_progress: reward of the local level per metre nearer to its waypoint.
        """
        scenario, worlds = group.scenario, group.worlds
        self._waypoint_progress = np.float32(waypoint_progress)
        # Following waypoints for ever would be worth so much: arriving must not be worth less.
        step = scenario.robot_speed * scenario.time_step
        self._arrival_bonus = np.float32(waypoint_progress * step / (1.0 - local_discount))
        policy.check(scenario)
        a = policy.architecture
        self.group, self.scenario = group, scenario
        self.policy, self.steps = policy, steps
        self.world = World(scenario, worlds)
        self.tracker = Tracker(a.track_steps, scenario.time_step)
        self.waypoints = Waypoints(worlds, scenario, a)
        cases = np.array([Split.training.case(first + e) for e in range(worlds)])
        self.tracks = self.tracker.update(self.world.reset(cases))
        self.began = np.ones(worlds, np.bool_)
        begun = group.begun_share > 0.0 and self.waypoints.round
        self.crowd = Crowd(scenario, worlds, first) if begun else None
        self.past = Past(RETRY_STEPS)
        for _ in range(RETRY_STEPS if group.retried_share > 0.0 else 0):
            self.past.keep(self._remembered())
        self.age = np.zeros(worlds, np.int32)  # steps since the episode began or was taken back
        self.fresh = np.ones(worlds, np.bool_)  # the episode has not been taken back
        self.noise = torch.randn(worlds, scenario.robots, scenario.action_size)
        frames = frames_of(self.tracks, scenario)
        length = a.history - 1 + steps
        self._frames = Frames(*(_room(tensor, length) for tensor in frames))
        self._begins = torch.ones(worlds * scenario.robots, length, dtype=torch.bool)

    @torch.no_grad()
    def collect(self) -> Batch:
        """T more steps of every world, with exploration noise."""
        policy, scenario, world = self.policy, self.scenario, self.world
        e, n, t = world.worlds, scenario.robots, self.steps
        past = policy.architecture.history - 1
        for tensor in (*self._frames, self._begins):  # the last frames are the history of the next
            tensor[:, :past] = tensor[:, t : t + past].clone()
        frames, begins = self._frames, self._begins
        states: list[Frames] = []
        ends: list[Tensor] = []
        final_states: list[Frames] = []
        final_waypoints: list[Tensor] = []
        self.waypoints.reset(np.ones(e, np.bool_))  # every rollout begins with macro decisions
        columns: list[Steps] = []
        episodes: list[Episodes] = []
        for step in range(t):
            now = past + step
            _store(frames, now, frames_of(self.tracks, scenario))
            begins[:, now] = torch.from_numpy(np.repeat(self.began, n))
            states.append(state_of(world))
            window = frames.at(slice(step, now + 1))
            y = policy.encode(window, begins[:, step : now + 1]).view(e, n, -1)
            ego = self.tracks.ego
            driving = ~world.state.arrived
            if self.group.retried_share > 0.0:
                self.past.keep(self._remembered())
            self.age += 1
            choice = decide(policy, y, ego, self.waypoints, self._explore())
            result = world.step(choice.action.clamp(-1, 1).numpy())
            tracks = self.tracker.update(result.observation)
            ended = result.terminated | result.truncated
            arrived, hit = world.state.arrived & driving, world.state.collision != 0
            macro, local = self._rewards(result.reward, ego, tracks.ego, arrived)
            columns.append(
                Steps(
                    torch.from_numpy(driving),
                    torch.from_numpy(choice.due & driving),
                    choice.macro,
                    choice.macro_log_prob,
                    choice.waypoint,
                    choice.action,
                    choice.action_log_prob,
                    torch.from_numpy(np.linalg.norm(ego[..., 2:4], axis=-1)),
                    torch.from_numpy(macro),
                    torch.from_numpy(local),
                    torch.from_numpy(arrived | ended[:, None]),
                    torch.from_numpy(arrived | hit),
                )
            )
            if ended.any():
                rows = torch.from_numpy(np.flatnonzero(ended))
                ends.append(torch.stack([rows, torch.full_like(rows, step)], 1))
                final_states.append(state_of(world).of(torch.from_numpy(np.repeat(ended, n))))
                final_waypoints.append(self.waypoints.features(tracks.ego)[rows])
                episodes.append(episodes_of(world.state, scenario, ended & self.fresh))
                tracks = self._begin(ended)
            self.tracks, self.began = tracks, ended
        return Batch(
            scenario=scenario,
            frames=Frames(*(tensor.clone() for tensor in frames)),
            begins=begins.clone(),
            state=Frames.joined([*states, state_of(world)], 1),
            steps=Steps(*(torch.stack(column, 1) for column in zip(*columns, strict=True))),
            last_waypoint=self.waypoints.features(self.tracks.ego),
            ends=torch.cat([torch.empty(0, 2, dtype=torch.long), *ends]),
            final_state=Frames.joined([states[0].of(slice(0, 0)), *final_states], 0),
            final_waypoint=torch.cat([torch.empty(0, n, 3), *final_waypoints]),
            episodes=episodes,
        )

    def _begin(self, ended: NDArray[np.bool_]) -> Tracks:
        """Begin the next episodes where one has ended, or take a collision back."""
        world, e = self.world, self.world.worlds
        again = np.zeros(e, np.bool_)
        if self.group.retried_share > 0.0:
            hit = (world.state.collision != 0).any(1) & ended
            again = hit & (self.age > 1) & (torch.rand(e).numpy() < self.group.retried_share)
        self.tracker.reset(ended & ~again)
        self.waypoints.reset(ended)
        world.reset(worlds=ended & ~again)
        if self.crowd is not None:
            self.crowd.step()
            begun = ended & ~again & (torch.rand(e).numpy() < self.group.begun_share)
            self.crowd.enter(world, begun, self.policy.architecture.round_radius)
        if again.any():
            back = np.minimum(torch.randint(1, RETRY_STEPS + 1, (e,)).numpy(), self.age)
            self.past.restore(self._remembered(), again, back)
        self.age[ended] = 0
        self.fresh[ended] = ~again[ended]
        return self.tracker.update(world.observe(), ended & ~again)

    def _explore(self) -> Tensor:
        """Noise [E, N, A] of unit variance that keeps its direction for a while.

        Braking for one step and speeding up again in the next avoids nobody; noise that is
        correlated in time explores behaviour (Hollenstein et al., Colored Noise in PPO, 2024).
        """
        kept = self.group.noise_correlation
        fresh = torch.randn(self.noise.shape)
        self.noise = kept * self.noise + math.sqrt(1.0 - kept**2) * fresh
        return self.noise

    def _remembered(self) -> list[NDArray]:
        """All that makes up the present state of the worlds, [E, ...] each."""
        return [*self.world.state, *self.tracker.memory().values()]

    def state(self) -> dict[str, Any]:
        """Everything that the next `collect` depends on, but the networks and torch's generator."""
        return {
            "world": self.world.state._asdict(),
            "crowd": {} if self.crowd is None else self.crowd.world.state._asdict(),
            "tracker": self.tracker.memory(),
            "waypoint": self.waypoints.position,
            "clock": self.waypoints.clock,
            "past": list(self.past.kept),
            "age": self.age,
            "fresh": self.fresh,
            "began": self.began,
            "noise": self.noise,
            "frames": list(self._frames),
            "begins": self._begins,
        }

    def restore(self, state: dict[str, Any]) -> None:
        """Go on from a saved state."""
        for name, value in state["world"].items():
            getattr(self.world.state, name)[:] = value
        for name, value in state["crowd"].items():
            assert self.crowd is not None
            getattr(self.crowd.world.state, name)[:] = value
        self.tracker.restore(state["tracker"])
        self.waypoints.position[:], self.waypoints.clock[:] = state["waypoint"], state["clock"]
        self.past.kept.extend(state["past"])
        self.age, self.fresh = state["age"].copy(), state["fresh"].copy()
        self.began, self.noise = state["began"].copy(), state["noise"]
        for room, value in zip((*self._frames, self._begins), [*state["frames"], state["begins"]],
                               strict=True):  # fmt: skip
            room[:] = value
        nobody = np.zeros(self.world.worlds, np.bool_)
        self.tracks = self.tracker.update(self.world.observe(), nobody)

    def _rewards(
        self,
        reward: NDArray[np.float32],
        ego: NDArray[np.float32],
        next_ego: NDArray[np.float32],
        arrived: NDArray[np.bool_],
    ) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Of the macro and the local level, [E, N] each.

        The task's reward, with progress along the route (macro) and to the waypoint (local) in the
        place of progress to the goal; a flat agent's only level gets that of the macro level.
        """
        weight = np.float32(self.scenario.reward.progress)
        here, there = (to_world(np.zeros_like(own[..., :2]), own) for own in (ego, next_ego))
        goal = to_world(ego[..., 0:2], ego)
        aim = to_world(self.waypoints.aim(ego), ego)
        to_goal, to_aim, to_waypoint = (
            np.linalg.norm(here - target, axis=-1) - np.linalg.norm(there - target, axis=-1)
            for target in (goal, aim, self.waypoints.position)
        )
        # A reward that is not the progress term (arrival, collision, discomfort) stays as it is.
        paid = (np.abs(reward - weight * to_goal) < 1e-3) & ~arrived
        macro = np.where(paid, weight * to_aim, reward)
        local = np.where(paid, self._waypoint_progress * to_waypoint, reward)
        if self.policy.architecture.levels == 1:
            return macro, macro
        return macro, local + self._arrival_bonus * arrived


def _room(example: Tensor, frames: int) -> Tensor:
    return example.new_zeros((example.shape[0], frames, *example.shape[2:]))


def _store(frames: Frames, at: int, frame: Frames) -> None:
    for room, tensor in zip(frames, frame, strict=True):
        room[:, at] = tensor[:, 0]
