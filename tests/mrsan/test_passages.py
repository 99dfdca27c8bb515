"""Passages: doors and corridors against the numbers from which the places were made."""

from pathlib import Path

import numpy as np
import pytest
import shapely

from mrsan import Layout, Place
from mrsan.kernels.walls import WALLS
from mrsan.passages import find_passages
from mrsan.state import State
from tests.mrsan.test_places import floor_of, lines_of, worlds_of

WIDEST = 1.6  # m, less than two robots of 0.6 m abreast need
OFFICE = Path(__file__).parents[2] / "examples" / "maps" / "office.yaml"


def passages_of(state: State, e: int):
    return find_passages(state.walls[e], state.place[e], WIDEST)


def test_a_doorway_and_a_corridor_are_one_passage() -> None:
    """The outline of both is that of two rooms; vertices 2 to 5 and 8 to 11 are their openings."""
    narrow = Place(corridor_width_min=1.0, corridor_width_max=1.5, door_width_max=1.5)
    for layout in (Layout.doorway, Layout.corridor):
        state = worlds_of(layout, 20, place=narrow, humans=0).state
        for e in range(20):
            x, y = state.walls[e, 0, 4], state.walls[e, 1, [9, 3]]
            passages = passages_of(state, e)
            assert passages.passage.tolist() == [0, 0]
            order = np.argsort(passages.mouth[:, 0])
            middle = y.mean()
            expected = [[-x, middle], [x, middle]]
            np.testing.assert_allclose(passages.mouth[order], expected, atol=1e-4)
            np.testing.assert_allclose(passages.outward[order], [[-1, 0], [1, 0]], atol=1e-4)
            np.testing.assert_allclose(passages.width, y[1] - y[0], atol=1e-4)
            np.testing.assert_allclose(passages.length, 2 * x, atol=1e-4)


def test_a_corner_is_one_passage() -> None:
    """Also if the diagonal from the middle of the bend ends exactly in the outer corner."""
    narrow = Place(corner_width_min=1.5, corner_width_max=1.55)
    state = worlds_of(Layout.corner, 20, place=narrow, humans=0).state
    for e in range(20):
        passages = passages_of(state, e)
        assert passages.passage.tolist() == [0, 0]
        np.testing.assert_allclose(passages.length, passages.width[:1] / 2**0.5, atol=1e-4)


def test_open_places_have_none() -> None:
    wide = Place(corner_width_min=1.7, door_width_min=1.7, corridor_width_min=1.7)
    for layout in (Layout.doorway, Layout.corridor, Layout.intersection, Layout.corner):
        state = worlds_of(layout, 20, place=wide, humans=0).state
        assert not any(len(passages_of(state, e).mouth) for e in range(20))


@pytest.mark.parametrize("layout", [Layout.rooms, Layout.pillars, Layout.map])
def test_no_way_between_open_floors_but_through_a_passage(layout: Layout) -> None:
    """Shapely: without the lines between the posts, every two open floors are disconnected."""
    number = 1 if layout is Layout.map else 8
    field = {"map": str(OFFICE)} if layout is Layout.map else {}
    state = worlds_of(layout, number, humans=0, **field).state
    for e in range(number):
        passages, lines, floor = passages_of(state, e), lines_of(state, e), floor_of(state, e)
        assert len(passages.length) > 1
        across = np.stack([-passages.outward[:, 1], passages.outward[:, 0]], -1)
        half = passages.width[:, None] / 2 * across
        posts = np.stack([passages.mouth - half, passages.mouth + half], 1)
        gaps = shapely.union_all(shapely.linestrings(posts)).buffer(1e-3)
        for middle, width in zip(passages.mouth, passages.width, strict=True):
            assert shapely.Point(middle).distance(lines) == pytest.approx(width / 2, abs=5e-3)
            assert width < WIDEST
        parts = shapely.get_parts(floor.difference(lines.buffer(0.4)).difference(gaps))
        open_floors = shapely.get_parts(floor.difference(lines.buffer(WIDEST / 2 + 0.01)))
        for part in parts:
            inside = [part.contains(f.representative_point()) for f in open_floors]
            assert sum(inside) <= 1


def test_queue_places_are_beside_the_mouth() -> None:
    """Free, in sight of the mouth, and no robot there is in the way of one that drives out."""
    state = worlds_of(Layout.rooms, 5, humans=0).state
    for e in range(5):
        passages, lines = passages_of(state, e), lines_of(state, e)
        for k, mouth in enumerate(passages.mouth):
            places = passages.places[k]
            assert len(places) >= 4
            before = shapely.LineString([mouth, mouth + 2.0 * passages.outward[k]])
            for place in shapely.points(places):
                assert place.distance(lines) > 0.39
                assert place.distance(before) > 1.25
            distance = np.linalg.norm(places - mouth, axis=-1)
            assert (np.diff(distance) >= -1e-6).all()
            assert distance[0] < 2.5
            assert not passages.is_blocked(k, places).any()
            assert passages.is_blocked(k, mouth + 0.8 * passages.outward[k])
            assert not passages.is_blocked(k, mouth - 0.8 * passages.outward[k])


def test_a_bend_of_a_corridor_belongs_to_it() -> None:
    """A corridor 1.4 m wide with a right angle between two rooms, as a user's map."""
    outline = [[0, 0], [0, 5], [5, 5], [5, 3.2], [9.4, 3.2], [9.4, 8], [8, 8], [8, 12]]
    outline += [[13, 12], [13, 8], [10.8, 8], [10.8, 1.8], [5, 1.8], [5, 0]]
    from mrsan.fixed_map import map_of_polygons

    loaded = map_of_polygons([np.array(outline, float)], 0.4)
    passages = find_passages(loaded.walls, loaded.place, WIDEST)
    assert passages.passage.tolist() == [0, 0]
    order = np.argsort(passages.mouth[:, 0])
    np.testing.assert_allclose(passages.mouth[order], [[5, 2.5], [10.1, 8]], atol=1e-4)
    np.testing.assert_allclose(passages.outward[order], [[-1, 0], [0, 1]], atol=1e-4)
    assert 9.0 < passages.length[0] < 10.6
    assert int(loaded.place[WALLS]) == len(outline)
