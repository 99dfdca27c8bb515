"""Draw one case of each family of places: `python -m tools.draw_places docs/images/places.png`."""

from __future__ import annotations

import sys

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import Circle

from mrsan import Scenario, World
from mrsan.place import FAMILIES
from mrsan.place_shapes import polygons_of, route_of
from mrsan.rendering import ROBOT_COLOURS

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
        agent = scenario.humans + i
        route = route_of(state, 0, agent, state.robot_position[0, i], state.robot_goal[0, i])
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
    for number, polygon in enumerate(polygons_of(world.state, 0)):
        if number == 0:
            axes.fill(*polygon.T, color="#F6F6F3", zorder=0)
        elif len(polygon) > 2:
            axes.fill(*polygon.T, color="#4A4A4A", zorder=1)
        axes.plot(*np.vstack([polygon, polygon[:1]]).T, color="#222222", linewidth=2.0, zorder=1)


if __name__ == "__main__":
    main(sys.argv[1])
