"""Places with walls: every case is feasible, routes are shortest, and nobody passes a wall."""

import heapq
from itertools import pairwise

import numpy as np
import pytest
import shapely

from mrsan import Layout, Outcome, Scenario, World
from mrsan.kernels.tally import DEADLOCKS
from mrsan.kernels.walls import CLEARANCE, CORNERS, REDRAWS, WALLS
from mrsan.place import FAMILIES
from mrsan.place_shapes import polygons_of, route_of
from mrsan.state import State

SLACK = 2e-3  # m, by which routes may undercut the clearance


def worlds_of(layout: Layout, number: int, **fields) -> World:
    usual = {"robots": 3, "humans": 4, "layout": layout, "nearest_walls": 8}
    world = World(Scenario(**(usual | fields)), number)
    world.reset(np.arange(number))
    return world


def lines_of(state: State, e: int) -> shapely.Geometry:
    count = int(state.place[e, WALLS])
    ends = state.walls[e, :4, :count].T.reshape(count, 2, 2).astype(float)
    return shapely.multilinestrings(shapely.linestrings(ends))


def floor_of(state: State, e: int) -> shapely.Polygon:
    """The free floor; the outline is the first polygon of every family."""
    outline, *others = polygons_of(state, e)
    solid = [shapely.Polygon(p) for p in others if len(p) > 2]
    return shapely.Polygon(outline).difference(shapely.union_all(solid))


def agents_of(state: State, e: int):
    """Number, start and goal of all agents; only valid after a reset."""
    people = state.human_radius.shape[1]
    for j in np.flatnonzero(state.human_present[e]):
        yield j, state.human_position[e, j], state.human_goal[e, j]
    for i in range(state.arrived.shape[1]):
        yield people + i, state.robot_position[e, i], state.robot_goal[e, i]


@pytest.mark.parametrize("layout", FAMILIES)
def test_every_case_is_feasible(layout: Layout) -> None:
    """The route itself is the certificate: it is on the floor and keeps the clearance."""
    number = 150
    state = worlds_of(layout, number).state
    assert state.place[:, REDRAWS].mean() < 1.0
    for e in range(number):
        lines, clearance = lines_of(state, e), state.place[e, CLEARANCE] - SLACK
        floor = floor_of(state, e)
        assert clearance + SLACK == pytest.approx(0.4)
        for agent, start, goal in agents_of(state, e):
            route = shapely.LineString(route_of(state, e, agent, start, goal))
            assert floor.contains(route)
            assert route.distance(lines) >= clearance


def test_parked_robots_leave_the_others_a_way() -> None:
    """Also if all others have parked, the free space for a robot joins its start to its goal."""
    radius = 0.3
    for layout in (Layout.corner, Layout.rooms):
        state = worlds_of(layout, 100, robots=4).state
        for e in range(100):
            floor = floor_of(state, e).difference(lines_of(state, e).buffer(radius))
            starts, goals = (
                [shapely.Point(point) for point in points[e]]
                for points in (state.robot_position, state.robot_goal)
            )
            for i, (start, goal) in enumerate(zip(starts, goals, strict=True)):
                parked = [g.buffer(2 * radius) for k, g in enumerate(goals) if k != i]
                free = floor.difference(shapely.union_all(parked))
                parts = shapely.get_parts(free)
                assert any(part.contains(start) and part.contains(goal) for part in parts)


@pytest.mark.parametrize("layout", [Layout.doorway, Layout.rooms, Layout.pillars])
def test_routes_are_the_shortest_in_the_graph(layout: Layout) -> None:
    """Dijkstra's algorithm in plain Python, with shapely to decide where a disc can move."""
    state = worlds_of(layout, 5).state
    for e in range(5):
        lines, clearance = lines_of(state, e), float(state.place[e, CLEARANCE]) - 1e-3
        corners = state.corners[e, :2, : int(state.place[e, CORNERS])].T.astype(float)
        for agent, start, goal in agents_of(state, e):
            nodes = np.array([start, goal, *corners], float)
            pairs = shapely.linestrings(
                np.stack(np.broadcast_arrays(nodes[:, None], nodes[None]), -2)
            )
            free = shapely.distance(pairs, lines) >= clearance
            length = np.linalg.norm(nodes[:, None] - nodes[None], axis=-1)
            expected = dijkstra(np.where(free, length, np.inf))
            route = route_of(state, e, agent, start, goal)
            route_length = sum(np.linalg.norm(b - a) for a, b in pairwise(route))
            assert route_length == pytest.approx(expected, abs=0.01)


def dijkstra(length: np.ndarray) -> float:
    """The length of the shortest way from node 0 to node 1; inf if there is none."""
    best, queue = {}, [(0.0, 0)]
    while queue:
        reached, node = heapq.heappop(queue)
        if node in best:
            continue
        best[node] = reached
        for other in np.flatnonzero(np.isfinite(length[node])):
            heapq.heappush(queue, (reached + length[node, other], int(other)))
    return best.get(1, np.inf)


@pytest.mark.parametrize("crowd", ["orca", "social_force"])
@pytest.mark.parametrize("layout", [*FAMILIES])
def test_nobody_walks_through_a_wall(layout: Layout, crowd: str) -> None:
    number, steps = 32, 200
    world = worlds_of(
        layout,
        number,
        crowd=crowd,
        humans=6,
        robots=1,
        terminate_on_collision=False,
        pair_probability=0.2,
    )
    state = world.state
    idle = np.zeros((number, 1, 3), np.float32)
    lines = [lines_of(state, e) for e in range(number)]
    floors = [floor_of(state, e) for e in range(number)]
    for step in range(steps):
        world.step(idle)
        if step % 10 == 0:
            for e in range(number):
                points = shapely.points(state.human_position[e].astype(float))
                assert (shapely.distance(points, lines[e]) > state.human_radius[e] - 0.01).all()
                assert shapely.contains(floors[e], points).all()


def test_contacts_with_walls_are_those_of_shapely() -> None:
    """On the whole way of a step; robots drive at random for as long as their episodes last."""
    world = worlds_of(Layout.rooms, 100, humans=0)
    state, rng = world.state, np.random.default_rng(0)
    lines, hits = [lines_of(state, e) for e in range(100)], 0
    for _ in range(40):
        running, before = ~state.done, state.robot_position.astype(float)
        step = world.step(rng.uniform(-1, 1, (100, 3, 3)).astype(np.float32))
        for e in np.flatnonzero(running):
            ways = shapely.linestrings(np.stack([before[e], state.robot_position[e]], 1))
            gap = shapely.distance(ways, lines[e])
            certain = np.abs(gap - 0.3) > 1e-4
            touches = state.collision[e] == Outcome.hit_wall
            others = state.collision[e] == Outcome.hit_robot  # takes precedence
            assert ((touches == (gap < 0.3)) | ~certain | others).all()
            hits += touches.any()
        assert (step.terminated | ~(state.collision > 0).any(1)).all()
    assert hits > 50


def test_progress_adds_up_to_what_the_route_has_become_shorter() -> None:
    world = worlds_of(Layout.doorway, 50, humans=0, robots=1)
    state, total = world.state, np.zeros(50)
    start = state.route_length[:, 0].copy()
    rng = np.random.default_rng(1)
    for _ in range(25):
        running = ~state.done
        step = world.step(rng.uniform(-0.5, 1, (50, 1, 3)).astype(np.float32))
        total[running] += step.reward_parts.progress[running, 0] / 2.0
    expected = start - state.route_left[:, 0]
    driving = ~state.done
    assert driving.sum() > 10
    np.testing.assert_allclose(total[driving], expected[driving], atol=1e-3)


def test_walls_occlude_people_and_robots() -> None:
    world = worlds_of(Layout.rooms, 200, humans=6, robots=3)
    state, observation = world.state, world.observe()
    hidden = 0
    for e in range(200):
        lines = lines_of(state, e)
        for i in range(3):
            here = state.robot_position[e, i].astype(float)
            for j in range(6):
                sight = shapely.LineString([here, state.human_position[e, j]])
                blocked = sight.intersects(lines)
                near = sight.length < world.scenario.sensing_range
                hidden += blocked
                assert observation.humans_visible[e, i, j] == (near and not blocked)
    assert hidden > 100
    assert world.observe(privileged=True).humans_visible.all()


def test_the_lidar_measures_what_shapely_measures() -> None:
    world = worlds_of(
        Layout.rooms, 20, lidar_rays=36, lidar_noise=0.0, lidar_noise_share=0.0, lidar_dropout=0.0
    )
    state, ranges = world.state, world.observe().sensors["lidar"]
    for e in range(20):
        lines = lines_of(state, e)
        for i in range(3):
            here, heading = state.robot_position[e, i].astype(float), state.robot_heading[e, i]
            for ray in range(36):
                angle = heading - np.pi + 2 * np.pi * ray / 36
                end = here + 10.0 * np.array([np.cos(angle), np.sin(angle)])
                hit = shapely.LineString([here, end]).intersection(lines)
                expected = 10.0 if hit.is_empty else hit.distance(shapely.Point(here))
                assert ranges[e, i, ray] == pytest.approx(expected, abs=2e-3)


def test_lidar_noise_has_the_requested_size() -> None:
    fields = {"lidar_rays": 72, "lidar_noise": 0.02, "lidar_noise_share": 0.0}
    noisy = worlds_of(Layout.doorway, 100, **fields, lidar_dropout=0.1)
    exact = worlds_of(Layout.doorway, 100, **(fields | {"lidar_noise": 0.0}), lidar_dropout=0.0)
    measured, true = noisy.observe().sensors["lidar"], exact.observe().sensors["lidar"]
    within = true < 9.9
    lost = within & (measured == 10.0)
    assert lost.sum() / within.sum() == pytest.approx(0.1, abs=0.01)
    assert (measured - true)[within & ~lost].std() == pytest.approx(0.02, rel=0.05)
    np.testing.assert_array_equal(noisy.observe().sensors["lidar"], measured)


def test_a_lidar_may_see_agents() -> None:
    fields = {"lidar_rays": 180, "lidar_noise": 0.0, "lidar_noise_share": 0.0, "lidar_dropout": 0.0}
    walls = worlds_of(Layout.doorway, 50, **fields).observe().sensors["lidar"]
    everything = worlds_of(Layout.doorway, 50, **fields, lidar_targets="all")
    ranges = everything.observe().sensors["lidar"]
    assert (ranges <= walls).all()
    nearest = np.inf
    for e in range(50):
        gaps = np.linalg.norm(
            everything.state.human_position[e] - everything.state.robot_position[e, 0], axis=-1
        )
        nearest = min(nearest, gaps.min())
        if gaps.min() < 3.0:
            assert ranges[e, 0].min() <= gaps.min() - 0.3 + 0.02
    assert nearest < 3.0


def test_the_nearest_walls_come_first() -> None:
    world = worlds_of(Layout.pillars, 20, nearest_walls=6)
    segments, mask = world.observe().entities["walls"]
    assert mask.all()
    ends = segments.reshape(20, 3, 6, 2, 2).astype(float)
    distance = shapely.distance(shapely.linestrings(ends), shapely.Point(0, 0))
    assert (np.diff(distance, axis=-1) > -1e-3).all()
    for e in range(20):
        expected = shapely.Point(world.state.robot_position[e, 0]).distance(
            lines_of(world.state, e)
        )
        assert distance[e, 0, 0] == pytest.approx(expected, abs=1e-3)


def test_the_route_leads_round_the_wall_or_is_the_bare_goal() -> None:
    known = worlds_of(Layout.doorway, 50)
    route, goal = known.observe().sensors["route"], known.observe().ego[..., :2]
    behind = np.linalg.norm(route, axis=-1) < np.linalg.norm(goal, axis=-1) - 1e-3
    assert behind.mean() > 0.5
    unknown = worlds_of(Layout.doorway, 50, map_known=False)
    np.testing.assert_allclose(unknown.observe().sensors["route"], goal, atol=1e-5)


def test_a_case_does_not_depend_on_the_other_worlds() -> None:
    scenario = Scenario(layout=Layout.places, humans=4, nearest_walls=8, lidar_rays=12)
    together, alone = World(scenario, 12), World(scenario, 1)
    together.reset(np.arange(12))
    action = np.random.default_rng(0).uniform(-1, 1, (30, 12, 3, 3)).astype(np.float32)
    for one in action:
        seen = together.step(one).observation
    for case in (0, 7):
        alone.reset(np.array([case]))
        for one in action:
            expected = alone.step(one[case : case + 1]).observation
        for name, array in expected.arrays().items():
            np.testing.assert_array_equal(array[0], seen.arrays()[name][case])


def test_a_deadlock_is_a_standstill_of_ten_seconds() -> None:
    """Robots that stand for 9.75 s are not in a deadlock, those that stand for 10 s are."""
    world = worlds_of(Layout.doorway, 1, humans=0)
    for _ in range(39):
        world.step(np.zeros((1, 3, 3), np.float32))
    assert not world.state.tally[0, :, DEADLOCKS].any()
    world.step(np.zeros((1, 3, 3), np.float32))
    assert (world.state.tally[0, :, DEADLOCKS] == 1).all()
