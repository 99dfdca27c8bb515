"""Draw one case of each family of places: `python -m tools.draw_places docs/images/places.png`."""

from __future__ import annotations

import sys

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import Circle

from mrsan import Scenario, World
from mrsan.kernels.walls import CORNERS, WALLS
from mrsan.place import FAMILIES
from mrsan.rendering import ROBOT_COLOURS, walls_of

_CASE = 4
_HUMANS, _ROBOTS, _RAYS = 5, 3, 72


def main(path: str) -> None:
    """Write the picture."""
    figure, axes = plt.subplots(2, 3, figsize=(10.5, 7.0), layout="constrained")
    for place, layout in zip(axes.flat, FAMILIES, strict=True):
        scenario = Scenario(
            layout=layout, humans=_HUMANS, robots=_ROBOTS, lidar_rays=_RAYS, lidar_dropout=0.0
        )
        world = World(scenario)
        world.reset([_CASE])
        _draw(place, world)
        place.set_title(layout.name, fontsize=11)
    figure.savefig(path, dpi=150)


def _draw(axes: Axes, world: World) -> None:
    state, scenario = world.state, world.scenario
    _fill(axes, world)
    for i in range(_ROBOTS):
        route = _route(world, i)
        colour = ROBOT_COLOURS[i]
        axes.plot(*route.T, color=colour, linewidth=1.2, linestyle="--")
        axes.plot(*route[-1], marker="x", color=colour, markersize=7, markeredgewidth=2)
        axes.add_patch(Circle(tuple(route[0]), scenario.robot_radius, color=colour, zorder=3))
    for j in np.flatnonzero(state.human_present[0]):
        centre = tuple(state.human_position[0, j])
        axes.add_patch(Circle(centre, float(state.human_radius[0, j]), color="#8C8C8C", zorder=3))
    axes.set_aspect("equal")
    axes.set_axis_off()


def _fill(axes: Axes, world: World) -> None:
    """Fill what is solid, and draw thin walls as lines."""
    segments = walls_of(world.state, 0)
    assert len(segments) == int(world.state.place[0, WALLS])
    first = 0
    for k, (_, _, end_x, end_y) in enumerate(segments):
        if (end_x, end_y) != tuple(segments[first, :2]):
            continue
        polygon = segments[first : k + 1, :2]
        if first == 0:
            axes.fill(*polygon.T, color="#F6F6F3", zorder=0)
        elif len(polygon) > 2:
            axes.fill(*polygon.T, color="#4A4A4A", zorder=1)
        axes.plot(*np.vstack([polygon, polygon[:1]]).T, color="#222222", linewidth=2.0, zorder=1)
        first = k + 1


def _route(world: World, robot: int) -> np.ndarray:
    """Return the points of a robot's shortest route, [P, 2]."""
    state = world.state
    agent = world.scenario.humans + robot
    goal, cost = state.robot_goal[0, robot], state.route_cost[0, agent]
    points, corner = [state.robot_position[0, robot]], int(state.route_corner[0, agent])
    corners = state.corners[0, :2].T
    while corner >= 0:
        points.append(corners[corner])
        here, corner = corner, -1
        ways = np.linalg.norm(corners - corners[here], axis=1)
        for v in np.argsort(ways[: int(state.place[0, CORNERS])]):
            linked = state.corner_distance[0, here, v] < ways[v] + 1e-4
            if linked and cost[v] < cost[here] and abs(ways[v] + cost[v] - cost[here]) < 1e-4:
                corner = int(v)
                break
    return np.array([*points, goal])


if __name__ == "__main__":
    main(sys.argv[1])
