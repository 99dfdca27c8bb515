"""Style of all figures and pages, in a light and a dark version."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray
from PIL import Image

from mrsan.rendering import PASSAGE_COLOUR, ROBOT_COLOURS
from samarl.files import atomic_write

_DARK_SERIES = ("#4FA8E0", "#FF8B3D", "#2CC79B", "#E79CC6", "#F2B632", "#8CD0F7", "#FFFFFF")
# Each colour with its counterpart on a dark page.
PALETTE = {
    **{f"series-{i}": pair for i, pair in enumerate(zip(ROBOT_COLOURS, _DARK_SERIES, strict=True))},
    "ink": ("#222222", "#E8E8E8"),
    "muted": ("#666666", "#A6A6A6"),
    "grid": ("#E4E4E4", "#3A3A3A"),
    "contact": ("#C00000", "#FF5C5C"),
    "passage": (PASSAGE_COLOUR, "#C9B86A"),
    "attention": ("#7B2CBF", "#C89BFF"),
    "page": ("#FFFFFF", "#161616"),
    "panel": ("#F5F5F5", "#222222"),
}
COLOURS = ROBOT_COLOURS
INK, MUTED, GRID, CONTACT = (PALETTE[name][0] for name in ("ink", "muted", "grid", "contact"))

STYLE: Any = {
    "axes.edgecolor": MUTED,
    "axes.grid": True,
    "axes.grid.axis": "y",
    "axes.axisbelow": True,
    "axes.labelcolor": INK,
    "axes.spines.right": False,
    "axes.spines.top": False,
    "axes.titlecolor": INK,
    "axes.titlesize": 11,
    "font.family": "sans-serif",
    "font.size": 10,
    "grid.color": GRID,
    "legend.frameon": False,
    "savefig.bbox": "tight",
    "savefig.dpi": 130,
    "svg.fonttype": "none",  # keep text as text
    "svg.hashsalt": "samarl",  # makes files reproducible
    "text.color": INK,
    "xtick.color": MUTED,
    "xtick.labelcolor": INK,
    "ytick.color": MUTED,
    "ytick.labelcolor": INK,
}


def show_floor(axes: Axes, low: NDArray[Any], high: NDArray[Any], margin: float) -> None:
    """Make axes show a floor between its corners [2], with a margin, in metres of equal length."""
    axes.set(
        xlim=(low[0] - margin, high[0] + margin),
        ylim=(low[1] - margin, high[1] + margin),
        xlabel="x (m)",
        ylabel="y (m)",
        aspect="equal",
    )


def save_figure(figure: Figure, path: Path) -> None:
    """Write a figure in the format that the file extension names, atomically."""
    kind = path.suffix.removeprefix(".").lower()
    metadata = {"svg": {"Date": None}, "pdf": {"CreationDate": None}}.get(kind)
    with atomic_write(path) as part, rc_context(STYLE):
        figure.savefig(part, format=kind, metadata=metadata, transparent=kind == "svg")
        if kind == "svg":
            part.write_text(_with_dark_mode(part.read_text(encoding="utf-8")), encoding="utf-8")
        if kind == "png":  # 256 colours suffice and take a third of the bytes
            with Image.open(part) as image:
                image.convert("RGB").quantize(256).save(part, "PNG", optimize=True)


def _with_dark_mode(svg: str) -> str:
    """Add dark colours to an SVG for readers who prefer a dark colour scheme."""
    rules = "".join(
        f'[style*="{attribute}: {light.lower()}"]{{{attribute}:{dark}!important}}'
        for light, dark in PALETTE.values()
        for attribute in ("fill", "stroke")
    )
    head, mark, rest = svg.partition("<defs>")
    style = f"<style>@media (prefers-color-scheme: dark){{{rules}}}</style>"
    return f"{head}{style}\n {mark}{rest}"
