"""The arrays on which the kernels of the right of way work, before episodes begin."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from mrsan.kernels.routes import CORNER_ROWS
from mrsan.kernels.walls import PLACE_COLUMNS, WALL_ROWS
from mrsan.observation import KnownMap
from mrsan.passages import Passages
from mrsan.sensors.team import MESSAGE_FEATURES
from samarl.planning.right_of_way import BY_RULE, Memory, Mouths


def empty_memory(e: int, n: int) -> Memory:
    """Return the memory of E worlds of N robots before their episodes begin."""
    integers, booleans = np.zeros((e, n), np.int64), np.zeros((e, n), np.bool_)
    return Memory(
        pose=np.zeros((e, n, 5)),
        goal=np.zeros((e, n, 2)),
        arrived=booleans.copy(),
        is_new=booleans | True,
        mode=integers.copy(),
        entry=integers - 1,
        exit=integers - 1,
        inside=booleans.copy(),
        ahead=integers.copy(),
        queued=integers - 1,
        place=np.zeros((e, n, 2)),
        stuck=integers.copy(),
        yields=integers.copy(),
        macro_action=np.zeros((e, n), np.int32),
        known=np.zeros((e, n, n), np.bool_),
        belief=np.zeros((e, n, n, len(MESSAGE_FEATURES))),
        choice=integers + BY_RULE,
        due=booleans.copy(),
        age=integers.copy(),
        event=integers - 1,
    )


def mouths_of_worlds(worlds: Sequence[Passages]) -> tuple[Mouths, NDArray[np.int64]]:
    """Return the mouths of all worlds, and the first of each world, [E + 1]."""
    places = [points for passages in worlds for points in passages.places]
    first_place = np.cumsum([0, *map(len, places)])
    mouths = Mouths(
        position=np.concatenate([passages.mouth for passages in worlds]),
        outward=np.concatenate([passages.outward for passages in worlds]),
        width=np.concatenate([passages.width for passages in worlds]),
        passage=np.concatenate([passages.passage for passages in worlds]),
        length=np.concatenate([passages.length[passages.passage] for passages in worlds]),
        first_place=first_place[:-1],
        last_place=first_place[1:],
        places=np.concatenate([np.zeros((0, 2)), *places]),
    )
    return mouths, np.cumsum([0, *(len(passages.mouth) for passages in worlds)])


def open_floor(e: int) -> KnownMap:
    """Return the map of worlds without walls."""
    return KnownMap(
        np.zeros((e, PLACE_COLUMNS), np.float32),
        np.zeros((e, WALL_ROWS, 0), np.float32),
        np.zeros((e, CORNER_ROWS, 0), np.float32),
        np.zeros((e, 0, 0), np.float32),
    )
