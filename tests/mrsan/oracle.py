"""A slow twin of one step in plain Python and float64, written from the specification.

It shares no code with the kernels: ORCA takes the nearest point of each velocity obstacle and
then enumerates the corners of the linear programme; the sensor compares angles, not cosines.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from mrsan import Crowd, CrowdReaction, Kinematics, Scenario, State

PARALLEL = 1e-9


class Margin:
    """The smallest distance of anything compared to the threshold it was compared with.

    A case that float32 may decide differently has a tiny margin and proves nothing.
    """

    def __init__(self) -> None:
        self.smallest = math.inf

    def below(self, value: float, threshold: float) -> bool:
        if math.isfinite(value):
            self.smallest = min(self.smallest, abs(value - threshold))
        return value < threshold


@dataclass
class Outcome:
    """What the twin says of one world after one step."""

    human_position: np.ndarray
    human_velocity: np.ndarray
    robot_position: np.ndarray
    robot_velocity: np.ndarray
    robot_heading: np.ndarray
    arrived: np.ndarray
    collision: np.ndarray
    contact: np.ndarray  # [N] whom it touches in this step
    last_contact: np.ndarray
    reward: np.ndarray
    terminated: bool
    truncated: bool
    tally: dict[str, np.ndarray]  # what the step adds to the statistics of the episode
    margin: Margin = field(repr=False)


def snapshot(state: State, e: int = 0) -> dict[str, Any]:
    """World `e` as float64 copies, by field name."""
    rows = {name: getattr(state, name)[e] for name in state._fields}
    return {
        name: row.astype(np.float64) if row.dtype == np.float32 else row.copy()
        for name, row in rows.items()
    }


def wrap(angle: float) -> float:
    return math.remainder(angle, 2.0 * math.pi)


# ORCA (van den Berg et al., 2011)


def half_plane(
    p: np.ndarray, v: np.ndarray, radius: float, horizon: float, time_step: float
) -> tuple[np.ndarray, np.ndarray]:
    """The change `u` of the relative velocity `v` out of the obstacle, and its outward normal."""
    distance = float(np.hypot(*p))
    if distance <= radius:  # they overlap: a disc to be left within one step
        centre, r = p / time_step, radius / time_step
        normal = (v - centre) / np.hypot(*(v - centre))
        return centre + r * normal - v, normal
    centre, r = p / horizon, radius / horizon
    half_angle = math.asin(radius / distance)
    bearing = math.atan2(p[1], p[0])
    candidates = []
    outward = (v - centre) / np.hypot(*(v - centre))
    if math.acos(np.clip(-outward @ p / distance, -1, 1)) <= math.acos(radius / distance):
        candidates.append((centre + r * outward, outward))  # the arc that faces the agent
    for side in (1.0, -1.0):
        leg = bearing + side * half_angle
        along = np.array([math.cos(leg), math.sin(leg)])
        normal = side * np.array([-along[1], along[0]])
        tangent_point = math.sqrt(distance**2 - radius**2) / horizon
        candidates.append((along * max(float(v @ along), tangent_point), normal))
    nearest, normal = min(candidates, key=lambda point: np.hypot(*(point[0] - v)))
    return nearest - v, normal


def solve(
    points: np.ndarray, normals: np.ndarray, preferred: np.ndarray, max_speed: float
) -> np.ndarray:
    """The permitted velocity nearest to `preferred`, or else the least violation of the worst line.

    Args:
        points: [K, 2], one on each line.
        normals: [K, 2], unit vectors into the permitted side.
        preferred: [2].
        max_speed: radius of the disc of velocities.
    """
    speed = float(np.hypot(*preferred))
    corners = [preferred if speed <= max_speed else preferred / speed * max_speed]
    offsets = (points * normals).sum(1)
    for n, b in zip(normals, offsets, strict=True):
        corners.append(preferred + (b - n @ preferred) * n)
        corners += _on_circle(n, b, max_speed)
    for i, j in itertools.combinations(range(len(points)), 2):
        corners += _crossing(normals[i], offsets[i], normals[j], offsets[j])
    candidates = np.array(corners)
    inside = np.hypot(*candidates.T) <= max_speed + 1e-7
    permitted = inside & (candidates @ normals.T >= offsets - 1e-7).all(1)
    if permitted.any():
        candidates = candidates[permitted]
        return candidates[np.argmin(np.hypot(*(candidates - preferred).T))]
    # Violations are equal along the bisector of two lines; the optimum is a corner of bisectors
    # and the circle, or the point of the circle farthest into one line's permitted side.
    corners = list(normals * max_speed)
    bisectors = []
    for i, j in itertools.combinations(range(len(points)), 2):
        n, b = normals[i] - normals[j], offsets[i] - offsets[j]
        length = float(np.hypot(*n))
        if length > PARALLEL:
            bisectors.append((i, j, n / length, b / length))
    for _, _, n, b in bisectors:
        corners += _on_circle(n, b, max_speed)
    for (i, j, n, b), (k, m, o, c) in itertools.combinations(bisectors, 2):
        if i == k and j < m:  # the three bisectors of a triple share one point
            corners += _crossing(n, b, o, c)
    candidates = np.array(corners)
    candidates = candidates[np.hypot(*candidates.T) <= max_speed + 1e-7]
    return candidates[np.argmin((offsets - candidates @ normals.T).max(1))]


def _on_circle(n: np.ndarray, b: float, radius: float) -> list[np.ndarray]:
    if abs(b) > radius:
        return []
    half = math.sqrt(radius**2 - b**2) * np.array([-n[1], n[0]])
    return [b * n + half, b * n - half]


def _crossing(n: np.ndarray, b: float, o: np.ndarray, c: float) -> list[np.ndarray]:
    determinant = n[0] * o[1] - n[1] * o[0]
    if abs(determinant) <= PARALLEL:
        return []
    return [np.array([b * o[1] - c * n[1], c * n[0] - b * o[0]]) / determinant]


def orca(
    agents: np.ndarray,
    i: int,
    preferred: np.ndarray,
    max_speed: float,
    neighbor_distance: float,
    max_neighbors: int,
    horizon: float,
    time_step: float,
) -> np.ndarray:
    """New velocity of row `i` of `agents` [A, 5]: position, velocity, radius."""
    distance = np.hypot(*(agents[:, :2] - agents[i, :2]).T)
    distance[i] = math.inf
    near = [j for j in np.argsort(distance) if distance[j] < neighbor_distance][:max_neighbors]
    if not near:
        return solve(np.zeros((0, 2)), np.zeros((0, 2)), preferred, max_speed)
    planes = [
        half_plane(
            agents[j, :2] - agents[i, :2],
            agents[i, 2:4] - agents[j, 2:4],
            agents[i, 4] + agents[j, 4],
            horizon,
            time_step,
        )
        for j in near
    ]
    points = np.array([agents[i, 2:4] + u / 2 for u, _ in planes])
    return solve(points, np.array([n for _, n in planes]), preferred, max_speed)


# People


def human_velocities(s: dict[str, Any], goal: np.ndarray, scenario: Scenario) -> np.ndarray:
    """What the humans of snapshot `s` choose, given the goals they have in this step, [M, 2].

    Who is not present keeps the velocity that is written down.
    """
    here = np.flatnonzero(s["human_present"])
    radius = s["human_radius"] + scenario.human_safety_space
    agents = np.column_stack([s["human_position"], s["human_velocity"], radius])[here]
    if scenario.crowd_reaction is CrowdReaction.reciprocal:
        n = len(s["robot_heading"])
        reach = np.full(n, scenario.robot_radius + scenario.human_safety_space)
        agents = np.vstack(
            [agents, np.column_stack([s["robot_position"], s["robot_velocity"], reach])]
        )
    chosen = s["human_velocity"].copy()
    chosen[here] = 0.0
    for row, j in enumerate(here if scenario.crowd != Crowd.still else []):
        to_goal = goal[j] - agents[row, :2]
        preferred = s["human_speed"][j] * to_goal / np.hypot(*to_goal)
        if scenario.crowd == Crowd.orca:
            chosen[j] = orca(
                agents,
                row,
                preferred,
                s["human_speed"][j],
                scenario.neighbor_distance,
                scenario.max_neighbors,
                scenario.time_horizon,
                scenario.time_step,
            )
        else:
            chosen[j] = social_force(agents, row, preferred, s["human_speed"][j], scenario)
    return chosen


def social_force(
    agents: np.ndarray, i: int, preferred: np.ndarray, max_speed: float, scenario: Scenario
) -> np.ndarray:
    """Helbing and Molnar, 1995."""
    force = (preferred - agents[i, 2:4]) / scenario.relaxation_time
    for j in range(len(agents)):
        if j != i:
            away = agents[i, :2] - agents[j, :2]
            distance = float(np.hypot(*away))
            gap = distance - agents[i, 4] - agents[j, 4]
            strength = scenario.force_strength * math.exp(-gap / scenario.force_range)
            force = force + strength * away / distance
    velocity = agents[i, 2:4] + force * scenario.time_step
    return velocity * min(1.0, max_speed / max(float(np.hypot(*velocity)), 1e-12))


# Robots


def drive(
    velocity: np.ndarray, heading: float, action: np.ndarray, scenario: Scenario, margin: Margin
) -> tuple[np.ndarray, float]:
    """Velocity and heading after one action (SAMARL, Eq. 2-3, or the simpler models)."""
    dt, top = scenario.time_step, scenario.robot_speed
    most = math.radians(scenario.max_turn_rate * scenario.time_step)
    if scenario.kinematics is Kinematics.holonomic:
        wanted = action * top / max(1.0, math.hypot(*action))
        turned = heading + (math.atan2(action[1], action[0]) if action.any() else 0.0)
        return _rotate(wanted, heading), wrap(turned)
    if scenario.kinematics is Kinematics.unicycle:
        heading = wrap(heading + action[1] * most)
        return _rotate(np.array([(action[0] + 1) / 2 * top, 0.0]), heading), heading
    pair = action[:2] * scenario.max_acceleration / max(1.0, math.hypot(*action[:2]))
    wanted = np.array([math.hypot(*velocity), 0.0]) + pair * dt  # along and across the new heading
    if not margin.below(0.0, wanted[0]):
        return np.zeros(2), wrap(heading + action[2] * most * scenario.turn_in_place)
    speed = min(math.hypot(*wanted), top)
    limit = min(most, dt * speed / scenario.min_turning_radius)
    turn = np.clip(action[2] * most + math.atan2(wanted[1], wanted[0]), -limit, limit)
    heading = wrap(heading + turn)
    return _rotate(np.array([speed, 0.0]), heading), heading


def _rotate(vector: np.ndarray, angle: float) -> np.ndarray:
    c, s = math.cos(angle), math.sin(angle)
    return np.array([c * vector[0] - s * vector[1], s * vector[0] + c * vector[1]])


def closest_approach(before: np.ndarray, after: np.ndarray) -> float:
    """By bisection on the derivative of the squared distance, which rises along the way."""
    low, high = 0.0, 1.0
    way = after - before
    for _ in range(60):
        middle = (low + high) / 2
        if (before + middle * way) @ way < 0:
            low = middle
        else:
            high = middle
    return float(np.hypot(*(before + low * way)))


def first_touch(before: np.ndarray, after: np.ndarray, radii: float) -> np.ndarray:
    """The relative position at which the discs touch first, by bisection; they touch on the way."""
    low, high = 0.0, 1.0
    way = after - before
    for _ in range(60):
        middle = (low + high) / 2
        if closest_approach(before, before + middle * way) < radii:
            high = middle
        else:
            low = middle
    return before + high * way


def walls_of(s: dict[str, Any]) -> np.ndarray:
    """The wall segments of snapshot `s`, [W, 4]."""
    count = int(s["place"][0]) if len(s["place"]) else 0
    return s["walls"][:4, :count].T


def closest_to_wall(before: np.ndarray, after: np.ndarray, wall: np.ndarray) -> float:
    """By trisection: the distance of a segment from a point that moves straight is convex."""

    def distance(share: float) -> float:
        start, along = wall[:2], wall[2:] - wall[:2]
        point = before + share * (after - before)
        nearest = start + np.clip((point - start) @ along / (along @ along), 0, 1) * along
        return float(np.hypot(*(point - nearest)))

    low, high = 0.0, 1.0
    for _ in range(60):
        third = (high - low) / 3
        if distance(low + third) < distance(high - third):
            high -= third
        else:
            low += third
    return min(distance(0.0), distance(low), distance(1.0))


def soonest_collisions(s: dict[str, Any], scenario: Scenario, margin: Margin) -> np.ndarray:
    """When each robot would touch a human if nobody changed velocity, [N]."""
    robots = range(len(s["robot_heading"]))
    return np.array([_min_time_to_collision(s, i, scenario, margin) for i in robots])


def _min_time_to_collision(s: dict[str, Any], i: int, scenario: Scenario, margin: Margin) -> float:
    """By the distance at which the robot would miss the centre of each human."""
    soonest = math.inf
    for j in np.flatnonzero(s["human_present"]):
        radii = s["human_radius"][j] + scenario.robot_radius
        position = s["human_position"][j] - s["robot_position"][i]
        velocity = s["human_velocity"][j] - s["robot_velocity"][i]
        if np.hypot(*position) <= radii:
            return 0.0
        speed = float(np.hypot(*velocity))
        if speed == 0 or position @ velocity >= 0:
            continue
        miss = abs(position[0] * velocity[1] - position[1] * velocity[0]) / speed
        if margin.below(miss, radii):
            ahead = -(position @ velocity) / speed
            soonest = min(soonest, (ahead - math.sqrt(radii**2 - miss**2)) / speed)
    return soonest


# One step


def step(
    s: dict[str, Any],
    goal: np.ndarray,
    actions: np.ndarray,
    scenario: Scenario,
    route_left: np.ndarray,
) -> Outcome:
    """The world of snapshot `s` one step later; people do not walk among walls.

    Args:
        s: see `snapshot`.
        goal: [M, 2] the goals that the humans have in this step (they may have been redrawn).
        actions: [N, A].
        scenario: the task.
        route_left: [N] the routes that are left after the step, where there are walls.
    """
    margin = Margin()
    dt, n, here = scenario.time_step, len(s["robot_heading"]), np.flatnonzero(s["human_present"])
    velocity, humans = human_velocities(s, goal, scenario), s["human_position"].copy()
    humans[here] += velocity[here] * dt
    robots, robot_velocity, headings = (
        s["robot_position"].copy(),
        s["robot_velocity"].copy(),
        s["robot_heading"].copy(),
    )
    contact = np.zeros(n, int)
    for i in range(n):
        action = np.asarray(actions[i], np.float64)
        if s["arrived"][i]:
            action = np.array([-1.0, 0.0, 0.0])[: len(action)]
            if scenario.kinematics is Kinematics.holonomic:
                action = np.zeros(2)
        new, headings[i] = drive(
            s["robot_velocity"][i], s["robot_heading"][i], action, scenario, margin
        )
        if scenario.kinematics is Kinematics.acceleration_heading:
            robots[i] += (s["robot_velocity"][i] + new) / 2 * dt
        else:
            robots[i] += new * dt
        wall = math.inf if scenario.arena_radius is None else scenario.arena_radius
        wall -= scenario.robot_radius
        if margin.below(wall, float(np.hypot(*robots[i]))):
            robots[i] *= wall / np.hypot(*robots[i])
            new = np.zeros(2)
        for segment in walls_of(s):
            before, after = s["robot_position"][i], robots[i].copy()
            if margin.below(closest_to_wall(before, after, segment), scenario.robot_radius):
                contact[i] = 0 if s["arrived"][i] else 5  # hit_wall
                if s["arrived"][i] or not scenario.terminate_on_collision:
                    robots[i], new = before, np.zeros(2)
                break
        robot_velocity[i] = new
    ran_into = np.zeros(n, int)
    contacts = np.zeros(n)
    # Pairs of a robot and a slot of `last_contact`, in which a robot's own slot is that of walls.
    touching = {(int(i), len(humans) + int(i)) for i in np.flatnonzero(contact)}
    gap = np.full(n, math.inf)
    for i in range(n):
        if s["arrived"][i]:
            continue
        for j in here:
            radii = s["human_radius"][j] + scenario.robot_radius
            before = s["human_position"][j] - s["robot_position"][i]
            after = humans[j] - robots[i]
            gap[i] = min(gap[i], np.hypot(*after) - radii)
            if margin.below(closest_approach(before, after), radii):
                contact[i] = 1
                touching.add((i, j))
                line = first_touch(before, after, radii)
                line = line / np.hypot(*line)
                robots_way = (robots[i] - s["robot_position"][i]) @ line
                humans_way = (s["human_position"][j] - humans[j]) @ line
                new = s["last_contact"][i, j] != s["clock"]
                if not margin.below(robots_way, humans_way) and new:
                    ran_into[i] += 1
        for k in range(n):
            if k == i:
                continue
            before = s["robot_position"][k] - s["robot_position"][i]
            if margin.below(
                closest_approach(before, robots[k] - robots[i]), 2 * scenario.robot_radius
            ):
                contact[i] = 1 if contact[i] == 1 else 2
                touching.add((i, len(humans) + k))
    last_contact = s["last_contact"].copy()
    for i, slot in touching:
        if last_contact[i, slot] != s["clock"]:  # apart in the step before
            other = slot - len(humans)
            other_drives = other >= 0 and other != i and not s["arrived"][other]
            contacts[i] += 0.5 if other_drives else 1.0
        last_contact[i, slot] = s["clock"] + 1
    to_goal_before = np.hypot(*(s["robot_goal"] - s["robot_position"]).T)
    to_goal = np.hypot(*(s["robot_goal"] - robots).T)
    progress = s["route_left"] - route_left if len(walls_of(s)) else to_goal_before - to_goal
    reached = np.array(
        [
            bool(margin.below(to_goal[i], scenario.robot_radius))
            and not (contact[i] and scenario.terminate_on_collision)
            for i in range(n)
        ]
    )
    driving = ~s["arrived"]
    reached &= driving
    arrived = s["arrived"] | reached
    team = bool(arrived.all() and reached.any())
    reward = np.array(
        [
            _reward(
                scenario,
                margin,
                bool(contact[i]),
                bool(reached[i]),
                team,
                bool(driving[i]),
                float(gap[i]),
                float(progress[i]),
                float(to_goal[i]),
            )
            for i in range(n)
        ]
    )
    tally: dict[str, list[float]] = {}
    for i in range(n):
        edges = [0.45, 1.2, 3.6]
        space = sum(not margin.below(float(gap[i]), edge) for edge in edges)
        added = {
            "close_steps": space == 0,
            "personal_steps": space == 1,
            "social_steps": space == 2,
            "standing_steps": margin.below(float(np.hypot(*robot_velocity[i])), 0.05),
            "heading_change": abs(wrap(headings[i] - s["robot_heading"][i])),
            "ran_into": ran_into[i],
            "contacts": contacts[i],
            "comfort_steps": margin.below(float(gap[i]), 0.25),
        }
        for name, value in added.items():
            tally.setdefault(name, []).append(float(value) * float(driving[i]))
    terminated = bool((scenario.terminate_on_collision and contact.any()) or arrived.all())
    late = int(s["clock"]) + 1 >= scenario.time_limit_steps
    return Outcome(
        humans,
        velocity,
        robots,
        robot_velocity,
        headings,
        arrived,
        np.where(s["collision"] != 0, s["collision"], contact),
        contact,
        last_contact,
        reward,
        terminated,
        late and not terminated,
        {name: np.array(values) for name, values in tally.items()},
        margin,
    )


def _reward(
    scenario: Scenario,
    margin: Margin,
    collided: bool,
    reached: bool,
    team: bool,
    driving: bool,
    gap: float,
    progress: float,
    distance: float,
) -> float:
    """SAMARL, Eq. 10; and MSA3C, Eq. 2, without what Eq. 10 has already."""
    w = scenario.reward
    on_its_way = w.time - w.goal_distance * distance / scenario.circle_radius**2
    beside = on_its_way if driving and not collided else 0.0
    events = [(team, w.team), (reached, w.arrival), (collided, w.collision)]
    happened = [value for event, value in events if event]
    if happened:
        return (happened[0] if w.literal else sum(happened)) + beside
    if not driving:
        return 0.0
    if margin.below(gap, w.discomfort_distance):
        return max(-w.discomfort / gap, w.discomfort_limit) + beside
    return w.progress * progress + beside


# The sensor, without noise


def observe(s: dict[str, Any], scenario: Scenario) -> tuple[dict[str, np.ndarray], Margin]:
    """What every robot of snapshot `s` knows, by field of `mrsan.Observation`."""
    margin = Margin()
    n, slots = len(s["robot_heading"]), len(s["human_radius"])
    present = np.flatnonzero(s["human_present"])
    m = len(present)
    out = {
        "ego": np.zeros((n, 11)),
        "humans": np.zeros((n, slots, 5)),
        "humans_visible": np.zeros((n, slots), bool),
        "robots": np.zeros((n, n - 1, 5)),
        "robots_visible": np.zeros((n, n - 1), bool),
    }
    discs = [
        (s["human_position"][j], s["human_velocity"][j], s["human_radius"][j]) for j in present
    ]
    discs += [
        (s["robot_position"][k], s["robot_velocity"][k], scenario.robot_radius) for k in range(n)
    ]
    for i in range(n):
        here, own, heading = s["robot_position"][i], s["robot_velocity"][i], s["robot_heading"][i]
        out["ego"][i] = [
            *_rotate(s["robot_goal"][i] - here, -heading),
            *_rotate(own, -heading),
            *_rotate(-here, -heading),
            math.cos(heading),
            math.sin(heading),
            scenario.robot_radius,
            scenario.robot_speed,
            s["clock"] / scenario.time_limit_steps,
        ]
        for j, (position, velocity, radius) in enumerate(discs):
            if j == m + i:
                continue
            others = [d for k, d in enumerate(discs) if k not in (j, m + i)]
            if not _sees(here, heading, position, others, scenario, margin):
                continue
            row = [*_rotate(position - here, -heading), *_rotate(velocity - own, -heading), radius]
            kind, slot = ("humans", present[j]) if j < m else ("robots", j - m - (j - m > i))
            out[kind][i, slot] = row
            out[f"{kind}_visible"][i, slot] = True
    return out, margin


def _sees(
    here: np.ndarray,
    heading: float,
    target: np.ndarray,
    others: list[tuple[np.ndarray, np.ndarray, float]],
    scenario: Scenario,
    margin: Margin,
) -> bool:
    line = target - here
    distance = float(np.hypot(*line))
    bearing = math.atan2(line[1], line[0])
    seen = margin.below(distance, scenario.sensing_range)
    half = math.radians(scenario.fov_degrees) / 2
    if scenario.fov_degrees < 360:
        seen &= margin.below(abs(wrap(bearing - heading)), half)
    if scenario.occlusion:
        for position, _, radius in others:
            offset = position - here
            away = float(np.hypot(*offset))
            angle = abs(wrap(math.atan2(offset[1], offset[0]) - bearing))
            half_width = math.asin(radius / away) if away > radius else math.pi / 2
            if margin.below(away, distance) & margin.below(angle, half_width):
                seen = False
    return seen
