"""`samarl-map`: show what the simulator understands of a map file."""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

from mrsan.fixed_map import centre_of
from mrsan.maps import MOST_SEGMENTS, MapFile, read_map
from mrsan.maps.polygons import covered_area, signed_area
from samarl.commands.console import PICTURES, Parser, check_output, origin_of_world, run, table


def main() -> None:
    """Entry point."""
    parser = Parser(
        "samarl-map",
        "Show what is understood of a map file: its floor, walls and cells. It is used with "
        "scenario.layout=map scenario.map=FILE.",
        "YAML or GeoJSON, or the YAML file of a map of ROS",
    )
    parser.add_argument(
        "--figure", type=Path, metavar="PICTURE", help=f"draw the map ({', '.join(PICTURES)})"
    )
    run(parser, _describe)


def _describe(arguments: argparse.Namespace) -> None:
    """Print what was understood, then draw the map.

    Raises:
        ValueError: an option or the file cannot be used.
    """
    path: Path = arguments.file
    check_output("--figure", arguments.figure, path, pictures=True)
    file = read_map(path)
    print(table(_rows(file)))
    if arguments.figure is not None:
        from samarl.report.map_figure import save_map  # imports matplotlib, which takes a second

        save_map(file, path.name, arguments.figure)
        print(f"written to {arguments.figure}")


def _rows(file: MapFile) -> list[tuple[str, str]]:
    outline, *others = file.polygons
    low, high = np.concatenate(file.polygons).min(0), np.concatenate(file.polygons).max(0)
    solid = [polygon for polygon in others if len(polygon) > 2]
    is_bounded = signed_area(outline) < 0  # clockwise
    floor = f"{-signed_area(outline) - covered_area(solid):.1f} m²" if is_bounded else "unbounded"
    obstacles = len(solid) + (not is_bounded and len(outline) > 2)
    thin = sum(len(polygon) == 2 for polygon in file.polygons)
    segments = sum(map(len, file.polygons))
    rows = [
        ("format", file.format),
        ("floor", floor),
        ("extent", f"x {low[0]:.2f} to {high[0]:.2f} m, y {low[1]:.2f} to {high[1]:.2f} m"),
        ("obstacles", f"{obstacles}, and {thin} thin walls"),
        ("segments", f"{segments} of at most {MOST_SEGMENTS}"),
        ("origin", origin_of_world(centre_of(file.polygons))),
    ]
    if file.ros is not None:
        free, occupied = file.ros.grid
        height, width = free.shape
        known = free.sum() + occupied.sum()
        shares = (free.mean(), occupied.mean(), 1 - known / free.size)
        free_share, occupied_share, unknown_share = (f"{100 * share:.1f} %" for share in shares)
        rows.append(("cells", f"{width} x {height} of {file.ros.resolution:g} m"))
        area = f"{free.sum() * file.ros.resolution**2:.1f} m²"
        shares_shown = f"{occupied_share} occupied, {unknown_share} unknown"
        rows.append(("", f"{free_share} free ({area}; the largest area is used), {shares_shown}"))
    return [*rows, *(("note", note) for note in file.notes)]


if __name__ == "__main__":
    main()
