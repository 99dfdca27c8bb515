"""Figure of the tracks in a recording."""

from __future__ import annotations

import textwrap
import warnings
from pathlib import Path

import numpy as np
from matplotlib import colormaps, rc_context
from matplotlib.collections import LineCollection
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from mrsan.recording import People
from samarl.report.style import MUTED, STYLE, save_figure, show_floor

# Without the brightest shades, which are hard to see on white.
_SHADES = ListedColormap(colormaps["viridis"](np.linspace(0.0, 0.92, 256)))
_WIDTH = 7.0  # of the figure, inches
_HEIGHTS = (3.5, 9.0)  # inches


def save_tracks(people: People, title: str, path: Path) -> None:
    """Draw all tracks, coloured by their start time, and write the figure atomically.

    Args:
        people: the recording; positions are drawn in the frame of its file.
        title: lines above the figure.
        path: output file; its extension is the format.
    """
    tracks = [track.rows for track in people.tracks]
    starts = np.array([rows[0] for rows in tracks])
    low, high = people.position.min(0), people.position.max(0)
    margin = max(0.03 * float((high - low).max()), 1e-9)
    width, height = high - low + 2 * margin
    size = float(np.clip(_WIDTH * 0.85 * height / width + 1.0, *_HEIGHTS))
    with rc_context(STYLE), warnings.catch_warnings():
        warnings.filterwarnings("ignore", "Glyph")  # characters that the font lacks
        figure = Figure(figsize=(_WIDTH, size), layout="compressed")
        axes = figure.subplots()
        lines = LineCollection(
            [people.position[rows] for rows in tracks], cmap=_SHADES, linewidths=1.1, alpha=0.8
        )
        lines.set_array(people.seconds[starts])
        axes.add_collection(lines)
        x, y = people.position[starts].T
        axes.scatter(
            x,
            y,
            c=people.seconds[starts],
            cmap=_SHADES,
            s=20,
            zorder=3,
            edgecolors="white",
            linewidths=0.7,
        )
        show_floor(axes, low, high, margin)
        axes.grid(True, axis="both")
        shown = "\n".join(textwrap.fill(line, 90) for line in title.splitlines())
        axes.set_title(shown, parse_math=False)
        start = Line2D([], [], linestyle="none", marker="o", color=MUTED, label="start of a track")
        figure.legend(handles=[start], loc="outside lower center")
        figure.colorbar(lines, ax=axes, label="start of the track (s)", shrink=0.8)
        save_figure(figure, path)
