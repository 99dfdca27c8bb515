"""Walls on a robot: known maps, scans, and what the shield does with them."""

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import shapely

from mrsan import Scenario, World
from mrsan.place_shapes import polygons_of
from samarl.agents.learned import Learned
from samarl.agents.shielded import Shielded
from samarl.export import export_agent
from samarl.planning.shield import Shield
from samarl.policies.checkpoint import save_policy
from samarl.runtime import Driver, InputError, KnownMap, OwnState, walls_of_scan
from samarl.runtime.simulation import as_seen, walls_in_view
from tests import learning

BOUNDS = np.array([(-6, -4), (-6, 4), (6, 4), (6, -4)], float)  # clockwise
PARTITION = np.array([(0, -4), (0, 2)], float)  # a way round at the top
OWN = OwnState(-3.0, 0.0, 0.0, 0.0, 0.0, 3.0, 0.0)


def test_a_route_leads_round_the_end_of_a_wall() -> None:
    own = KnownMap([BOUNDS, PARTITION], clearance=0.4).with_route(OWN)
    assert own.next_x == pytest.approx(-0.4, abs=1e-3)
    assert own.next_y == pytest.approx(2.4, abs=1e-3)
    above = KnownMap([BOUNDS, PARTITION]).with_route(OWN._replace(x=-1.0, y=3.0, goal_y=3.0))
    assert (above.next_x, above.next_y) == (3.0, 3.0)


def test_a_grid_gives_the_same_route() -> None:
    free = np.ones((160, 240), bool)  # 5 cm per cell, the top row first
    free[40:, 119:121] = False
    known = KnownMap.of_grid(free, 0.05, (-6.0, -4.0, 0.0))
    own = known.with_route(OWN)
    assert own.next_x == pytest.approx(-0.45, abs=0.1)
    assert own.next_y == pytest.approx(2.4, abs=0.2)  # outlines are simplified


def test_the_walls_of_a_scan_are_those_of_the_room() -> None:
    known = KnownMap([BOUNDS, PARTITION])
    lines = shapely.multilinestrings(shapely.linestrings(known.walls.reshape(-1, 2, 2)))
    own = OWN._replace(heading=0.7)
    angles = np.linspace(-math.pi, math.pi, 360, endpoint=False)
    ranges = []
    for angle in angles + own.heading:
        ray = shapely.LineString(
            [(own.x, own.y), (own.x + 8 * math.cos(angle), own.y + 8 * math.sin(angle))]
        )
        hit = ray.intersection(lines)
        ranges.append(np.inf if hit.is_empty else hit.distance(shapely.Point(own.x, own.y)))
    walls = walls_of_scan(ranges, angles, own, 8.0)
    assert 3 <= len(walls) <= 12
    pieces = shapely.linestrings(walls.reshape(-1, 2, 2))
    for piece in pieces:  # on a wall, but for corners that are cut off
        assert piece.hausdorff_distance(piece.intersection(lines.buffer(0.15))) < 0.15
    assert sum(piece.length for piece in pieces) > 20.0
    assert walls_of_scan([np.inf, np.nan, 8.0], [0.0, 0.1, 0.2], own, 8.0).shape == (0, 4)


@pytest.mark.parametrize("layout", ["doorway", "rooms"])
def test_walls_of_a_map_face_the_robot_as_in_the_simulator(layout: str) -> None:
    """Also where a thick wall has its far side in range: that is not floor."""
    place = {"wall_thickness_min": 0.8}
    scenario = Scenario(layout=layout, place=place, humans=0, nearest_walls=64, sensing_range=1e3)
    world = World(scenario, 8)
    observation = world.reset(range(8))
    far_sides = 0
    for case in range(8):
        known = KnownMap(polygons_of(world.state, case))
        for robot in range(scenario.robots):
            own, _ = as_seen(observation, robot, case)
            facing, seen = known.facing(own), walls_in_view(observation, own, robot, case)
            far_sides += len(known.walls) - len(facing)
            in_order = facing[np.lexsort(facing.round(3).T)]
            np.testing.assert_allclose(in_order, seen[np.lexsort(seen.round(3).T)], atol=1e-4)
    assert far_sides > 0


@pytest.fixture(scope="module")
def driver(tmp_path_factory: pytest.TempPathFactory) -> Driver:
    """A policy that was trained without walls and drives towards its goal, with the shield."""
    folder = tmp_path_factory.mktemp("walls")
    save_policy(folder / "policy.safetensors", learning.policy("flat", gain=100.0), "flat", {})
    scenario = Scenario(humans=3, robots=2)
    agent = Learned(scenario, str(folder / "policy.safetensors"))
    export_agent(folder / "policy.onnx", Shielded(scenario, agent, Shield()), "mine")
    return Driver.load(folder / "policy.onnx")


def test_the_shield_stops_the_robot_before_a_wall(driver: Driver) -> None:
    """Whatever the policy wants, no command leads into a wall."""
    scenario = Scenario(layout="doorway", humans=0, robots=1, time_limit=60.0)
    world, free = World(scenario, 1), World(scenario, 1)
    hits = []
    for one, walls_are_known in ((world, True), (free, False)):
        hit = 0
        for case in range(10):
            observation = one.reset([case])
            driver.reset()
            count = int(one.state.place[0, 0])
            walls = one.state.walls[0, :4, :count].T if walls_are_known else ()
            for step in range(80):
                own, _ = as_seen(observation, 0)
                command = driver.step(own, [], 0.25 * step, walls=walls)
                observation = one.step(command.action[None, None]).observation
                if one.state.done.all():
                    break
            hit += int(one.state.collision[0, 0] != 0)
        hits.append(hit)
    assert hits[0] == 0
    assert hits[1] > 0


@pytest.mark.parametrize(
    "walls", [[[0.0, 1.0, 2.0]], [0.0, 1.0, 2.0, 3.0], "wall", [[0.0, 1.0, math.nan, 3.0]], None]
)
def test_walls_that_cannot_be_used_are_named(driver: Driver, walls: Any) -> None:
    driver.reset()
    with pytest.raises(InputError, match=r"walls .*start_x"):
        driver.step(OWN, [], 1.0, walls=walls)


def test_half_a_next_point_is_refused(driver: Driver) -> None:
    driver.reset()
    with pytest.raises(InputError, match=r"own\.next_y"):
        driver.step(OWN._replace(next_x=1.0), [], 1.0)


def test_a_map_file_is_loaded(tmp_path: Path) -> None:
    path = tmp_path / "map.yaml"
    path.write_text("bounds: [[-6, -4], [6, -4], [6, 4], [-6, 4]]\nwalls: [[[0, -4], [0, 2]]]\n")
    assert KnownMap.load(path).with_route(OWN).next_y == pytest.approx(2.4, abs=1e-3)
