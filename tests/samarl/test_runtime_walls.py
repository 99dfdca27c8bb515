"""Walls on a robot: known maps, scans, and what the shield does with them."""

import math
from pathlib import Path

import numpy as np
import pytest

from mrsan import Scenario, World
from mrsan.place_shapes import polygons_of
from samarl.planning.shield import Shield
from samarl.runtime import Detection, Driver, InputError, KnownMap, OwnState, walls_of_scan
from samarl.runtime.simulation import as_seen, walls_in_view
from tests.driving import driver_without_walls

BOUNDS = np.array([(-6, -4), (-6, 4), (6, 4), (6, -4)], float)  # clockwise
PARTITION = np.array([(0, -4), (0, 2)], float)  # a way round at the top
OWN = OwnState(-3.0, 0.0, 0.0, 0.0, 0.0, 3.0, 0.0)


def test_a_route_leads_round_the_end_of_a_wall() -> None:
    own = KnownMap([BOUNDS, PARTITION], clearance=0.4).with_route(OWN)
    assert own.next_x == pytest.approx(-0.4, abs=1e-3)
    assert own.next_y == pytest.approx(2.4, abs=1e-3)
    above = KnownMap([BOUNDS, PARTITION]).with_route(OWN._replace(x=-1.0, y=3.0, goal_y=3.0))
    assert (above.next_x, above.next_y) == (3.0, 3.0)


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
    return driver_without_walls(tmp_path_factory.mktemp("walls"), Shield())


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


def test_of_too_many_people_the_shield_knows_all(driver: Driver) -> None:
    """The policy has room for three; the fourth nearest one stands in the way."""
    behind = [Detection(-0.9, y, 0.0, 0.0, id=y) for y in (-0.7, 0.0, 0.7)]
    front = [Detection(0.0, y, 0.0, 0.0, id=str(y)) for y in (-1.2, 1.2)]
    wall = [Detection(1.0, y, 0.0, 0.0, id=y + 9) for y in (-0.6, 0.0, 0.6)]
    own = OwnState(0.0, 0.0, 0.0, 1.0, 0.0, 4.0, 0.0)
    driver.reset()
    assert not driver.step(own, behind, 0.0).shielded
    driver.reset()
    assert driver.step(own, [*behind, *front, *wall], 0.0).reason == "person"


def test_obstacles_that_are_not_on_the_map_are_kept_clear_of(driver: Driver) -> None:
    known, own = KnownMap([BOUNDS]), OWN._replace(velocity_x=1.0)
    box = np.array([[-2.4, -0.5, -2.4, 0.5]])
    for obstacles, reason in (((), None), (box, "wall")):
        driver.reset()
        assert driver.step(own, [], 0.0, walls=known, obstacles=obstacles).reason == reason
    with pytest.raises(InputError, match=r"obstacles .*start_x"):
        driver.step(own, [], 1.0, obstacles=known)


def test_walls_that_nobody_would_avoid_are_refused(tmp_path: Path) -> None:
    """Neither does this policy observe walls, nor has it a shield."""
    unshielded = driver_without_walls(tmp_path, None, gain=1.0)
    assert not unshielded.avoids_walls
    for name in ("walls", "obstacles"):
        with pytest.raises(InputError, match=rf"{name} has 1 .*shield"):
            unshielded.step(OWN, [], 0.0, **{name: [[1.0, 0.0, 1.0, 1.0]]})
    assert unshielded.step(OWN, [], 0.0).reason is None


@pytest.mark.parametrize("offset", [(1e3, -2e3), (1e5 + 0.5, 3e5), (1e7, -1e7)])
def test_commands_do_not_depend_on_the_origin_of_the_frame(
    driver: Driver, offset: tuple[float, float]
) -> None:
    """With people, a map, a scan and routes; surveyed sites have coordinates of such sizes."""
    (x, y), angles = offset, np.linspace(-2.0, 2.0, 400)

    def drive(x: float, y: float) -> np.ndarray:
        known = KnownMap([polygon + np.array([x, y]) for polygon in (BOUNDS, PARTITION)])
        own, numbers = OWN._replace(x=x - 3.0, y=y, goal_x=x + 3.0, goal_y=y), []
        driver.reset()
        for step in range(12):
            own = known.with_route(own)
            person = Detection(x - 1.0, y + 1.0 - 0.2 * step, 0.0, -0.8)
            ranges = np.where(np.abs(angles) < 0.3, 2.5 - 0.2 * step, np.inf)
            seen = walls_of_scan(ranges, angles, own, 8.0)
            command = driver.step(own, [person], 0.25 * step, walls=known, obstacles=seen)
            numbers.append([*command.action, command.heading, command.speed, command.shielded])
            numbers[-1] += [own.next_x - x, own.next_y - y]
            heading = command.heading
            vx, vy = command.speed * math.cos(heading), command.speed * math.sin(heading)
            own = own._replace(x=own.x + 0.25 * vx, y=own.y + 0.25 * vy, heading=heading)
            own = own._replace(velocity_x=vx, velocity_y=vy, next_x=None, next_y=None)
        return np.array(numbers)

    expected = drive(0.0, 0.0)
    assert 0 < expected[:, -3].sum() < 12  # shielded here and there
    np.testing.assert_allclose(drive(x, y), expected, atol=1e-4)
