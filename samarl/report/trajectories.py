"""The paths of one episode as a picture, with the time along them."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.colors import LinearSegmentedColormap
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Circle

from mrsan import Outcome
from samarl.evaluation.recording import Recording
from samarl.report.style import COLOURS, CONTACT, STYLE, save_figure

_HUMAN_SHADES = LinearSegmentedColormap.from_list("humans", ["#e4e4e4", "#777777"])
_MARK_SECONDS = 3.0  # between the discs along a path


def save_trajectories(recordings: Sequence[tuple[Recording, str]], path: Path) -> None:
    """Write the picture in the format of the file's ending, atomically.

    Args:
        recordings: each with its title; side by side.
        path: where to.
    """
    figure = Figure(figsize=(6.4 * len(recordings), 6.9), layout="compressed")
    with rc_context(STYLE):
        for axes, (recording, title) in zip(
            figure.subplots(1, len(recordings), squeeze=False, sharex=True, sharey=True)[0],
            recordings,
            strict=True,
        ):
            draw_trajectories(axes, recording, title)
        key = _legend([recording for recording, _ in recordings])
        columns = min(len(key), 5 * len(recordings))
        figure.legend(handles=key, loc="outside lower center", ncols=columns, fontsize=8,
                      handletextpad=0.4, columnspacing=1.2)  # fmt: skip
    save_figure(figure, path)


def draw_trajectories(axes: Axes, recording: Recording, title: str) -> None:
    """Draw robots with the seconds along their paths, goals, humans and contacts."""
    steps_per_mark = max(1, round(_MARK_SECONDS / recording.scenario.time_step))
    for j in range(recording.human_position.shape[1]):
        _draw_human(axes, recording, j, steps_per_mark)
    for i in range(recording.robot_position.shape[1]):
        _draw_robot(axes, recording, i, steps_per_mark)
    outcomes = [Outcome(value).name.replace("_", " ") for value in recording.episodes.outcome[0]]
    ends = ", ".join(f"robot {i}: {name}" for i, name in enumerate(outcomes))
    axes.set_title(f"{title}\n{textwrap.fill(ends, 84)}", fontsize=9.5)
    axes.set_aspect("equal")
    axes.set_xlabel("x (m)")
    axes.set_ylabel("y (m)")
    axes.grid(True, axis="both")
    axes.autoscale_view()


def _draw_human(axes: Axes, recording: Recording, j: int, every: int) -> None:
    path, present = recording.human_position[:, j], recording.human_present[:, j]
    last = len(path) - 1
    walked = present[:-1] & present[1:]
    segments = np.stack([path[:-1], path[1:]], axis=1)[walked]
    shades = LineCollection(list(segments), cmap=_HUMAN_SHADES, linewidths=1.2, zorder=1)
    shades.set_array(np.arange(last)[walked])
    shades.set_clim(0, last)
    axes.add_collection(shades)
    radius = float(recording.human_radius[j])
    for t in sorted({*range(0, last, every), last}):
        if not present[t]:
            continue
        shade = _HUMAN_SHADES(t / max(last, 1))
        axes.add_patch(
            Circle(tuple(path[t]), radius, facecolor=shade if t == last else "none",
                   edgecolor=shade, linewidth=0.8, zorder=2)
        )  # fmt: skip


def _draw_robot(axes: Axes, recording: Recording, i: int, every: int) -> None:
    colour = COLOURS[i % len(COLOURS)]
    path, heading = recording.robot_position[:, i], recording.robot_heading[:, i]
    last = int(recording.driving[:, i].sum())
    last = min(last, len(path) - 1)
    radius = recording.scenario.robot_radius
    goal = recording.robot_goal[i]
    axes.plot(*path[: last + 1].T, color=colour, linewidth=2.0, zorder=4)
    axes.plot(*goal, marker="*", markersize=15, color=colour, markeredgecolor="white", zorder=3)
    marks = [t for t in range(0, last, every) if last - t > every // 2]
    for t in [*marks, last]:
        axes.add_patch(
            Circle(tuple(path[t]), radius, facecolor="white" if t != last else colour,
                   edgecolor=colour, linewidth=1.4, zorder=5)
        )  # fmt: skip
        second = f"{t * recording.scenario.time_step:g}"
        axes.text(path[t, 0], path[t, 1], second, fontsize=6.5, ha="center", va="center",
                  color="white" if t == last else colour, zorder=6)  # fmt: skip
        nose = path[t] + radius * np.array([np.cos(heading[t]), np.sin(heading[t])])
        tip = path[t] + 1.6 * radius * np.array([np.cos(heading[t]), np.sin(heading[t])])
        axes.plot(*np.stack([nose, tip]).T, color=colour, linewidth=1.6, zorder=5)
    if recording.episodes.outcome[0, i] in (Outcome.hit_human, Outcome.hit_robot):
        axes.plot(
            *path[-1], marker="x", markersize=16, markeredgewidth=2.5, color=CONTACT, zorder=7
        )


def _legend(recordings: Sequence[Recording]) -> list[Line2D]:
    """What is drawn, and only that."""
    plain: dict[str, Any] = {"linestyle": "none", "color": "black"}
    robots = max(recording.robot_position.shape[1] for recording in recordings)
    key = [
        Line2D([], [], color=COLOURS[i % len(COLOURS)], linewidth=2, label=f"robot {i}")
        for i in range(robots)
    ]
    key += [
        Line2D([], [], marker="$3$", markersize=6, label="seconds since the start", **plain),
        Line2D([], [], marker="*", markersize=10, label="goal", **plain),
    ]
    if any(recording.human_position.shape[1] for recording in recordings):
        key += [
            Line2D([], [], color="#999999", linewidth=1.2, label="human (later is darker)"),
            Line2D([], [], marker="o", linestyle="none", color="#777777", markersize=9,
                   label="human at the end"),
        ]  # fmt: skip
    outcomes = [outcome for recording in recordings for outcome in recording.episodes.outcome[0]]
    if {Outcome.hit_human, Outcome.hit_robot} & {Outcome(value) for value in outcomes}:
        key.append(
            Line2D([], [], marker="x", linestyle="none", color=CONTACT, markersize=9,
                   markeredgewidth=2, label="contact")
        )  # fmt: skip
    return key
