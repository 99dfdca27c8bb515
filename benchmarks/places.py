"""Check places with walls on many cases: `python -m benchmarks.places`.

Shapely, an independent library, certifies that every case is feasible: the shortest route of every
robot and person lies on the floor and keeps its clearance from all walls, and robots that have
parked at their goals do not cut off the others. Then people walk, and no person may overlap a wall
or pass through one, or stand for 10 s.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

import numba
import numpy as np
import shapely

from benchmarks.workload import add_output, interruptible, positive_whole_number, provenance
from mrsan import Crowd, Layout, Scenario, World
from mrsan.kernels.walls import CLEARANCE, REDRAWS, sees, wall_count, wall_distance
from mrsan.place import FAMILIES
from mrsan.place_shapes import polygons_of, route_of
from mrsan.state import State
from samarl.evaluation.table import markdown_table
from samarl.files import write_json
from samarl.progress import progress_bar

HUMANS, ROBOTS, WORLDS = 8, 3, 512
FEWER_HUMANS = {Layout.corner: 4}  # where more have no room
SLACK = 2e-3  # m, for rounding
STANDS = 0.05  # m/s
LONGEST_STAND = 10.0  # s


def main() -> None:
    """Check all families, print the table and write the JSON file."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument(
        "--cases", type=positive_whole_number, default=10_000, help="of each family"
    )
    parser.add_argument(
        "--person-steps", type=positive_whole_number, default=10_000_000, help="in each family"
    )
    add_output(parser, "places")
    arguments = parser.parse_args()
    rows = []
    with interruptible():
        for layout in FAMILIES:
            rows.append(
                {"place": layout.name}
                | certify(layout, arguments.cases)
                | walk(layout, arguments.person_steps)
                | {
                    f"standing_cases_percent_{crowd}": standing_cases(layout, crowd)
                    for crowd in (Crowd.orca, Crowd.social_force)
                }
            )
    print(_table(rows))
    output: Path = arguments.output
    write_json(output, {"places": rows, **provenance("places")})
    print(f"\nwritten to {output}")


def scenario_of(layout: Layout, **fields: Any) -> Scenario:
    """Return the scenario of a family that is checked."""
    humans = FEWER_HUMANS.get(layout, HUMANS)
    return Scenario(layout=layout, humans=humans, robots=ROBOTS, **fields)


def certify(layout: Layout, cases: int) -> dict[str, Any]:
    """Return how many cases are feasible, and how many starts and goals were drawn again."""
    world = World(scenario_of(layout), min(cases, WORLDS))
    feasible, redraws, shortest = 0, 0.0, np.inf
    with progress_bar(total=cases, desc=f"{layout.name}: cases") as bar:
        for first in range(0, cases, world.worlds):
            world.reset(first + np.arange(world.worlds))
            number = min(world.worlds, cases - first)
            redraws += float(world.state.place[:number, REDRAWS].sum())
            for e in range(number):
                clearance = _least_clearance(world.state, e)
                feasible += clearance >= float(world.state.place[e, CLEARANCE]) - SLACK
                shortest = min(shortest, clearance)
            bar.update(number)
    return {
        "cases": cases,
        "feasible": feasible,
        "least_clearance": round(shortest, 4),
        "redraws_per_case": round(redraws / cases, 4),
    }


def _least_clearance(state: State, e: int) -> float:
    """Return the smallest distance of a route of a case to a wall, m; -1 off the floor."""
    polygons = polygons_of(state, e)
    floor = shapely.Polygon(polygons[0])
    solid = [shapely.Polygon(p) for p in polygons[1:] if len(p) > 2]
    lines = shapely.union_all(
        [shapely.LinearRing(p) if len(p) > 2 else shapely.LineString(p) for p in polygons]
    )
    people = state.human_radius.shape[1]
    routes = [
        route_of(state, e, int(j), state.human_position[e, j], state.human_goal[e, j])
        for j in np.flatnonzero(state.human_present[e])
    ]
    routes += [
        route_of(state, e, people + i, state.robot_position[e, i], state.robot_goal[e, i])
        for i in range(ROBOTS)
    ]
    together = shapely.MultiLineString(routes)
    if not floor.contains(together) or any(polygon.intersects(together) for polygon in solid):
        return -1.0
    return float(together.distance(lines))


def walk(layout: Layout, person_steps: int) -> dict[str, Any]:
    """Return how many people overlapped a wall or passed one."""
    scenario = scenario_of(layout, terminate_on_collision=False)
    world = World(scenario, WORLDS, auto_reset=True)
    world.reset(np.arange(WORLDS))
    state, actions = world.state, np.zeros((WORLDS, ROBOTS, scenario.action_size), np.float32)
    overlaps = passages = done = 0
    with progress_bar(total=person_steps, desc=f"{layout.name}: person-steps") as bar:
        while done < person_steps:
            before, episode = state.human_position.copy(), state.episode.copy()
            world.step(actions)
            same = state.episode == episode
            overlap, passage = _faults(
                state.walls, state.place, before, state.human_position, state.human_radius, same
            )
            overlaps, passages = overlaps + overlap, passages + passage
            done += WORLDS * scenario.humans
            bar.update(WORLDS * scenario.humans)
    return {"person_steps": done, "overlaps": overlaps, "passages": passages}


def standing_cases(layout: Layout, crowd: Crowd, cases: int = WORLDS) -> float:
    """Return the share of cases in which somebody stands for 10 s, in %.

    The robots do not move, and people do not perceive them: they only get in each other's way.
    """
    scenario = scenario_of(layout, crowd=crowd, terminate_on_collision=False)
    world = World(scenario, cases)
    world.reset(np.arange(cases))
    state, actions = world.state, np.zeros((cases, ROBOTS, scenario.action_size), np.float32)
    standing = np.zeros(state.human_present.shape, np.int32)
    longest = np.zeros_like(standing)
    for _ in range(scenario.time_limit_steps):
        world.step(actions)
        slow = np.linalg.norm(state.human_velocity, axis=-1) < STANDS
        standing = np.where(slow & state.human_present, standing + 1, 0)
        longest = np.maximum(longest, standing)
    stood = (longest >= round(LONGEST_STAND / scenario.time_step)).any(1)
    return round(100 * float(stood.mean()), 2)


@numba.njit(error_model="numpy")
def _faults(walls, place, before, after, radius, same):  # type: ignore[no-untyped-def]
    """Return how many people overlap a wall, and how many passed one in the last step."""
    overlaps = passages = 0
    for e in range(after.shape[0]):
        count = wall_count(place[e])
        for j in range(after.shape[1]):
            x, y = after[e, j, 0], after[e, j, 1]
            overlaps += wall_distance(walls[e], count, x, y) < radius[e, j] - SLACK
            if same[e]:
                dx, dy = before[e, j, 0] - x, before[e, j, 1] - y
                passages += not sees(walls[e], count, x, y, dx, dy)
    return overlaps, passages


def _table(rows: list[dict[str, Any]]) -> str:
    headings = (
        "place",
        "feasible / cases",
        "least clearance m",
        "redraws per case",
        "person-steps",
        "overlaps",
        "passages",
        "cases with somebody standing 10 s, %: ORCA",
        "social force",
    )
    cells = [
        [
            row["place"],
            f"{row['feasible']} / {row['cases']}",
            f"{row['least_clearance']:.3f}",
            f"{row['redraws_per_case']:.3f}",
            f"{row['person_steps']:,}",
            str(row["overlaps"]),
            str(row["passages"]),
            f"{row['standing_cases_percent_orca']:.1f}",
            f"{row['standing_cases_percent_social_force']:.1f}",
        ]
        for row in rows
    ]
    return markdown_table(headings, cells)


if __name__ == "__main__":
    main()
