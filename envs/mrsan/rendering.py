"""Pictures of the state of a world, for `render_mode` of the wrappers."""

from __future__ import annotations

import warnings
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw

from mrsan.fields import ConfigurationError
from mrsan.passages import find_passages, open_width
from mrsan.place_shapes import walls_of
from mrsan.scenario import Scenario
from mrsan.state import State
from mrsan.world import World

RENDER_MODES = ["rgb_array", "human"]
_SIZE = 512  # side of the picture, pixels
_OVERSAMPLING = 2  # drawn larger by this factor and then reduced, which smooths the edges
_MARGIN = 1.5  # m around the place, such as the circle on which robots start
_VIEW_RANGE = 3.0  # m, largest range at which the field of view of a robot is outlined
# The palette of Okabe and Ito, which colour-blind readers can tell apart.
ROBOT_COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000")
PASSAGE_COLOUR = "#7A6A2F"
_PERSON, _ZONE, _GRID, _INK = "#8C8C8C", "#F0F0F0", "#E4E4E4", "#222222"


class Renderer:
    """Draws worlds of a scenario, and shows them in a window if the mode is `human`."""

    def __init__(self, mode: str | None, scenario: Scenario) -> None:
        """Prepare to draw.

        `mode` is one of `RENDER_MODES`; with None nothing is drawn.

        Raises:
            ConfigurationError: there is no such mode.
        """
        if mode is not None and mode not in RENDER_MODES:
            raise ConfigurationError(
                f"render_mode is {mode!r}; it must be None or one of {', '.join(RENDER_MODES)}"
            )
        self.mode, self.scenario = mode, scenario
        self.metadata = {
            "render_modes": RENDER_MODES,
            "render_fps": max(1, round(1.0 / scenario.time_step)),
        }
        self._window = _Window(scenario.time_step) if mode == "human" and _has_screen() else None

    def picture(self, world: World, index: int = 0) -> NDArray[np.uint8]:
        """Draw the state of one world, [512, 512, 3]."""
        return _Drawing(self.scenario).picture(world, index)

    def frame(self, world: World) -> NDArray[np.uint8] | None:
        """Return what `render()` of a single environment returns."""
        return self.picture(world) if self.mode == "rgb_array" else None

    def update_window(self, world: World) -> None:
        """Show the state of the world after a reset or step, in mode `human`."""
        if self._window is not None:
            self._window.show(self.picture(world))

    def close(self) -> None:
        """Close the window."""
        if self._window is not None:
            self._window.close()


class _Drawing:
    """One picture in progress; converts metres to pixels."""

    def __init__(self, scenario: Scenario) -> None:
        self.scenario = scenario
        self.half = scenario.half_extent + _MARGIN
        self.scale = _OVERSAMPLING * _SIZE / (2 * self.half)
        self.image = Image.new("RGB", (_OVERSAMPLING * _SIZE, _OVERSAMPLING * _SIZE), "white")
        self.draw = ImageDraw.Draw(self.image)

    def picture(self, world: World, index: int) -> NDArray[np.uint8]:
        state, scenario = world.state, self.scenario
        self._grid()
        self._passages(state, index)
        for x0, y0, x1, y1 in walls_of(state, index):
            self._line(np.array([x0, y0]), np.array([x1, y1]), _INK, 4)
        people = np.flatnonzero(state.human_present[index])
        zone = scenario.reward.discomfort_distance
        for j in people:
            centre, radius = state.human_position[index, j], float(state.human_radius[index, j])
            self._disc(centre, radius + zone, fill=_ZONE)
        for j in people:
            centre, radius = state.human_position[index, j], float(state.human_radius[index, j])
            self._disc(centre, radius, fill=_PERSON)
            self._line(centre, centre + state.human_velocity[index, j], _PERSON)
        for i, centre in enumerate(state.robot_position[index]):
            self._robot(state, index, i, centre)
        label = f"{state.clock[index] * scenario.time_step:.2f} s"
        self.draw.text((12, 8), label, fill=_INK, font_size=14 * _OVERSAMPLING)
        return np.asarray(self.image.reduce(_OVERSAMPLING))

    def _robot(self, state: Any, index: int, i: int, centre: NDArray[np.float32]) -> None:
        scenario, colour = self.scenario, ROBOT_COLOURS[i % len(ROBOT_COLOURS)]
        goal, radius = state.robot_goal[index, i], scenario.robot_radius
        for turn in (0.0, np.pi / 2):
            arm = 0.8 * radius * np.array([np.cos(turn), np.sin(turn)])
            self._line(goal - arm, goal + arm, colour)
        self._disc(goal, radius, outline=colour)
        heading = float(state.robot_heading[index, i])
        if scenario.fov_degrees < 360.0 and not state.arrived[index, i]:
            self._field_of_view(centre, heading, colour)
        hit = state.collision[index, i] != 0
        self._disc(centre, radius, fill=colour, outline="#C00000" if hit else None, width=4)
        nose = centre + 1.6 * radius * np.array([np.cos(heading), np.sin(heading)])
        self._line(centre, nose, _INK)

    def _field_of_view(self, centre: NDArray[np.float32], heading: float, colour: str) -> None:
        half = np.radians(self.scenario.fov_degrees) / 2
        reach = min(_VIEW_RANGE, self.scenario.sensing_range)
        angles = heading + np.linspace(-half, half, 24)
        arc = centre + reach * np.stack([np.cos(angles), np.sin(angles)], axis=-1)
        outline = [self._pixel(point) for point in (centre, *arc, centre)]
        self.draw.line(outline, fill=colour, width=_OVERSAMPLING)

    def _passages(self, state: State, index: int) -> None:
        """Draw the mouths of narrow doors and corridors, and where robots can queue beside them."""
        scenario = self.scenario
        widest = open_width(scenario.robot_radius)
        passages = find_passages(state.walls[index], state.place[index], widest)
        for k, mouth in enumerate(passages.mouth):
            outward = passages.outward[k]
            across = passages.width[k] / 2 * np.array([-outward[1], outward[0]])
            self._line(mouth - across, mouth + across, PASSAGE_COLOUR, 1)
            for place in passages.spread_places(k, scenario.robots):
                self._disc(place, scenario.robot_radius, outline=PASSAGE_COLOUR, width=1)

    def _grid(self) -> None:
        half = self.half
        for at in np.arange(2.0 * np.ceil(-half / 2.0), half, 2.0):
            self._line(np.array([at, -half]), np.array([at, half]), _GRID, 1)
            self._line(np.array([-half, at]), np.array([half, at]), _GRID, 1)

    def _pixel(self, point: NDArray[Any]) -> tuple[float, float]:
        x, y = float(point[0]), float(point[1])
        return (self.half + x) * self.scale, (self.half - y) * self.scale

    def _disc(
        self,
        centre: NDArray[Any],
        radius: float,
        fill: str | None = None,
        outline: str | None = None,
        width: int = 2,
    ) -> None:
        self.draw.circle(
            self._pixel(centre),
            radius * self.scale,
            fill=fill,
            outline=outline,
            width=width * _OVERSAMPLING,
        )

    def _line(self, a: NDArray[Any], b: NDArray[Any], colour: str, width: int = 2) -> None:
        self.draw.line([self._pixel(a), self._pixel(b)], fill=colour, width=width * _OVERSAMPLING)


def _has_screen() -> bool:
    """Return whether there is a screen for a window; warn if there is none."""
    import matplotlib.pyplot  # noqa: F401  # it chooses the backend
    from matplotlib import get_backend

    if get_backend().lower() != "agg":
        return True
    warnings.warn(
        "render_mode is 'human', but there is no screen, so nothing is shown; use 'rgb_array' and "
        "show or save the pictures",
        stacklevel=4,
    )
    return False


class _Window:
    """A Matplotlib window that plays the episode in real time."""

    def __init__(self, seconds: float) -> None:
        # Imported here because the import is slow and only this mode needs it.
        import matplotlib.pyplot as plt

        self._plt, self._seconds = plt, seconds
        self._figure = plt.figure("mrsan", figsize=(6, 6))
        axes = self._figure.add_axes((0, 0, 1, 1))
        axes.set_axis_off()
        self._image = axes.imshow(np.full((_SIZE, _SIZE, 3), 255, np.uint8))

    def show(self, picture: NDArray[np.uint8]) -> None:
        self._image.set_data(picture)
        self._plt.pause(self._seconds)

    def close(self) -> None:
        self._plt.close(self._figure)
