"""The numbers of the families of places with walls, see `mrsan.kernels.places`."""

from __future__ import annotations

from collections import namedtuple
from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from mrsan.choices import Layout
from mrsan.fields import ConfigurationError, check_numbers, number, short_repr


@dataclass
class Place:
    """The ranges from which the openings of a place are drawn for each case."""

    __repr__ = short_repr

    feasible_margin: float = number(
        0.1, 0.0, 1.0, unit="m", help="distance that routes keep from walls, besides the radius"
    )
    # doorway: two rooms with an opening in the wall between them
    wall_thickness_min: float = number(0.3, 0.05, 5.0, unit="m", help="doorway: thinnest wall")
    wall_thickness_max: float = number(1.0, 0.05, 5.0, unit="m", help="doorway: thickest wall")
    door_width_min: float = number(0.9, 0.1, 10.0, unit="m", help="doorway: narrowest opening")
    door_width_max: float = number(2.0, 0.1, 10.0, unit="m", help="doorway: widest opening")
    # corridor: two rooms joined by a corridor
    corridor_width_min: float = number(1.2, 0.1, 20.0, unit="m", help="narrowest corridor")
    corridor_width_max: float = number(3.0, 0.1, 20.0, unit="m", help="widest corridor")
    # corner: two arms at right angles
    corner_width_min: float = number(1.5, 1.0, 20.0, unit="m", help="corner: narrowest arms")
    corner_width_max: float = number(3.0, 1.0, 20.0, unit="m", help="corner: widest arms")
    # rooms: a grid of 2 x 2 to 3 x 3 rooms
    rooms_door_min: float = number(1.0, 0.1, 10.0, unit="m", help="rooms: narrowest door")
    rooms_door_max: float = number(1.5, 0.1, 10.0, unit="m", help="rooms: widest door")


SIZES: dict[str, float | int] = {
    "crossing_share": 0.5,  # probability that a person's goal is in another room
    "room_length": 9.0,  # doorway: m, as all that follow but shares and numbers
    "room_width": 10.0,
    "end_room_length": 5.0,  # corridor
    "end_room_width": 6.0,
    "corridor_length_min": 6.0,
    "corridor_length_max": 14.0,
    "intersection_length": 8.0,  # of an arm
    "intersection_width_min": 2.0,
    "intersection_width_max": 4.0,
    "corner_length": 10.0,  # of an arm, with the corner
    "rooms_size_min": 4.0,  # sides of a room
    "rooms_size_max": 6.0,
    "rooms_loop_share": 0.3,  # probability of a door that no route needs
    "pillars_floor": 12.0,  # side of the floor
    "pillars_min": 5,
    "pillars_max": 15,
    "pillars_size_min": 0.3,  # sides of a pillar
    "pillars_size_max": 1.2,
    "pillars_round_share": 0.5,
    "pillars_gap": 1.0,  # narrowest, between them and to the walls
}
"""The other numbers of the families, which are the same in every scenario."""


def check_place(place: Place) -> None:
    """Check the numbers of a place.

    Raises:
        ConfigurationError: a number is out of range, or a smallest one exceeds the largest one.
    """
    check_numbers(place, "scenario.place")
    for field in fields(Place):
        largest = field.name.removesuffix("_min") + "_max"
        if field.name.endswith("_min") and getattr(place, field.name) > getattr(place, largest):
            raise ConfigurationError(
                f"scenario.place.{field.name} is {getattr(place, field.name)}; it must not exceed "
                f"scenario.place.{largest} ({getattr(place, largest)})"
            )


def largest_place(layout: Layout) -> tuple[int, int]:
    """Return the largest numbers of wall segments and of corners in a layout; 0 without walls."""
    if layout is Layout.places:
        sizes = [largest_place(family) for family in FAMILIES]
        return max(walls for walls, _ in sizes), max(corners for _, corners in sizes)
    pillars = int(SIZES["pillars_max"])
    return {
        Layout.doorway: (12, 4),
        Layout.corridor: (12, 4),
        Layout.intersection: (12, 4),
        Layout.corner: (6, 1),
        Layout.rooms: (52, 48),  # 12 inner walls of two pieces, two corners at each door post
        Layout.pillars: (4 + 16 * pillars, 8 * pillars),
    }.get(layout, (0, 0))


def half_size(layout: Layout, place: Place) -> float:
    """Return the largest distance of a wall from the centre along an axis, m."""
    p, s = place, SIZES
    if layout is Layout.places:
        return max(half_size(family, place) for family in FAMILIES)
    return {
        Layout.doorway: max(p.wall_thickness_max / 2 + s["room_length"], s["room_width"] / 2),
        Layout.corridor: max(
            s["corridor_length_max"] / 2 + s["end_room_length"], s["end_room_width"] / 2
        ),
        Layout.intersection: s["intersection_width_max"] / 2 + s["intersection_length"],
        Layout.corner: s["corner_length"] / 2,
        Layout.rooms: 1.5 * s["rooms_size_max"],
        Layout.pillars: s["pillars_floor"] / 2,
    }[layout]


FAMILIES = (
    Layout.doorway,
    Layout.corridor,
    Layout.intersection,
    Layout.corner,
    Layout.rooms,
    Layout.pillars,
)

PlaceParameters: Any = namedtuple(  # type: ignore[misc]
    "PlaceParameters", [*(f.name for f in fields(Place)), *SIZES]
)


def place_parameters(place: Place) -> Any:
    """Return the numbers of a place in the form that kernels take."""
    ranges = (np.float32(getattr(place, f.name)) for f in fields(Place))
    sizes = (size if isinstance(size, int) else np.float32(size) for size in SIZES.values())
    return PlaceParameters(*ranges, *sizes)
