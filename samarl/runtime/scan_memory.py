"""Returns of earlier scans: rays that are far apart miss what they have hit before."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from samarl.runtime.inputs import Detection
from samarl.runtime.scan import SMALLEST_OBSTACLE, Scan

_LONGEST_TIME = 30.0  # for which a return is remembered, s
_LARGEST_DISTANCE = 5.0  # from the lidar at which a return is remembered, m
_CELL = 0.02  # of the returns in the same one, the latest is remembered, m
_BEHIND = 0.05  # a ray has passed a place if it ends at least this far behind it, m
_TOUCHING = 0.003  # a ray that passes a place at this distance shows that nothing is there, m
_THINNEST = 0.98 * SMALLEST_OBSTACLE  # and so do two that pass on both sides, this far apart, m
_AGENT_SURFACE = 0.3  # returns this near to the surface of an agent are its own, m


class ScanMemory:
    """Places that were hit, until a ray passes through them or half a minute is over.

    Returns of people and team-mates are left out: they are tracked as agents.
    """

    def __init__(self) -> None:
        """Start without any."""
        # Places are measured from that of the first scan, so that cells do not depend on the frame.
        self._start: NDArray[np.float64] | None = None  # [2] m
        self._places: NDArray[np.float64] = np.zeros((0, 2))  # [P, 2] m
        self._time: NDArray[np.float64] = np.zeros(0)  # [P] of the last hit, s

    def update(
        self, scans: Sequence[Scan], agents: Sequence[Detection], time: float
    ) -> NDArray[np.float64]:
        """Add scans; return the places [P, 2] that were hit before and not by them, m."""
        if self._start is None and scans:
            self._start = np.array([scans[0].x, scans[0].y])
        if self._start is None:
            return np.zeros((0, 2))
        is_kept = time - self._time <= _LONGEST_TIME
        for scan in scans:
            from_lidar = self._places - (np.array([scan.x, scan.y]) - self._start)
            is_kept &= np.linalg.norm(from_lidar, axis=-1) <= _LARGEST_DISTANCE
            is_kept &= ~_is_refuted(from_lidar, scan)
        hits = [_without_agents(_near_returns(scan), agents) - self._start for scan in scans]
        places = np.concatenate([*hits, self._places[is_kept]])
        hit_now = sum(map(len, hits))
        times = np.concatenate([np.full(hit_now, time), self._time[is_kept]])
        first = np.sort(np.unique(np.floor(places / _CELL), axis=0, return_index=True)[1])
        self._places, self._time = places[first], times[first]
        return places[first[first >= hit_now]] + self._start


def _near_returns(scan: Scan) -> NDArray[np.float64]:
    """Return the places [R, 2] that a scan hit and that are remembered, m."""
    return scan.returns[scan.distance[scan.is_hit] <= _LARGEST_DISTANCE]


def _without_agents(
    points: NDArray[np.float64], agents: Sequence[Detection]
) -> NDArray[np.float64]:
    """Return the points that do not belong to an agent."""
    for agent in agents:
        away = np.linalg.norm(points - (agent.x, agent.y), axis=-1)
        points = points[away > agent.radius + _AGENT_SURFACE]
    return points


def _is_refuted(places: NDArray[np.float64], scan: Scan) -> NDArray[np.bool_]:
    """Return whether rays show that nothing is at places [P, 2], seen from the lidar."""
    if len(scan.angle) == 0:
        return np.zeros(len(places), np.bool_)
    distance = np.linalg.norm(places, axis=-1)
    angle = np.array([math.atan2(y, x) for x, y in places.tolist()]) % (2.0 * math.pi)
    following = np.searchsorted(scan.angle, angle) % len(scan.angle)
    away, passes = [], []
    for ray in (following - 1, following):
        turn = np.abs((angle - scan.angle[ray] + math.pi) % (2.0 * math.pi) - math.pi)
        away.append(turn * distance)
        passes.append(np.minimum(scan.distance[ray], scan.largest_range) >= distance + _BEHIND)
    touches = [passed & (near <= _TOUCHING) for passed, near in zip(passes, away, strict=True)]
    is_enclosed = passes[0] & passes[1] & (away[0] + away[1] <= _THINNEST)
    return np.asarray(touches[0] | touches[1] | is_enclosed)
