"""Figure of a map file."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib import rc_context
from matplotlib.figure import Figure
from matplotlib.patches import Polygon as Patch

from mrsan.maps import MapFile
from mrsan.maps.polygons import signed_area
from samarl.report.style import INK, STYLE, save_figure

_FLOOR, _SOLID = "#ffffff", "#c9ced6"
_WIDTH = 7.0  # inches
_HEIGHTS = (3.0, 9.0)  # inches


def save_map(file: MapFile, title: str, path: Path) -> None:
    """Draw the floor, obstacles and walls of a map, and write the figure atomically.

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
    is_bounded = signed_area(file.polygons[0]) < 0
    with rc_context(STYLE):
        figure = Figure(figsize=size, layout="compressed")
        axes = figure.subplots()
        axes.set_facecolor(_SOLID if is_bounded else _FLOOR)
        for number, polygon in enumerate(file.polygons):
            if len(polygon) == 2:
                axes.plot(*polygon.T, color=INK, linewidth=1.5)
            else:
                fill = _FLOOR if is_bounded and number == 0 else _SOLID
                axes.add_patch(Patch(polygon, facecolor=fill, edgecolor=INK, linewidth=1.2))
        axes.set(
            xlim=(low[0] - margin, high[0] + margin),
            ylim=(low[1] - margin, high[1] + margin),
            xlabel="x (m)",
            ylabel="y (m)",
            aspect="equal",
        )
        axes.ticklabel_format(useOffset=False, style="plain")
        axes.grid(False)
        axes.set_title(title, parse_math=False)
        save_figure(figure, path)
