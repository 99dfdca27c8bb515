"""Figure of a map file."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib import rc_context
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Polygon as Patch
from matplotlib.transforms import Affine2D

from mrsan.maps import MapFile
from mrsan.maps.polygons import signed_area
from mrsan.maps.ros import RosMap
from samarl.report.style import INK, STYLE, save_figure, show_floor

_FLOOR, _SOLID, _UNKNOWN = "#ffffff", "#c9ced6", "#eaecef"
_WIDTH = 7.0  # inches
_HEIGHTS = (3.0, 9.0)  # inches
_MOST_PIXELS = 2000  # along a side of a grid


def save_map(file: MapFile, title: str, path: Path) -> None:
    """Draw the floor, obstacles and walls of a map, and write the figure atomically.

    The cells of an occupancy grid are drawn below its polygons.

    Args:
        file: the map; drawn in the coordinates of its file.
        title: above the figure.
        path: output file; its extension is the format.
    """
    points = np.concatenate(file.polygons)
    low, high = points.min(0), points.max(0)
    margin = 0.05 * float((high - low).max())
    width, height = high - low + 2 * margin
    size = (_WIDTH, float(np.clip(_WIDTH * height / width + 0.6, *_HEIGHTS)))
    is_filled = file.ros is None  # otherwise its cells are drawn
    is_bounded = signed_area(file.polygons[0]) < 0
    with rc_context(STYLE):
        figure = Figure(figsize=size, layout="compressed")
        axes = figure.subplots()
        axes.set_facecolor(_SOLID if is_bounded and is_filled else _FLOOR)
        if file.ros is not None:
            _draw_cells(axes, file.ros)
        for number, polygon in enumerate(file.polygons):
            if len(polygon) == 2:
                axes.plot(*polygon.T, color=INK, linewidth=1.5)
            else:
                fill = _FLOOR if is_bounded and number == 0 else _SOLID
                patch = Patch(polygon, facecolor=fill, edgecolor=INK, linewidth=1.2, fill=is_filled)
                axes.add_patch(patch)
        show_floor(axes, low, high, margin)
        axes.ticklabel_format(useOffset=False, style="plain")
        axes.grid(False)
        axes.set_title(title, parse_math=False)
        save_figure(figure, path)


def _draw_cells(axes: Axes, ros: RosMap) -> None:
    free, occupied = ros.grid
    rows, columns = free.shape
    kinds = np.select([free, occupied], [0, 1], 2).astype(np.uint8)
    step = max(1, max(rows, columns) // _MOST_PIXELS)
    x, y, yaw = ros.origin
    axes.imshow(
        kinds[::step, ::step],
        cmap=ListedColormap([_FLOOR, _SOLID, _UNKNOWN]),
        vmin=0,
        vmax=2,
        interpolation="nearest",
        extent=(0.0, columns * ros.resolution, 0.0, rows * ros.resolution),
        transform=Affine2D().rotate(yaw).translate(x, y) + axes.transData,
    )
    kinds_shown = (("free", _FLOOR), ("occupied", _SOLID), ("unknown", _UNKNOWN))
    handles: list[Artist] = [
        Patch([(0, 0)], facecolor=fill, edgecolor=INK, label=name) for name, fill in kinds_shown
    ]
    handles.append(Line2D([], [], color=INK, label="walls"))
    axes.figure.legend(handles=handles, loc="outside lower center", ncols=4)
