"""The replays of the report: trajectories as compact JSON for the viewer, kept between reports."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mrsan import Outcome
from mrsan.sensors.walls import ray_angles
from samarl.configuration import load_scenario
from samarl.evaluation.methods import label_of
from samarl.evaluation.summary import scenario_column
from samarl.evaluation.table import column_title
from samarl.evaluation.trajectory import Trajectory
from samarl.files import write_text

_INDEX, _PREFIX = "index.js", "const replays = "


class ReplayFolder:
    """The scripts of all replays, and an index of them, to which they are added one by one.

    Scripts, since pages that are opened from a disk may not fetch data.
    """

    def __init__(self, folder: Path, keys: Sequence[str]) -> None:
        """Keep the replays of an earlier report that have one of the keys, and remove the others.

        Args:
            folder: the folder of the replays.
            keys: of all planned replays; each contains a digest of what its replay depends on.
        """
        self._folder, self._keys = folder, keys
        earlier = _read_entries(folder / _INDEX)
        scripts = {path.stem: path for path in folder.glob("*.js") if path.name != _INDEX}
        self._entries = {key: earlier[key] for key in keys if key in scripts and key in earlier}
        for key, script in scripts.items():
            if key not in self._entries:
                script.unlink()
        self._write_index(len(keys))

    def __contains__(self, key: str) -> bool:
        """Return whether a replay is already recorded."""
        return key in self._entries

    def add(self, key: str, method: str, case: str, trajectory: Trajectory) -> None:
        """Write a replay and add it to the index."""
        data = json.dumps(as_replay(trajectory), separators=(",", ":"))
        write_text(self._folder / f"{key}.js", f"replay({json.dumps(key)},{data});\n")
        scenario = trajectory.scenario
        self._entries[key] = {
            "method": label_of(method),
            "column": column_title(scenario_column(scenario, load_scenario(scenario.name))),
            "case": case,
            "success": bool(trajectory.episodes.success[0]),
        }
        self._write_index(len(self._keys))

    def close(self) -> None:
        """Note that no more replays will be added."""
        self._write_index(len(self._entries))

    def _write_index(self, total: int) -> None:
        order = [key for key in self._keys if key in self._entries]
        index = {"total": total, "entries": {key: self._entries[key] for key in order}}
        write_text(self._folder / _INDEX, f"{_PREFIX}{json.dumps(index)};\n")


def _read_entries(index: Path) -> dict[str, Any]:
    """Return the entries of an index; none if it is missing or damaged."""
    try:
        text = index.read_text(encoding="utf-8")
        return dict(json.loads(text[len(_PREFIX) : -2])["entries"])
    except (OSError, ValueError, LookupError, TypeError, RecursionError):
        return {}


def digest_of(*parts: Any) -> str:
    """Return a digest of values, and of the content of the files that they name."""
    digest = hashlib.sha256(json.dumps(parts, default=str).encode())
    for path in sorted(set(_files(parts))):
        digest.update(path.read_bytes())
    return digest.hexdigest()[:10]


def _files(value: Any) -> Iterator[Path]:
    """Yield the files that a value or any value in it names."""
    if isinstance(value, str) and len(value) < 1000 and Path(value).is_file():
        yield Path(value)
    elif isinstance(value, dict):
        yield from _files(list(value.values()))
    elif isinstance(value, list | tuple):
        for item in value:
            yield from _files(item)


def as_replay(trajectory: Trajectory) -> dict[str, Any]:
    """Return the data of an episode for the viewer, ready for JSON.

    Positions (cm) and headings (degrees) are stored as the first value and the changes from step
    to step. Boolean series are stored as the steps at which they change, starting from False.
    """
    scenario, episodes = trajectory.scenario, trajectory.episodes
    return {
        "step": scenario.time_step,
        "walls": trajectory.walls.round(3).tolist(),
        **_passages(trajectory),
        "lidar": _ranges(trajectory),
        "fov": scenario.fov_degrees,
        "range": scenario.sensing_range,
        "zone": scenario.reward.discomfort_distance,
        "radius": scenario.robot_radius,
        "radii": [round(float(radius), 3) for radius in trajectory.human_radius],
        "goals": trajectory.robot_goal.round(2).tolist(),
        "robots": _points(trajectory.robot_position),
        "headings": _series(np.degrees(np.unwrap(trajectory.robot_heading, axis=0))),
        "humans": _points(trajectory.human_position),
        "humanGroups": None if trajectory.human_group is None else trajectory.human_group.tolist(),
        "humanReactions": trajectory.human_reaction,
        "humansPresent": _switches(trajectory.human_present[:, None])[0],
        "humansVisible": _switches(trajectory.humans_visible),
        "robotsVisible": _switches(trajectory.robots_visible),
        "humansReported": _reported_switches(trajectory.humans_reported),
        "robotsReported": _reported_switches(trajectory.robots_reported),
        "waypoints": None if trajectory.waypoint is None else _points(trajectory.waypoint),
        "humanAttention": _percent(trajectory.human_attention),
        "robotAttention": _percent(trajectory.robot_attention),
        "shielded": _true_steps(trajectory.shielded),
        "activities": None if trajectory.activity is None else trajectory.activity.T.tolist(),
        "values": None if trajectory.value is None else _tenths(trajectory.value),
        "drivingSteps": trajectory.driving.sum(0).tolist(),
        "outcomes": [Outcome(value).name for value in episodes.outcome[0]],
    }


def _passages(trajectory: Trajectory) -> dict[str, Any]:
    """Return the mouths (x, y, direction outwards, width) and the queue places of passages, m."""
    passages, robots = trajectory.passages, len(trajectory.robot_goal)
    mouths = np.column_stack([passages.mouth, passages.outward, passages.width])
    places = [passages.spread_places(k, robots) for k in range(len(mouths))]
    queue = np.concatenate([np.zeros((0, 2)), *places])
    return {"mouths": mouths.round(3).tolist(), "queuePlaces": queue.round(2).tolist()}


def _ranges(trajectory: Trajectory) -> dict[str, Any] | None:
    """Return the angles of the lidar's rays (rad) and its ranges [N, T + 1, L] in cm."""
    if trajectory.lidar is None:
        return None
    scenario = trajectory.scenario
    angles = ray_angles(scenario.lidar_rays, scenario.lidar_fov_degrees)
    ranges = _whole(100 * trajectory.lidar.transpose(1, 0, 2))
    return {"angles": angles.round(4).tolist(), "ranges": ranges.tolist()}


def _points(position: NDArray[np.float32]) -> list[list[list[int]]]:
    """Return [T, K, 2] in m as K pairs of lists."""
    return [[*map(_differences, xy)] for xy in _whole(100 * position.transpose(1, 2, 0))]


def _series(values: NDArray[np.float32]) -> list[list[int]]:
    """Return [T, K] as K lists."""
    return [_differences(series) for series in _whole(values.T)]


def _tenths(values: NDArray[np.float32]) -> list[list[float]]:
    """Return [T, K] as K lists, rounded to one decimal."""
    return values.T.astype(np.float64).round(1).tolist()


def _differences(series: NDArray[np.int64]) -> list[int]:
    return np.diff(series, prepend=0).tolist()


def _whole(values: NDArray[np.float32]) -> NDArray[np.int64]:
    return np.rint(values).astype(np.int64)


def _switches(mask: NDArray[np.bool_]) -> list[list[list[int]]]:
    """Return the steps at which each series of a mask [T, N, K] changes."""
    changed = np.diff(mask, axis=0, prepend=np.zeros((1, *mask.shape[1:]), np.bool_))
    return [
        [np.flatnonzero(changed[:, i, k]).tolist() for k in range(mask.shape[2])]
        for i in range(mask.shape[1])
    ]


def _reported_switches(mask: NDArray[np.bool_]) -> list[list[list[int]]] | None:
    """Return the switches of a mask, or None if it is never True."""
    return _switches(mask) if mask.any() else None


def _true_steps(mask: NDArray[np.bool_] | None) -> list[list[int]] | None:
    """Return the steps at which each column of a mask [T, N] is True."""
    return None if mask is None else [np.flatnonzero(column).tolist() for column in mask.T]


def _percent(shares: NDArray[np.float32] | None) -> list[list[list[int]]] | None:
    """Return shares [T, N, K] as percentages."""
    return None if shares is None else _whole(100 * shares).tolist()
