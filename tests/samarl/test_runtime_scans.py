"""Scans as drivers of lidars publish them: nothing that was measured is taken for free space."""

import copy
import math
import pickle
from array import array
from typing import Any

import numpy as np
import pytest

from mrsan import Observation
from samarl.planning.shield import Shield
from samarl.runtime import (
    Command,
    Detection,
    Driver,
    InputError,
    OwnState,
    ShieldReason,
    walls_of_scan,
)
from samarl.runtime.scan_memory import ScanMemory
from tests.driving import driver_without_walls

OWN = OwnState(0.0, 0.0, 0.0, 0.0, 0.0, 4.0, 0.0)
INF, NAN = math.inf, math.nan
CIRCLE = np.linspace(-math.pi, math.pi, 360, endpoint=False)


def distances(points: np.ndarray, walls: np.ndarray) -> np.ndarray:
    """From points [P, 2] to the nearest of segments [K, 4]."""
    starts, along = walls[:, :2], walls[:, 2:] - walls[:, :2]
    away = points[:, None] - starts
    share = (away * along).sum(-1) / np.maximum((along**2).sum(-1), 1e-12)
    nearest: np.ndarray = np.linalg.norm(
        away - np.clip(share, 0.0, 1.0)[..., None] * along, axis=-1
    ).min(1)
    return nearest


def test_no_return_is_lost() -> None:
    random = np.random.default_rng(0)
    own = OwnState(3.0, -2.0, 0.8, 0.0, 0.0, 9.0, 0.0)
    for number in (1, 2, 3, 16, 17, 90, 360, 720) * 6:
        view = random.choice([math.pi, 1.5 * math.pi, 2.0 * math.pi])
        angles = np.linspace(-view / 2, view / 2, number)
        angles = random.permutation(angles) if random.random() < 0.3 else angles[::-1]
        smooth = 2.0 + np.sin(3.0 * angles) + random.normal(0.0, 0.02, number)
        ranges = np.where(random.random(number) < 0.3, random.uniform(0.12, 8.0, number), smooth)
        no_return = random.random(number) < random.choice([0.0, 0.2, 0.7])
        ranges[no_return] = random.choice([INF, NAN, 0.0, -1.0, 8.0, 65.535])
        walls = walls_of_scan(ranges, angles, own, 8.0, 0.12)
        assert len(walls) <= number
        hit = ~no_return
        if not hit.any():
            assert len(walls) == 0
            continue
        turned = angles[hit] + own.heading
        rays = np.stack([np.cos(turned), np.sin(turned)], -1)
        points = rays * ranges[hit, None] + (own.x, own.y)
        assert distances(points, walls).max() < 0.1001
        nearest = distances(np.array([[own.x, own.y]]), walls)[0]
        assert 0.9 * ranges[hit].min() < nearest < ranges[hit].min() + 0.0011


def test_conventions_of_drivers() -> None:
    for value in (INF, NAN, 0.0, -0.0, -1.0, 3.5, np.float32(3.5), 4.5, 65.535):
        assert walls_of_scan([value], [0.0], OWN, 3.5, 0.12).shape == (0, 4), value
    for value in (0.12, np.float32(0.12), 0.5, 3.49):  # at the least range it can still measure
        wall = walls_of_scan([value], [0.0], OWN, 3.5, 0.12)
        assert wall.tolist() == [pytest.approx([float(value), 0.0] * 2)], value
    for value in (-INF, 0.05):  # something is nearer than it can measure
        wall = walls_of_scan([value], [0.0], OWN, 3.5, 0.12)
        assert distances(np.zeros((1, 2)), wall)[0] < 0.02, value


def test_the_order_and_the_type_of_numbers_do_not_matter() -> None:
    ranges = np.where(np.abs(CIRCLE) < 1.0, 2.0, 3.0 + np.round(np.sin(5 * CIRCLE), 2))
    ranges[40:90] = INF

    def walls(ranges: Any, angles: Any) -> np.ndarray:
        segments = np.asarray(walls_of_scan(ranges, angles, OWN, 3.9))
        return segments[np.lexsort(segments.round(5).T)]

    expected = walls(ranges, CIRCLE)
    shuffled = np.random.default_rng(1).permutation(360)
    for order in (slice(None, None, -1), shuffled):
        np.testing.assert_allclose(walls(ranges[order], CIRCLE[order]), expected, atol=1e-6)
    turned = np.roll(CIRCLE, 180) % (2 * math.pi)
    np.testing.assert_allclose(walls(np.roll(ranges, 180), turned), expected, atol=1e-6)
    for kind in (list, tuple, np.float32, partial_array):
        np.testing.assert_allclose(walls(kind(ranges), kind(CIRCLE)), expected, atol=1e-5)
    np.testing.assert_allclose(walls([2, 2], [0, 1]), walls([2.0, 2.0], [0.0, 1.0]))


def partial_array(values: np.ndarray) -> array:
    """As `rclpy` gives the fields of a message."""
    return array("f", values.tolist())


def test_a_scan_that_cannot_be_used_is_named() -> None:
    cases: list[tuple[Any, Any, str]] = [
        (np.ones(360), 0.0, "360.*angles"),
        (np.ones(4), None, "None.*4|4.*None"),
        (["1.0"], [0.0], "length 1.*angles"),
        (np.ma.masked_invalid([1.0, NAN]), np.zeros(2), "MaskedArray of length 2.*masks"),
        (1000 + np.arange(360), CIRCLE, "ranges has 360 .*1359.*metres"),
        (np.ones(2), [0.0, 90.0], r"angles\[1\] is 90.*radians"),
    ]
    for ranges, angles, words in cases:
        with pytest.raises(InputError, match=f"^.*({words})") as error:
            walls_of_scan(ranges, angles, OWN, 8.0)
        assert "\n" not in str(error.value)
    with pytest.raises(InputError, match=r"^largest_range "):
        walls_of_scan([1.0], [0.0], OWN, 1.0, 1.0)
    for size in (0.0, -0.1, NAN, "thin"):
        with pytest.raises(InputError, match=r"^smallest_obstacle "):
            walls_of_scan([1.0], [0.0], OWN, 8.0, smallest_obstacle=size)  # type: ignore[arg-type]


@pytest.fixture(scope="module")
def loaded(tmp_path_factory: pytest.TempPathFactory) -> Driver:
    return driver_without_walls(tmp_path_factory.mktemp("scans"), Shield(track_time=2.0))


@pytest.fixture
def driver(loaded: Driver, monkeypatch: pytest.MonkeyPatch) -> Driver:
    """A policy that drives straight to its goal at full speed, whatever it sees, and a shield."""

    def head_on(tracks: Observation, target: np.ndarray) -> np.ndarray:
        turn = math.atan2(target[0, 0, 1], target[0, 0, 0]) / loaded.scenario.max_turn
        return np.array([[[1.0, 0.0, np.clip(turn, -1.0, 1.0)]]], np.float32)

    monkeypatch.setattr(loaded._network, "action", head_on)
    loaded.reset()
    return loaded


def hits(own: OwnState, angles: np.ndarray, walls: np.ndarray, poles: np.ndarray) -> np.ndarray:
    """The ranges of rays to walls [K, 4] and poles [P, 3] (x, y, radius); inf beyond 8 m."""
    dx, dy = np.cos(angles + own.heading)[:, None], np.sin(angles + own.heading)[:, None]
    ax, ay, bx, by = (walls - np.array([own.x, own.y] * 2)).T
    with np.errstate(divide="ignore", invalid="ignore"):
        across = dx * (by - ay) - dy * (bx - ax)
        to_wall = (ax * (by - ay) - ay * (bx - ax)) / across
        share = (ax * dy - ay * dx) / across
        to_wall = np.where((to_wall > 0) & (share >= 0) & (share <= 1), to_wall, INF)
        px, py, radius = (poles - np.array([own.x, own.y, 0.0])).T
        along = dx * px + dy * py
        to_pole = along - np.sqrt(radius**2 - (dx * py - dy * px) ** 2)
        to_pole = np.where((along > 0) & np.isfinite(to_pole), to_pole, INF)
    ranges = np.hstack([to_wall, to_pole]).min(1, initial=INF)
    return np.where(ranges < 8.0, ranges, INF)


NOTHING = np.zeros((0, 4)), np.zeros((0, 3))
SCENES = {
    "wall": (np.array([[1.6, -3.0, 1.6, 3.0]]), NOTHING[1]),
    "slanted wall": (np.array([[1.0, -3.0, 2.4, 3.0]]), NOTHING[1]),
    "end of a wall": (np.array([[1.6, -0.02, 1.6, 3.0]]), NOTHING[1]),
    "needle": (NOTHING[0], np.array([[1.6, 0.0, 0.01]])),
    "pole": (NOTHING[0], np.array([[1.6, 0.0, 0.05]])),
    "two poles": (NOTHING[0], np.array([[1.6, 0.0, 0.05], [1.8, 0.35, 0.03]])),
}


def moved(own: OwnState, command: Command) -> tuple[OwnState, list[tuple[float, float]]]:
    """The robot after 0.25 s, and places on its way there."""
    vx = command.speed * math.cos(command.heading)
    vy = command.speed * math.sin(command.heading)
    dx, dy = 0.125 * (own.velocity_x + vx), 0.125 * (own.velocity_y + vy)
    way = [(own.x + share * dx, own.y + share * dy) for share in (0.25, 0.5, 0.75, 1.0)]
    (x, y), heading = way[-1], command.heading
    return own._replace(x=x, y=y, heading=heading, velocity_x=vx, velocity_y=vy), way


@pytest.mark.parametrize("rays", [16, 40, 180, 720])
def test_what_was_seen_is_kept_clear_of(driver: Driver, rays: int) -> None:
    """Drive at full speed at what one ray hits at first; later it may be between two rays."""
    step_angle = 2.0 * math.pi / rays
    for name, (walls, poles) in SCENES.items():
        for offset in (0.0, 0.3, 0.6):  # of the rays to the way to the goal, in steps of rays
            driver.reset()
            own = OWN._replace(heading=-offset * step_angle)
            angles = (np.arange(rays) - rays // 2 + offset) * step_angle
            for step in range(16):
                seen = walls_of_scan(hits(own, angles, walls, poles), angles, own, 8.0)
                own, way = moved(own, driver.step(own, [], 0.25 * step, walls=seen))
                gaps = [math.hypot(x - px, y - py) - r for x, y in way for px, py, r in poles]
                gaps += distances(np.array(way), walls).tolist() if len(walls) else []
                assert min(gaps) >= driver.scenario.robot_radius, (name, offset, step)


@pytest.mark.parametrize(
    ("rays", "start", "scene"), [(16, 1.0, "pole"), (64, 0.0, "needle"), (180, 1.0, "needle")]
)
def test_what_stands_between_two_rays_is_kept_clear_of(
    driver: Driver, rays: int, start: float, scene: str
) -> None:
    """No ray hits the pole straight ahead until the robot drives slowly or looks round."""
    walls, poles = SCENES[scene]
    own, reasons = OWN._replace(velocity_x=start), set()
    angles = (np.arange(rays) - rays // 2 + 0.5) * 2.0 * math.pi / rays
    for step in range(100):
        seen = walls_of_scan(hits(own, angles, walls, poles), angles, own, 8.0)
        command = driver.step(own, [], 0.25 * step, walls=seen)
        reasons.add(command.reason)
        own, way = moved(own, command)
        gaps = [math.hypot(x - px, y - py) - r for x, y in way for px, py, r in poles]
        assert min(gaps) >= driver.scenario.robot_radius, step
        if own.x > 2.0:
            break
    assert own.x > 0.6  # it did not just stand
    assert ShieldReason.unseen in reasons


def test_what_has_left_is_no_longer_in_the_way(driver: Driver) -> None:
    """A pole right in front while the robot looks round, which is then taken away."""
    angles = (np.arange(40) - 20 + 0.3) * 2.0 * math.pi / 40
    own, poles = OWN, np.array([[0.7, 0.0, 0.2]])
    for step in range(160):
        if step == 40:
            assert own.x < 0.25
            poles = poles[:0]
        seen = walls_of_scan(hits(own, angles, NOTHING[0], poles), angles, own, 8.0)
        own, _ = moved(own, driver.step(own, [], 0.25 * step, walls=seen))
    assert own.x > 1.5


def arrival_time(driver: Driver, rays: int, smallest_obstacle: float) -> float:
    """Of a robot in empty space with its goal 4 m ahead, s."""
    angles = (np.arange(rays) - rays // 2 + 0.3) * 2.0 * math.pi / rays
    own, radius = OWN, driver.scenario.robot_radius
    for step in range(240):
        if math.hypot(own.goal_x - own.x, own.goal_y - own.y) < radius:
            return 0.25 * step
        nothing = walls_of_scan(np.full(rays, INF), angles, own, 8.0, 0.1, smallest_obstacle)
        own, _ = moved(own, driver.step(own, [], 0.25 * step, walls=nothing))
    return INF


def test_fewer_rays_and_thinner_obstacles_take_longer(driver: Driver) -> None:
    full_speed = 4.0
    for rays, smallest_obstacle, shortest, longest in (
        (360, 0.02, full_speed, full_speed),
        (40, 0.2, full_speed, full_speed),
        (180, 0.02, 5.0, 10.0),
        (40, 0.1, 5.0, 10.0),
        (16, 0.02, 30.0, 45.0),
    ):
        driver.reset()
        time = arrival_time(driver, rays, smallest_obstacle)
        assert shortest <= time <= longest, (rays, smallest_obstacle)


def test_what_is_too_close_stops_the_robot_and_no_return_does_not(driver: Driver) -> None:
    own = OWN._replace(velocity_x=0.8)
    stops, drives = ((-INF, 0.0), (0.05, 0.0)), ((0.0, 1.0), (NAN, 1.0), (INF, 1.0), (-1.0, 1.0))
    for value, speed in (*stops, *drives):
        for angles in (CIRCLE, CIRCLE[170:190]):
            driver.reset()
            for step in range(3):
                walls = walls_of_scan(np.full(len(angles), value), angles, own, 3.5, 0.12)
                command = driver.step(own, [], 0.25 * step, walls=walls)
            assert command.speed == pytest.approx(speed, abs=1e-6), value
            assert command.shielded == (speed == 0.0)


def test_a_place_is_remembered_until_a_ray_passes_it() -> None:
    def update(memory: ScanMemory, ranges: list[float], time: float, *agents: Detection) -> list:
        walls = walls_of_scan(ranges, [-0.1, 0.0, 0.1], OWN, 8.0)
        return memory.update([walls.scan], agents, time).tolist()

    memory = ScanMemory()
    assert update(memory, [INF, 2.0, INF], 0.0) == []
    assert update(memory, [INF, 2.0, INF], 0.25) == []  # it is seen again
    shorter = [INF, 1.0, INF]  # something in front hides it
    assert update(memory, shorter, 0.5) == [[2.0, 0.0]]
    aside = walls_of_scan([INF, INF], [-0.05, 0.05], OWN, 8.0)
    assert memory.update([aside.scan], [], 0.75).tolist() == [[1.0, 0.0], [2.0, 0.0]]
    assert memory.update([], [], 1.0).tolist() == [[1.0, 0.0], [2.0, 0.0]]  # a scan is missing
    assert update(memory, [INF, 1.5, INF], 1.25) == [[2.0, 0.0]]  # the ray passed the nearer one
    assert memory.update([aside.scan], [], 40.0).tolist() == []  # half a minute later
    person = Detection(2.2, 0.0, 0.0, 0.0)
    assert update(memory, [INF, 2.0, INF], 41.0, person) == []
    assert memory.update([aside.scan], [], 41.25).tolist() == []  # it was the person's


def test_a_driver_that_remembers_scans_continues_identically_from_a_pickle(
    loaded: Driver,
) -> None:
    """As does a scan that another process sends."""
    loaded.reset()
    own = OWN._replace(velocity_x=0.5)
    angles = np.linspace(-math.pi, math.pi, 16, endpoint=False)
    walls = walls_of_scan(np.where(np.abs(angles) < 0.1, 0.8, INF), angles, own, 8.0)
    loaded.step(own, [], 0.0, walls=walls)
    twins = copy.deepcopy(loaded), pickle.loads(pickle.dumps(loaded))
    later = walls_of_scan(np.full(16, INF), angles + 0.1, own, 8.0)
    received = copy.deepcopy(later), pickle.loads(pickle.dumps(later))
    expected = loaded.step(own, [], 0.25, walls=later)
    assert expected.shielded
    for twin, copied in zip(twins, received, strict=True):
        command = twin.step(own, [], 0.25, walls=copied)
        assert (command.action == expected.action).all()
        assert command.reason is expected.reason


def test_why_the_shield_replaced_an_action(driver: Driver) -> None:
    own = OWN._replace(velocity_x=1.0)
    front = [(0.75 * math.cos(a), 0.75 * math.sin(a)) for a in (-0.9, 0.0, 0.9)]
    people = [Detection(x, y, 0.0, 0.0) for x, y in front]
    wall = [[0.5, -2.0, 0.5, 2.0]]
    team = [Detection(0.75, 0.0, 0.0, 0.0, robot=True)]
    aside = [Detection(0.0, 3.0, 0.0, 0.0)]
    for seen, walls, reason in (
        (people, (), ShieldReason.person),
        (team, (), ShieldReason.robot),
        ([], wall, ShieldReason.wall),
        (aside, wall, ShieldReason.wall),  # the person is nothing to do with it
        (people, [[2.5, -2.0, 2.5, 2.0]], ShieldReason.person),
        (aside, (), None),
    ):
        driver.reset()
        command = driver.step(own, seen, 0.0, walls=walls)
        assert (command.shielded, command.reason) == (reason is not None, reason)
    driver.reset()
    driver.step(own._replace(x=-2.0), people, 0.0)
    assert driver.step(own, [], 0.25).reason == "stale data"  # nobody sees them now
    driver.reset()
    seen_before = walls_of_scan([0.5], [0.0], own, 8.0, smallest_obstacle=INF)
    driver.step(own, [], 0.0, walls=seen_before)
    between = walls_of_scan([INF, INF], [-0.2, 0.2], own, 8.0, smallest_obstacle=INF)
    assert driver.step(own, [], 0.25, walls=between).reason == "stale data"
    driver.reset()
    between = walls_of_scan([INF, INF], [-0.2, 0.2], own, 8.0)
    assert driver.step(own, [], 0.0, walls=between).reason == "unseen"
