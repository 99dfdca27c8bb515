"""Figure of the probabilities that seeds of one method are better than seeds of another."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import groupby

import numpy as np
from matplotlib import colormaps, rc_context
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import ListedColormap, Normalize
from matplotlib.figure import Figure

from samarl.evaluation.seeds import Improvements
from samarl.evaluation.table import column_name
from samarl.report.style import INK, STYLE

# Orange is worse, purple is better: colours that colour-blind readers tell apart. The darkest
# shades are left out, on which text is hard to read.
_SHADES = ListedColormap(colormaps["PuOr"](np.linspace(0.1, 0.9, 255)))
_WIDTH = 7.7  # inches: 1000 pixels
_LINE, _MARGINS = 0.19, 2.0  # inches per line, and for headings and the colour bar
_LIGHT_TEXT = "#FFFFFF"
_LUMINANCE = (0.299, 0.587, 0.114)  # of red, green and blue


def draw_improvements(matrices: Sequence[Improvements]) -> Figure:
    """Draw matrices side by side: one line per other method, one column per column of the table.

    Bold values differ from 0.5 by their 95 % interval; cells without a comparison are empty.
    """
    with rc_context({**STYLE, "font.size": 8, "axes.grid": False}):
        height = _MARGINS + _LINE * len(matrices[0].others)
        figure = Figure(figsize=(_WIDTH, height), layout="constrained")
        panels = figure.subplots(1, len(matrices), sharey=True, squeeze=False)[0]
        panels[0].invert_yaxis()  # of all
        for axes, matrix in zip(panels, matrices, strict=True):
            _draw_matrix(axes, matrix)
        figure.colorbar(
            ScalarMappable(Normalize(0, 1), _SHADES),
            ax=list(panels),
            location="bottom",
            label="probability that a seed of the method above is better than one at the left\n"
            "(bold: the 95 % interval excludes 0.5)",
            aspect=60,
            shrink=0.6,
            ticks=[0, 0.25, 0.5, 0.75, 1],
        ).outline.set_visible(False)
    return figure


def _draw_matrix(axes: Axes, matrix: Improvements) -> None:
    axes.spines[:].set_visible(False)
    axes.tick_params(length=0)
    axes.pcolormesh(
        np.ma.masked_invalid(matrix.estimates[..., 0]),
        cmap=_SHADES,
        vmin=0,
        vmax=1,
        edgecolors="white",
        linewidth=1,
    )
    for y, x in np.argwhere(~np.isnan(matrix.estimates[..., 0])):
        share, low, high = matrix.estimates[y, x]
        is_dark = np.dot(_SHADES(share)[:3], _LUMINANCE) < 0.5
        axes.text(
            x + 0.5,
            y + 0.5,
            f"{share:.2f}",
            ha="center",
            va="center_baseline",
            color=_LIGHT_TEXT if is_dark else INK,
            fontsize=7,
            weight="normal" if low <= 0.5 <= high else "bold",
        )
    names = [column_name(column).replace(" ", "\n") for _, column in matrix.columns]
    axes.set_xticks(np.arange(len(names)) + 0.5, names)
    axes.set_yticks(np.arange(len(matrix.others)) + 0.5, matrix.others)
    axes.xaxis.tick_top()
    axes.set_title(matrix.quantity, loc="left", weight="bold", pad=24)
    x = 0
    for method, columns in groupby(matrix.columns, key=lambda column: column[0]):
        count = len(list(columns))
        if x:
            axes.axvline(x, color="white", linewidth=5)
        axes.annotate(
            method,
            (x + count / 2, 1.0),
            (0, 36),  # above the names of the columns
            xycoords=("data", "axes fraction"),
            textcoords="offset points",
            ha="center",
        )
        x += count
