"""One look for all figures: colours that colour-blind readers tell apart, thin lines, no boxes."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from matplotlib import rc_context
from matplotlib.figure import Figure

from samarl.evaluation.files import unfinished

# Okabe and Ito's colours.
COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000")
INK, MUTED, GRID = "#222222", "#777777", "#E4E4E4"
CONTACT = "#C00000"

STYLE: Any = {
    "axes.edgecolor": MUTED,
    "axes.grid": True,
    "axes.grid.axis": "y",
    "axes.axisbelow": True,
    "axes.labelcolor": INK,
    "axes.spines.right": False,
    "axes.spines.top": False,
    "axes.titlecolor": INK,
    "axes.titlesize": 10,
    "font.family": "sans-serif",
    "font.size": 9,
    "grid.color": GRID,
    "legend.frameon": False,
    "savefig.dpi": 160,
    "svg.fonttype": "none",  # text stays text
    "svg.hashsalt": "samarl",  # the same figure is the same file
    "text.color": INK,
    "xtick.color": MUTED,
    "xtick.labelcolor": INK,
    "ytick.color": MUTED,
    "ytick.labelcolor": INK,
}


def save_figure(figure: Figure, path: Path, **options: Any) -> None:
    """Write a figure in the format of the file's ending, atomically."""
    kind = path.suffix.removeprefix(".")
    if kind in ("svg", "pdf"):
        options["metadata"] = {"Date" if kind == "svg" else "CreationDate": None}
    with unfinished(path) as part, rc_context(STYLE):
        figure.savefig(part, format=kind, **options)
