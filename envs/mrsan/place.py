"""The numbers of the families of places with walls, see `mrsan.kernels.places`."""

from __future__ import annotations

from collections import namedtuple
from dataclasses import dataclass, fields
from typing import Any

from mrsan.choices import Layout
from mrsan.fields import ConfigurationError, check_numbers, kernel_form, number


@dataclass
class Place:
    """The ranges from which the geometry of a place is drawn for each case."""

    feasible_margin: float = number(
        0.1, 0.0, 1.0, unit="m", help="distance that routes keep from walls, besides the radius"
    )
    crossing_share: float = number(
        0.5, 0.0, 1.0, help="probability that a person's goal is in another room"
    )
    # doorway: two rooms with an opening in the wall between them
    room_length: float = number(9.0, 4.0, 50.0, unit="m", help="doorway: length of a room")
    room_width: float = number(10.0, 4.0, 50.0, unit="m", help="doorway: width of a room")
    wall_thickness_min: float = number(0.3, 0.05, 5.0, unit="m", help="doorway: thinnest wall")
    wall_thickness_max: float = number(1.0, 0.05, 5.0, unit="m", help="doorway: thickest wall")
    door_width_min: float = number(0.9, 0.1, 10.0, unit="m", help="doorway: narrowest opening")
    door_width_max: float = number(2.0, 0.1, 10.0, unit="m", help="doorway: widest opening")
    # corridor: two rooms joined by a corridor
    end_room_length: float = number(5.0, 3.0, 50.0, unit="m", help="corridor: length of a room")
    end_room_width: float = number(6.0, 3.0, 50.0, unit="m", help="corridor: width of a room")
    corridor_length_min: float = number(6.0, 0.5, 100.0, unit="m", help="shortest corridor")
    corridor_length_max: float = number(14.0, 0.5, 100.0, unit="m", help="longest corridor")
    corridor_width_min: float = number(1.2, 0.1, 20.0, unit="m", help="narrowest corridor")
    corridor_width_max: float = number(3.0, 0.1, 20.0, unit="m", help="widest corridor")
    # intersection: four arms
    intersection_length: float = number(8.0, 2.0, 100.0, unit="m", help="length of an arm")
    intersection_width_min: float = number(2.0, 1.0, 20.0, unit="m", help="narrowest arms")
    intersection_width_max: float = number(4.0, 1.0, 20.0, unit="m", help="widest arms")
    # corner: two arms at right angles
    corner_length: float = number(
        10.0, 4.0, 100.0, unit="m", help="corner: length of an arm, with the corner"
    )
    corner_width_min: float = number(1.5, 1.0, 20.0, unit="m", help="corner: narrowest arms")
    corner_width_max: float = number(3.0, 1.0, 20.0, unit="m", help="corner: widest arms")
    # rooms: a grid of 2 x 2 to 3 x 3 rooms
    rooms_size_min: float = number(4.0, 2.5, 50.0, unit="m", help="rooms: smallest side of a room")
    rooms_size_max: float = number(6.0, 2.5, 50.0, unit="m", help="rooms: largest side of a room")
    rooms_door_min: float = number(1.0, 0.1, 10.0, unit="m", help="rooms: narrowest door")
    rooms_door_max: float = number(1.5, 0.1, 10.0, unit="m", help="rooms: widest door")
    rooms_loop_share: float = number(
        0.3, 0.0, 1.0, help="rooms: probability of a door that no route needs"
    )
    # pillars: a floor with boxes and round pillars
    pillars_floor: float = number(12.0, 4.0, 100.0, unit="m", help="pillars: side of the floor")
    pillars_min: int = number(5, 0, 15, help="smallest number of pillars")
    pillars_max: int = number(15, 0, 15, help="largest number of pillars")
    pillars_size_min: float = number(0.3, 0.1, 5.0, unit="m", help="pillars: smallest side")
    pillars_size_max: float = number(1.2, 0.1, 5.0, unit="m", help="pillars: largest side")
    pillars_round_share: float = number(0.5, 0.0, 1.0, help="pillars: share of round ones")
    pillars_gap: float = number(
        1.0, 0.0, 10.0, unit="m", help="pillars: narrowest gap between them and to the walls"
    )


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


def largest_place(layout: Layout, place: Place) -> tuple[int, int]:
    """Return the largest numbers of wall segments and of corners in a layout; 0 without walls."""
    if layout is Layout.places:
        sizes = [largest_place(family, place) for family in FAMILIES]
        return max(walls for walls, _ in sizes), max(corners for _, corners in sizes)
    return {
        Layout.doorway: (12, 4),
        Layout.corridor: (12, 4),
        Layout.intersection: (12, 4),
        Layout.corner: (6, 1),
        Layout.rooms: (52, 48),  # 12 inner walls of two pieces, two corners at each door post
        Layout.pillars: (4 + 16 * place.pillars_max, 8 * place.pillars_max),
    }.get(layout, (0, 0))


def half_size(layout: Layout, place: Place) -> float:
    """Return the largest distance of a wall from the centre along an axis, m."""
    p = place
    if layout is Layout.places:
        return max(half_size(family, place) for family in FAMILIES)
    return {
        Layout.doorway: max(p.wall_thickness_max / 2 + p.room_length, p.room_width / 2),
        Layout.corridor: max(p.corridor_length_max / 2 + p.end_room_length, p.end_room_width / 2),
        Layout.intersection: p.intersection_width_max / 2 + p.intersection_length,
        Layout.corner: p.corner_length / 2,
        Layout.rooms: 1.5 * p.rooms_size_max,
        Layout.pillars: p.pillars_floor / 2,
    }[layout]


FAMILIES = (
    Layout.doorway,
    Layout.corridor,
    Layout.intersection,
    Layout.corner,
    Layout.rooms,
    Layout.pillars,
)

_FORMS = {f.name: kernel_form({"int": int}.get(str(f.type), float)) for f in fields(Place)}
PlaceParameters: Any = namedtuple("PlaceParameters", list(_FORMS))  # type: ignore[misc]


def place_parameters(place: Place) -> Any:
    """Return the numbers of a place in the form that kernels take."""
    values = (form(getattr(place, name)) for name, form in _FORMS.items() if form is not None)
    return PlaceParameters(*values)
