"""Figure of the paths of one episode, with the time along them."""

from __future__ import annotations

import math
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
from numpy.typing import NDArray

from mrsan import Outcome
from samarl.evaluation.trajectory import Trajectory
from samarl.report.style import COLOURS, CONTACT, PALETTE, STYLE, save_figure

_HUMAN_SHADES = LinearSegmentedColormap.from_list("humans", ["#e4e4e4", "#777777"])
_MARK_SECONDS = 3.0  # between discs along a path


def save_trajectories(trajectories: Sequence[tuple[Trajectory, str]], path: Path) -> None:
    """Draw trajectories side by side and write the figure atomically."""
    size = 6.4 * len(trajectories), 1.5 + 5.4 * height_share(trajectories)
    figure = Figure(figsize=size, layout="compressed")
    with rc_context(STYLE):
        for axes, (trajectory, title) in zip(
            figure.subplots(1, len(trajectories), squeeze=False, sharex=True, sharey=True)[0],
            trajectories,
            strict=True,
        ):
            draw_trajectories(axes, trajectory, title)
        handles = _legend([trajectory for trajectory, _ in trajectories])
        columns = min(len(handles), 5 * len(trajectories))
        figure.legend(
            handles=handles,
            loc="outside lower center",
            ncols=columns,
            fontsize=8,
            handletextpad=0.4,
            columnspacing=1.2,
        )
    save_figure(figure, path)


HITS = {Outcome.hit_human, Outcome.hit_robot, Outcome.hit_wall}
WALL, PASSAGE = "#222222", PALETTE["passage"][0]


def draw_trajectories(axes: Axes, trajectory: Trajectory, title: str) -> None:
    """Draw robots with times along their paths, goals, humans and contacts."""
    draw_passages(axes, trajectory)
    draw_walls(axes, trajectory)
    steps_per_mark = max(1, round(_MARK_SECONDS / trajectory.scenario.time_step))
    for j in range(trajectory.human_position.shape[1]):
        _draw_human(axes, trajectory, j, steps_per_mark)
    for i in range(trajectory.robot_position.shape[1]):
        _draw_robot(axes, trajectory, i, steps_per_mark)
    outcomes = [Outcome(value).name.replace("_", " ") for value in trajectory.episodes.outcome[0]]
    summary = ", ".join(f"robot {i}: {name}" for i, name in enumerate(outcomes))
    axes.set_title(f"{title}\n{textwrap.fill(summary, 84)}", fontsize=9.5)
    axes.set_aspect("equal")
    axes.set_xlabel("x (m)")
    axes.set_ylabel("y (m)")
    axes.grid(True, axis="both")
    axes.autoscale_view()


def draw_walls(axes: Axes, trajectory: Trajectory) -> None:
    """Draw the wall segments of the place."""
    segments = trajectory.walls.reshape(-1, 2, 2)
    walls = LineCollection(list(segments), colors=WALL, linewidths=2.5, zorder=3)
    walls.set_capstyle("round")
    axes.add_collection(walls)


def draw_passages(axes: Axes, trajectory: Trajectory) -> None:
    """Draw the mouths of doors and corridors, with arrows into them, and queue places beside."""
    passages, robots = trajectory.passages, len(trajectory.robot_goal)
    for k, mouth in enumerate(passages.mouth):
        inward = -passages.outward[k]
        across = passages.width[k] / 2 * np.array([-inward[1], inward[0]])
        ends = np.stack([mouth - across, mouth + across]).T
        axes.plot(*ends, color=PASSAGE, linewidth=1.2, linestyle=(0, (2, 2)), zorder=1)
        tail, tip = mouth - 0.55 * inward, mouth - 0.1 * inward
        style = {"arrowstyle": "-|>", "color": PASSAGE, "linewidth": 1.2, "mutation_scale": 9}
        axes.annotate("", xy=tip, xytext=tail, arrowprops=style, zorder=1)
        for place in passages.spread_places(k, robots):
            radius = trajectory.scenario.robot_radius
            style = {"edgecolor": PASSAGE, "linewidth": 0.8, "linestyle": (0, (2, 2))}
            axes.add_patch(Circle(tuple(place), radius, facecolor="none", zorder=1, **style))


def view_limits(trajectory: Trajectory) -> NDArray[np.float64]:
    """Return the limits [2, 2] of both axes around everything, m; a square without walls."""
    points = np.concatenate(
        [
            trajectory.walls.reshape(-1, 2),
            trajectory.robot_position.reshape(-1, 2),
            trajectory.human_position[trajectory.human_present],
            trajectory.robot_goal,
        ]
    )
    middle = (points.min(0) + points.max(0)) / 2
    half = (points.max(0) - points.min(0)) / 2 + 0.6
    if len(trajectory.walls):
        half[1] += 0.7  # the clock and the outcome are above and below the walls
    else:
        half[:] = half.max()
    return np.stack([middle - half, middle + half], -1)


def height_share(trajectories: Sequence[tuple[Trajectory, str]]) -> float:
    """Return how high the highest of some trajectories is, as a share of its width."""
    extents = [np.diff(view_limits(trajectory)).ravel() for trajectory, _ in trajectories]
    return math.ceil(10.0 * max(y / x for x, y in extents)) / 10


def _draw_human(axes: Axes, trajectory: Trajectory, j: int, steps_per_mark: int) -> None:
    path, present = trajectory.human_position[:, j], trajectory.human_present[:, j]
    last = len(path) - 1
    moving = present[:-1] & present[1:]
    segments = np.stack([path[:-1], path[1:]], axis=1)[moving]
    shades = LineCollection(list(segments), cmap=_HUMAN_SHADES, linewidths=1.2, zorder=1)
    shades.set_array(np.arange(last)[moving])
    shades.set_clim(0, last)
    axes.add_collection(shades)
    radius = float(trajectory.human_radius[j])
    for t in sorted({*range(0, last, steps_per_mark), last}):
        if not present[t]:
            continue
        shade = _HUMAN_SHADES(t / max(last, 1))
        axes.add_patch(
            Circle(
                tuple(path[t]),
                radius,
                facecolor=shade if t == last else "none",
                edgecolor=shade,
                linewidth=0.8,
                zorder=2,
            )
        )


def _draw_robot(axes: Axes, trajectory: Trajectory, i: int, steps_per_mark: int) -> None:
    colour = COLOURS[i % len(COLOURS)]
    path, heading = trajectory.robot_position[:, i], trajectory.robot_heading[:, i]
    last = int(trajectory.driving[:, i].sum())
    last = min(last, len(path) - 1)
    radius = trajectory.scenario.robot_radius
    goal = trajectory.robot_goal[i]
    axes.plot(*path[: last + 1].T, color=colour, linewidth=2.0, zorder=4)
    axes.plot(*goal, marker="*", markersize=15, color=colour, markeredgecolor="white", zorder=3)
    marks = [t for t in range(0, last, steps_per_mark) if last - t > steps_per_mark // 2]
    for t in [*marks, last]:
        axes.add_patch(
            Circle(
                tuple(path[t]),
                radius,
                facecolor="white" if t != last else colour,
                edgecolor=colour,
                linewidth=1.4,
                zorder=5,
            )
        )
        second = f"{t * trajectory.scenario.time_step:g}"
        axes.text(
            path[t, 0],
            path[t, 1],
            second,
            fontsize=6.5,
            ha="center",
            va="center",
            color="white" if t == last else colour,
            zorder=6,
        )
        nose = path[t] + radius * np.array([np.cos(heading[t]), np.sin(heading[t])])
        tip = path[t] + 1.6 * radius * np.array([np.cos(heading[t]), np.sin(heading[t])])
        axes.plot(*np.stack([nose, tip]).T, color=colour, linewidth=1.6, zorder=5)
    if trajectory.episodes.outcome[0, i] in HITS:
        axes.plot(
            *path[-1], marker="x", markersize=16, markeredgewidth=2.5, color=CONTACT, zorder=7
        )


def _legend(trajectories: Sequence[Trajectory]) -> list[Line2D]:
    """Return the legend handles of everything that is drawn."""
    plain: dict[str, Any] = {"linestyle": "none", "color": "black"}
    robots = max(trajectory.robot_position.shape[1] for trajectory in trajectories)
    handles = [
        Line2D([], [], color=COLOURS[i % len(COLOURS)], linewidth=2, label=f"robot {i}")
        for i in range(robots)
    ]
    handles += [
        Line2D([], [], marker="$3$", markersize=6, label="seconds since the start", **plain),
        Line2D([], [], marker="*", markersize=10, label="goal", **plain),
    ]
    if any(trajectory.human_position.shape[1] for trajectory in trajectories):
        handles += [
            Line2D([], [], color="#999999", linewidth=1.2, label="human (later is darker)"),
            Line2D(
                [],
                [],
                marker="o",
                linestyle="none",
                color="#777777",
                markersize=9,
                label="human at the end",
            ),
        ]
    outcomes = [
        outcome for trajectory in trajectories for outcome in trajectory.episodes.outcome[0]
    ]
    if HITS & {Outcome(value) for value in outcomes}:
        handles.append(
            Line2D(
                [],
                [],
                marker="x",
                linestyle="none",
                color=CONTACT,
                markersize=9,
                markeredgewidth=2,
                label="contact",
            )
        )
    return handles
