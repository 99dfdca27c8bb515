"""Draw the example map of ROS: `python -m tools.draw_office examples/maps`."""

from __future__ import annotations

import sys
from pathlib import Path

from PIL import Image, ImageDraw

WIDTH, HEIGHT, RESOLUTION = 16.0, 12.0, 0.05  # m
WALL = 0.2  # thickness, m

# Inner walls and furniture as rectangles: left, bottom, right, top, m.
WALLS = (
    (5.0, 7.0, 5.2, 12.0),  # between two offices at the top
    (10.5, 7.0, 10.7, 12.0),
    (0.0, 7.0, 1.8, 7.2),  # between the offices and the hall, with doors
    (3.2, 7.0, 7.2, 7.2),
    (8.6, 7.0, 12.6, 7.2),
    (14.0, 7.0, 16.0, 7.2),
    (8.0, 0.0, 8.2, 2.4),  # between the meeting room and the hall
    (8.0, 3.8, 8.2, 5.0),
    (8.0, 4.8, 16.0, 5.0),
)
FURNITURE = (
    (0.6, 9.0, 1.6, 11.0),
    (6.6, 10.2, 8.6, 11.2),
    (13.6, 9.2, 15.2, 10.2),
    (10.6, 1.6, 13.4, 3.0),
    (2.4, 2.4, 3.6, 3.6),
    (5.2, 2.4, 6.4, 3.6),
)


def main(folder: Path) -> None:
    """Write `office.pgm` and `office.yaml`."""
    size = round(WIDTH / RESOLUTION), round(HEIGHT / RESOLUTION)
    image = Image.new("L", size, 254)  # free
    draw = ImageDraw.Draw(image)
    outline = (
        (0.0, 0.0, WIDTH, WALL),
        (0.0, HEIGHT - WALL, WIDTH, HEIGHT),
        (0.0, 0.0, WALL, HEIGHT),
        (WIDTH - WALL, 0.0, WIDTH, HEIGHT),
    )
    for left, bottom, right, top in (*outline, *WALLS, *FURNITURE):
        columns = left / RESOLUTION, right / RESOLUTION - 1
        rows = size[1] - top / RESOLUTION, size[1] - bottom / RESOLUTION - 1
        draw.rectangle((columns[0], rows[0], columns[1], rows[1]), fill=0)
    folder.mkdir(parents=True, exist_ok=True)
    image.save(folder / "office.pgm")
    (folder / "office.yaml").write_text(
        f"image: office.pgm\nresolution: {RESOLUTION}\n"
        f"origin: [{-WIDTH / 2}, {-HEIGHT / 2}, 0.0]\n"
        "negate: 0\noccupied_thresh: 0.65\nfree_thresh: 0.196\n",
        encoding="utf-8",
    )


if __name__ == "__main__":
    main(Path(sys.argv[1]))
