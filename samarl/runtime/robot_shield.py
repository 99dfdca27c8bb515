"""The shield on a robot: it knows all walls and everybody in view, and why it rejects actions."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from enum import StrEnum
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mrsan import Entities, Observation, Scenario
from mrsan.features import OTHER_RADIUS, OTHER_X, OTHER_Y
from mrsan.parameters import kernel_parameters
from samarl.observations.tracker import AGE
from samarl.planning.shield import SUFFICIENT_GAP, Shield, apply_shield
from samarl.planning.velocity_control import turning_action
from samarl.runtime.agents import AgentTracks
from samarl.runtime.clear_area import ClearArea
from samarl.runtime.inputs import Detection, OwnState
from samarl.runtime.scan import SCAN_MARGIN
from samarl.runtime.scan_memory import ScanMemory
from samarl.runtime.walls import seen_from

_MOST_AGENTS = 256  # people, and team-mates, that it knows at once
_ROUNDING = 1e-3  # that single precision and a segment instead of returns may be wrong by, m


class ShieldReason(StrEnum):
    """What the action that the shield replaced would not have kept clear of."""

    person = "person"  # one that is detected now
    robot = "robot"  # a team-mate that is detected now
    wall = "wall"  # of the map, or seen now
    stale_data = "stale data"  # a person, a team-mate or a scan's return that is only remembered
    unseen = "unseen"  # what may stand between the rays of a scan


class _Walls(NamedTuple):
    """What the shield knows of walls, the nearest first."""

    entities: Entities  # [1, 1, K, 4]
    distance: NDArray[np.float64]  # [K] m
    is_remembered: NDArray[np.bool_]  # [K] seen by an earlier scan only
    is_edge: NDArray[np.bool_]  # [K] of the area in which everything has been seen


class RobotShield:
    """The shield of one robot, with its own memory: it knows more agents than the policy."""

    def __init__(self, shield: Shield, scenario: Scenario) -> None:
        """Start without memory."""
        self._shield, self._scenario = shield, scenario
        self.reset()

    def reset(self) -> None:
        """Clear the memory."""
        self._agents = AgentTracks(
            _MOST_AGENTS, _MOST_AGENTS, self._shield.track_time, self._scenario.time_step
        )
        self._scans, self._clear = ScanMemory(), ClearArea(self._scenario)

    def check(
        self,
        action: NDArray[np.float32],
        observation: Observation,
        own: OwnState,
        detections: Sequence[Detection],
        walls: Sequence[NDArray[np.float64]],
        time: float,
        elapsed: float,
    ) -> tuple[NDArray[np.float32], ShieldReason | None]:
        """Return the action or its replacement, [1, 1, A], and why it was replaced.

        Args:
            action: of the policy.
            observation: [1, 1, ...] of the policy; its agents and walls are not used.
            own: the robot.
            detections: everybody who is visible now.
            walls: [K, 4] each; those of scans are `samarl.runtime.scan.ScanWalls`.
            time: of the measurements, s.
            elapsed: since the step before, s.
        """
        agents, _ = self._agents.observe(own, detections, time)
        known = self._known_walls(own, walls, detections, time)
        entities = {**agents, "walls": known.entities}
        tracks = self._agents.update(observation._replace(entities=entities), elapsed)

        def checked(tracks: Observation) -> NDArray[np.float32]:
            return apply_shield(tracks, action, self._scenario, self._shield)

        safe_action = checked(tracks)
        if (safe_action == action).all():
            return action, None

        def rejects(fewer: Observation) -> bool:
            return bool((checked(fewer) != action).any())

        reason = _reason(tracks, known, rejects)
        if reason is ShieldReason.unseen and (turn := self._clear.turn_to_see(own)):
            return turning_action(turn, kernel_parameters(self._scenario)), reason
        return safe_action, reason

    def _known_walls(
        self,
        own: OwnState,
        walls: Sequence[NDArray[np.float64]],
        detections: Sequence[Detection],
        time: float,
    ) -> _Walls:
        """Return all walls that the robot could touch within the horizon of the shield."""
        scans = [getattr(array, "scan", None) for array in walls]
        new_scans = [scan for scan in scans if scan is not None]
        remembered = self._scans.update(new_scans, detections, time)
        edges = self._clear.update(new_scans, own)
        sources = [*map(np.asarray, walls), np.hstack([remembered, remembered]), edges]
        widest = max((scan.ray_width for scan in scans if scan), default=0.0)
        ray_width = np.array([*(scan.ray_width if scan else 0.0 for scan in scans), widest, 0.0])
        is_scanned = np.array([*(scan is not None for scan in scans), True, True])
        s = self._scenario
        speed = max(s.robot_speed, math.hypot(own.velocity_x, own.velocity_y))
        reach = s.robot_radius + self._shield.horizon * speed + float(SUFFICIENT_GAP) + SCAN_MARGIN
        near = seen_from(own, np.concatenate(sources), reach / (1.0 - widest / 2.0))
        kind = np.repeat(np.arange(len(sources)), [len(array) for array in sources])[near.order]
        is_remembered, is_edge = kind == len(sources) - 2, kind == len(sources) - 1
        margin = SCAN_MARGIN + near.distance * ray_width[kind] / 2.0
        margin = np.where(is_edge, self._clear.margin, margin)
        margin = np.minimum(margin, near.distance - s.robot_radius - _ROUNDING)
        nearer = np.where(is_scanned[kind], np.maximum(margin, 0.0), 0.0)
        shift = near.nearest * (nearer / np.maximum(near.distance, 1e-9))[:, None]
        segments = (near.segments - np.hstack([shift, shift])).astype(np.float32)
        entities = Entities(segments[None, None], np.ones((1, 1, len(segments)), np.bool_))
        return _Walls(entities, near.distance, is_remembered, is_edge)


def _reason(
    tracks: Observation, walls: _Walls, rejects: Callable[[Observation], bool]
) -> ShieldReason:
    """Return for what the action would have been rejected alone, the nearest of several.

    If that is nothing, it is what the action would have passed without.
    """
    members = _members(tracks, walls)
    distance = _distances(tracks, walls)
    nearest = {
        reason: min((distance[name][mask].min(initial=math.inf) for name, mask in masks.items()))
        for reason, masks in members.items()
    }
    reasons = sorted((r for r in nearest if nearest[r] < math.inf), key=lambda r: nearest[r])

    def kept(is_kept: Callable[[str], NDArray[np.bool_]]) -> Observation:
        entities = {
            name: Entities(tracks.entities[name].features, is_kept(name)) for name in distance
        }
        return tracks._replace(entities={**tracks.entities, **entities})

    def only(reason: ShieldReason) -> Observation:
        masks = members[reason]
        return kept(lambda name: masks.get(name, np.zeros_like(tracks.entities[name].mask)))

    def without(reason: ShieldReason) -> Observation:
        masks = members[reason]
        return kept(lambda name: tracks.entities[name].mask & ~masks.get(name, np.False_))

    for reason in reasons:
        if len(reasons) == 1 or rejects(only(reason)):
            return reason
    for reason in reasons:
        if not rejects(without(reason)):
            return reason
    return reasons[0]


def _members(
    tracks: Observation, walls: _Walls
) -> dict[ShieldReason, dict[str, NDArray[np.bool_]]]:
    """Return who belongs to each reason, by group of entities, [1, 1, ...]."""
    is_old = {name: tracks.entities[name].features[..., AGE] > 0.0 for name in ("humans", "robots")}
    is_old["walls"], is_edge = walls.is_remembered[None, None], walls.is_edge[None, None]
    mask = {name: tracks.entities[name].mask for name in is_old}
    return {
        ShieldReason.person: {"humans": mask["humans"] & ~is_old["humans"]},
        ShieldReason.robot: {"robots": mask["robots"] & ~is_old["robots"]},
        ShieldReason.wall: {"walls": mask["walls"] & ~is_old["walls"] & ~is_edge},
        ShieldReason.unseen: {"walls": is_edge},
        ShieldReason.stale_data: {name: mask[name] & is_old[name] for name in is_old},
    }


def _distances(tracks: Observation, walls: _Walls) -> dict[str, NDArray[np.float64]]:
    """Return the distances of all agents and walls from the robot's centre, [1, 1, ...], m."""
    distance = {"walls": walls.distance[None, None]}
    for name in ("humans", "robots"):
        features = tracks.entities[name].features.astype(np.float64)
        centre_distance = np.hypot(features[..., OTHER_X], features[..., OTHER_Y])
        distance[name] = centre_distance - features[..., OTHER_RADIUS]
    return distance
