"""Draw one case of each layout and task: `python -m tools.draw_layouts docs/images`."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.patches import Circle, Patch

from mrsan import TASKS, Layout, Scenario, World
from mrsan.place import FAMILIES
from mrsan.place_shapes import polygons_of, route_of
from mrsan.rendering import ROBOT_COLOURS

_CASE = 4
_ROBOTS = 3
_PERSON, _WAY, _WALL, _SOLID = "#8C8C8C", "#C8C8C8", "#222222", "#4A4A4A"
_OPEN = [Layout.circle, Layout.crossing, Layout.opposite, Layout.square]


def main(folder: Path) -> None:
    """Write the pictures of the layouts without walls, of those with walls, and of the tasks."""
    open_floor = [Scenario(layout=layout, humans=10, robots=_ROBOTS) for layout in _OPEN]
    _draw_all(open_floor, (1, 4), folder / "layouts.png")
    walled = [Scenario(layout=layout, humans=5, robots=_ROBOTS) for layout in FAMILIES]
    _draw_all(walled, (2, 3), folder / "places.png")
    tasks = [task.scenario for task in TASKS.values()]
    _draw_all(tasks, (5, 4), folder / "tasks.png", [task.id for task in TASKS.values()])


def _draw_all(
    scenarios: Sequence[Scenario],
    grid: tuple[int, int],
    path: Path,
    titles: Sequence[str] = (),
) -> None:
    """Write one picture of several scenarios, with a legend; titles are by default the layouts."""
    size = (10.5, 3.4 * grid[0])
    figure, axes = plt.subplots(*grid, figsize=size, layout="constrained", squeeze=False)
    titles = titles or [scenario.layout.name for scenario in scenarios]
    for place in axes.flat:
        place.set_axis_off()
    for place, scenario, title in zip(axes.flat, scenarios, titles, strict=False):
        place.set_title(title, fontsize=11)
        _draw(place, scenario)
    colour = ROBOT_COLOURS[0]
    marks: dict[str, Artist] = {
        "robot": Line2D([], [], color=colour, marker="o", markersize=9, linestyle=""),
        "its route": Line2D([], [], color=colour, linestyle="--", linewidth=1.2),
        "its goal": Line2D([], [], color=colour, marker="x", markersize=8, linestyle=""),
        "person": Line2D([], [], color=_PERSON, marker="o", markersize=9, linestyle=""),
    }
    if any(scenario.has_walls for scenario in scenarios):
        marks["wall"] = Line2D([], [], color=_WALL, linewidth=2.0)
        marks["obstacle"] = Patch(facecolor=_SOLID, edgecolor=_WALL)
    if not scenarios[0].has_walls:
        marks["where the person goes"] = Line2D([], [], color=_WAY, marker=">", linewidth=1.2)
    figure.legend(
        list(marks.values()),
        list(marks),
        loc="outside lower center",
        ncols=len(marks),
        fontsize=11,
        frameon=False,
    )
    figure.savefig(path, dpi=150)


def _draw(axes: Axes, scenario: Scenario) -> None:
    """Draw robots with their routes, people and, without walls, where people go."""
    world = World(scenario)
    world.reset([_CASE])
    state = world.state
    if scenario.has_walls:
        _fill(axes, world)
    else:
        position, goal = state.human_position[0], state.human_goal[0]
        axes.quiver(
            *position.T,
            *(goal - position).T,
            angles="xy",
            scale_units="xy",
            scale=1.0,
            width=0.005,
            color=_WAY,
        )
        axes.update_datalim(goal)
    for i in range(scenario.robots):
        agent = scenario.humans + i
        start, goal = state.robot_position[0, i], state.robot_goal[0, i]
        route = np.stack([start, goal])
        if scenario.has_walls:
            route = route_of(state, 0, agent, start, goal)
        colour = ROBOT_COLOURS[i]
        axes.plot(*route.T, color=colour, linewidth=1.2, linestyle="--")
        axes.plot(*route[-1], marker="x", color=colour, markersize=7, markeredgewidth=2)
        axes.add_patch(Circle(tuple(route[0]), scenario.robot_radius, color=colour, zorder=3))
    for j in np.flatnonzero(state.human_present[0]):
        centre = tuple(state.human_position[0, j])
        axes.add_patch(Circle(centre, float(state.human_radius[0, j]), color=_PERSON, zorder=3))
    axes.set_aspect("equal")


def _fill(axes: Axes, world: World) -> None:
    """Fill what is solid, and draw thin walls as lines."""
    for number, polygon in enumerate(polygons_of(world.state, 0)):
        if number == 0:
            axes.fill(*polygon.T, color="#F6F6F3", zorder=0)
        elif len(polygon) > 2:
            axes.fill(*polygon.T, color=_SOLID, zorder=1)
        axes.plot(*np.vstack([polygon, polygon[:1]]).T, color=_WALL, linewidth=2.0, zorder=1)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
