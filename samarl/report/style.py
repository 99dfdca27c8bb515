"""One look for all figures and pages: few colours, thin lines, no boxes, light and dark."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from matplotlib import rc_context
from matplotlib.figure import Figure
from PIL import Image

from mrsan.rendering import ROBOT_COLOURS
from samarl.files import unfinished

_DARK_SERIES = ("#4FA8E0", "#FF8B3D", "#2CC79B", "#E79CC6", "#F2B632", "#8CD0F7", "#FFFFFF")
# Each with what stands for it on a dark page.
PALETTE = {
    **{f"series-{i}": pair for i, pair in enumerate(zip(ROBOT_COLOURS, _DARK_SERIES, strict=True))},
    "ink": ("#222222", "#E8E8E8"),
    "muted": ("#666666", "#A6A6A6"),
    "grid": ("#E4E4E4", "#3A3A3A"),
    "contact": ("#C00000", "#FF5C5C"),
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
    "axes.titlesize": 10,
    "font.family": "sans-serif",
    "font.size": 9,
    "grid.color": GRID,
    "legend.frameon": False,
    "savefig.bbox": "tight",
    "savefig.dpi": 130,
    "svg.fonttype": "none",  # text stays text
    "svg.hashsalt": "samarl",  # the same figure is the same file
    "text.color": INK,
    "xtick.color": MUTED,
    "xtick.labelcolor": INK,
    "ytick.color": MUTED,
    "ytick.labelcolor": INK,
}


def save_figure(figure: Figure, path: Path) -> None:
    """Write a figure in the format that the file extension names, atomically."""
    kind = path.suffix.removeprefix(".").lower()
    dateless = {"svg": {"Date": None}, "pdf": {"CreationDate": None}}.get(kind)
    with unfinished(path) as part, rc_context(STYLE):
        figure.savefig(part, format=kind, metadata=dateless, transparent=kind == "svg")
        if kind == "svg":
            part.write_text(_dark_too(part.read_text(encoding="utf-8")), encoding="utf-8")
        if kind == "png":  # 256 colours are enough, and a third of the bytes
            with Image.open(part) as image:
                image.convert("RGB").quantize(256).save(part, "PNG", optimize=True)


def _dark_too(svg: str) -> str:
    """Let an SVG follow the reader's choice of light or dark; elsewhere it stays light."""
    rules = "".join(
        f'[style*="{what}: {light.lower()}"]{{{what}:{dark}!important}}'
        for light, dark in PALETTE.values()
        for what in ("fill", "stroke")
    )
    head, mark, rest = svg.partition("<defs>")
    style = f"<style>@media (prefers-color-scheme: dark){{{rules}}}</style>"
    return f"{head}{style}\n {mark}{rest}"
