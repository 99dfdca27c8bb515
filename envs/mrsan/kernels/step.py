"""One step of every world: people move, robots move, contacts, arrival, reward, time limit."""

import math

import numpy as np
from numba import prange

from mrsan.kernels import function, kernel, rng
from mrsan.kernels.contact import closest_approach, comes_to_the_other, time_to_collision
from mrsan.kernels.habits import come_and_go, stands, walks_along
from mrsan.kernels.kinematics import brake, next_velocity, wrap_angle
from mrsan.kernels.layout import draw_goal, layout_of
from mrsan.kernels.orca import orca_room, orca_velocity
from mrsan.kernels.recorded import RECORDED, follow, recorded_velocity
from mrsan.kernels.social_force import social_force_velocity
from mrsan.kernels.tally import (
    CLOSE_STEPS,
    CLOSEST_HUMAN,
    COMFORT_STEPS,
    CONTACTS,
    DRIVEN_STEPS,
    HEADING_CHANGE,
    JERK_SUM,
    PATH_LENGTH,
    PERSONAL_STEPS,
    RAN_INTO,
    SOCIAL_STEPS,
    SOONEST_COLLISION,
    STANDING_STEPS,
)
from mrsan.reward import step_reward_parts

ORCA = 0
SOCIAL_FORCE = 1
STILL = 2

# Where the intimate, the personal and the social space of a person end, from surface to surface, m
# (Hall, The Hidden Dimension, 1966).
PERSONAL_SPACE = np.float32(0.45)
SOCIAL_SPACE = np.float32(1.2)
PUBLIC_SPACE = np.float32(3.6)
COMFORT_ZONE = np.float32(0.25)  # round a person (MSA3C, Table 1), m
STANDING_SPEED = np.float32(0.05)  # slower is not moving, m/s

HIT_HUMAN = 1
HIT_ROBOT = 2

_ZERO = np.float32(0.0)
_HALF = np.float32(0.5)
_ONE = np.float32(1.0)
_TINY = np.float32(1e-6)
_FAR = np.float32(np.inf)


@kernel
def advance(chunks, state, action, p, recording, reward, parts):
    """Move every world that has not ended by one time step, in place.

    Args:
        chunks: number of pieces the loop over worlds is cut into.
        state: the worlds.
        action: [E, N, A] in [-1, 1].
        p: the scenario's parameters.
        recording: the ways of recorded people.
        reward: [E, N], written; zero in worlds that had ended.
        parts: [8, E, N], written: its terms in the order of `RewardParts`, but the last.
    """
    total, robots = reward.shape
    people = state.human_radius.shape[1]
    for chunk in prange(chunks):
        agents, scratch = orca_room(people + robots)
        slots = np.empty(people, np.int32)
        chosen = np.empty((people, 2), np.float32)
        moved = np.empty((robots, 2), np.float32)
        gap = np.empty(robots, np.float32)
        contact = np.empty(robots, np.int8)
        for e in range(chunk * total // chunks, (chunk + 1) * total // chunks):
            if state.terminated[e] or state.truncated[e]:
                reward[e, :] = _ZERO
                parts[:, e, :] = _ZERO
                continue
            if p.crowd == RECORDED:
                follow(state, e, recording, p)
            elif p.people_come_and_go:
                come_and_go(state, e, p)
            here = slots[: _find_present(state.human_present[e], slots)]
            if p.crowd == RECORDED:
                for row in range(here.shape[0]):
                    chosen[row, 0], chosen[row, 1] = recorded_velocity(
                        state, e, here[row], recording, p
                    )
            else:
                _choose_human_velocities(state, e, p, here, agents, chosen, scratch)
            _move_robots(state, e, action, p, moved)
            _move_humans(state, e, p, here, chosen)
            _find_contacts(state, e, p, here, moved, gap, contact)
            _settle(state, e, p, moved, gap, contact, reward, parts)


@function
def _find_present(present, slots):
    """Fill `slots` with the numbers of the humans who are present; return how many."""
    count = 0
    for j in range(present.shape[0]):
        if present[j]:
            slots[count] = j
            count += 1
    return count


@function
def _choose_human_velocities(state, e, p, here, agents, chosen, scratch):
    """What each human who is present wants to do next, all decided on the same state."""
    position, velocity, goal = state.human_position, state.human_velocity, state.human_goal
    radius, preferred_speed = state.human_radius, state.human_speed
    robot_position, robot_velocity = state.robot_position, state.robot_velocity
    rows = here.shape[0]
    if p.crowd == STILL:
        chosen[:rows, :] = _ZERO
        return
    for row in range(rows):
        j = here[row]
        agents[row, 0], agents[row, 1] = position[e, j, 0], position[e, j, 1]
        agents[row, 2], agents[row, 3] = velocity[e, j, 0], velocity[e, j, 1]
        agents[row, 4] = radius[e, j] + p.human_safety_space
    if p.robots_visible:
        for i in range(robot_position.shape[1]):
            agents[rows, 0], agents[rows, 1] = robot_position[e, i, 0], robot_position[e, i, 1]
            agents[rows, 2], agents[rows, 3] = robot_velocity[e, i, 0], robot_velocity[e, i, 1]
            agents[rows, 4] = p.robot_radius + p.human_safety_space
            rows += 1
    key, step = state.key[e], state.clock[e]
    layout = layout_of(key, p)
    led_x = led_y = _ZERO  # by what the goal of the human before was moved
    change_time = step > 0 and step % p.goal_change_steps == 0
    for row in range(here.shape[0]):
        j = here[row]
        x, y, speed = position[e, j, 0], position[e, j, 1], preferred_speed[e, j]
        dx, dy = goal[e, j, 0] - x, goal[e, j, 1] - y
        renew = dx * dx + dy * dy < radius[e, j] * radius[e, j]
        if change_time and not renew:
            renew = rng.uniform(key, rng.GOAL_CHANGE, j, step, 0) < rng.uniform_between(
                p.goal_change_probability,
                p.goal_change_probability_max,
                key, rng.HUMAN_TRAITS, j, 0, 2,
            )  # fmt: skip
        old_x, old_y = goal[e, j, 0], goal[e, j, 1]
        if walks_along(key, j, p) and state.human_present[e, j - 1]:
            goal[e, j, 0], goal[e, j, 1] = old_x + led_x, old_y + led_y
        elif renew:
            goal[e, j, 0], goal[e, j, 1] = draw_goal(
                x, y, old_x, old_y, key, j, step, speed, layout, p
            )
        led_x, led_y = goal[e, j, 0] - old_x, goal[e, j, 1] - old_y
        dx, dy = goal[e, j, 0] - x, goal[e, j, 1] - y
        scale = speed / max(math.sqrt(dx * dx + dy * dy), _TINY)
        if stands(key, j, step, p):
            scale = _ZERO
        if p.crowd == ORCA:
            chosen[row, 0], chosen[row, 1] = orca_velocity(
                agents,
                rows,
                row,
                dx * scale,
                dy * scale,
                speed,
                p.neighbor_distance,
                p.max_neighbors,
                p.time_horizon,
                p.time_step,
                scratch,
            )
        else:
            chosen[row, 0], chosen[row, 1] = social_force_velocity(
                agents,
                rows,
                row,
                dx * scale,
                dy * scale,
                speed,
                p.relaxation_time,
                p.force_strength,
                p.force_range,
                p.time_step,
            )


@function
def _move_robots(state, e, action, p, moved):
    """SAMARL, Eq. 1-3, with the records of the drive; `moved` receives the displacements."""
    position, velocity = state.robot_position, state.robot_velocity
    headings, arrived, acceleration = state.robot_heading, state.arrived, state.robot_acceleration
    dt, wall, tally = p.time_step, p.arena_radius - p.robot_radius, state.tally
    for i in range(moved.shape[0]):
        x, y, vx, vy = position[e, i, 0], position[e, i, 1], velocity[e, i, 0], velocity[e, i, 1]
        if arrived[e, i]:
            new_vx, new_vy, heading = brake(vx, vy, headings[e, i], p)
        else:
            new_vx, new_vy, heading = next_velocity(vx, vy, headings[e, i], action[e, i], p)
        if p.instant_velocity:
            new_x, new_y = x + new_vx * dt, y + new_vy * dt
        else:
            new_x = x + _HALF * (vx + new_vx) * dt  # Eq. 1
            new_y = y + _HALF * (vy + new_vy) * dt
        distance = math.sqrt(new_x * new_x + new_y * new_y)
        if distance > wall:
            new_x, new_y = new_x * wall / distance, new_y * wall / distance
            new_vx = new_vy = _ZERO
        dx, dy = new_x - x, new_y - y
        if not arrived[e, i]:
            ax, ay = (new_vx - vx) / dt, (new_vy - vy) / dt
            jx = (ax - acceleration[e, i, 0]) / dt
            jy = (ay - acceleration[e, i, 1]) / dt
            acceleration[e, i, 0], acceleration[e, i, 1] = ax, ay
            tally[e, i, JERK_SUM] += math.sqrt(jx * jx + jy * jy)
            tally[e, i, PATH_LENGTH] += math.sqrt(dx * dx + dy * dy)
            tally[e, i, DRIVEN_STEPS] += _ONE
            tally[e, i, HEADING_CHANGE] += abs(wrap_angle(heading - headings[e, i]))
            if new_vx * new_vx + new_vy * new_vy < STANDING_SPEED * STANDING_SPEED:
                tally[e, i, STANDING_STEPS] += _ONE
        moved[i, 0], moved[i, 1] = dx, dy
        position[e, i, 0], position[e, i, 1] = new_x, new_y
        velocity[e, i, 0], velocity[e, i, 1] = new_vx, new_vy
        headings[e, i] = heading


@function
def _move_humans(state, e, p, here, chosen):
    position, velocity = state.human_position, state.human_velocity
    for row in range(here.shape[0]):
        for k in range(2):
            velocity[e, here[row], k] = chosen[row, k]
            position[e, here[row], k] += chosen[row, k] * p.time_step


@function
def _find_contacts(state, e, p, here, moved, gap, contact):
    """Whom robots touch during the step, and how near they come.

    Args:
        state: the worlds.
        e: which of them.
        p: the scenario's parameters.
        here: the humans who are present.
        moved: [N, 2] displacements of the robots.
        gap: [N], written: surface distance to the nearest human after the step.
        contact: [N], written: 0, or whom it touches (HIT_*); a human comes first.
    """
    position, arrived, collision = state.robot_position, state.arrived, state.collision
    last_contact, clock = state.last_contact, state.clock[e]
    velocity, tally = state.robot_velocity, state.tally
    human_position, human_velocity = state.human_position, state.human_velocity
    human_radius = state.human_radius
    people = human_radius.shape[1]
    dt, robot_radius, robots = p.time_step, p.robot_radius, moved.shape[0]
    for i in range(robots):
        gap[i], contact[i] = _FAR, 0
        if arrived[e, i]:  # parked: it hits nobody, and who walks into it does not count
            continue
        x, y, vx, vy = position[e, i, 0], position[e, i, 1], velocity[e, i, 0], velocity[e, i, 1]
        own_x, own_y = moved[i, 0], moved[i, 1]
        nearest = _FAR
        closest, soonest = tally[e, i, CLOSEST_HUMAN], tally[e, i, SOONEST_COLLISION]
        for row in range(here.shape[0]):
            j = here[row]
            dx, dy = human_position[e, j, 0] - x, human_position[e, j, 1] - y
            human_vx, human_vy = human_velocity[e, j, 0], human_velocity[e, j, 1]
            radii = human_radius[e, j] + robot_radius
            before_x = dx - human_vx * dt + own_x
            before_y = dy - human_vy * dt + own_y
            approach = closest_approach(before_x, before_y, dx, dy) - radii
            closest = min(closest, approach)
            nearest = min(nearest, math.sqrt(dx * dx + dy * dy) - radii)
            soonest = time_to_collision(dx, dy, human_vx - vx, human_vy - vy, radii, soonest)
            if approach < _ZERO:
                contact[i] = HIT_HUMAN
                soonest = _ZERO
                other_x, other_y = human_vx * dt, human_vy * dt
                if last_contact[e, i, j] != clock:  # they did not touch in the step before
                    tally[e, i, CONTACTS] += _ONE
                    tally[e, i, RAN_INTO] += comes_to_the_other(
                        own_x, own_y, other_x, other_y, before_x, before_y, radii
                    )
                last_contact[e, i, j] = clock + 1
        gap[i] = nearest
        tally[e, i, CLOSEST_HUMAN], tally[e, i, SOONEST_COLLISION] = closest, soonest
        for k in range(robots):
            if k == i:
                continue
            dx, dy = position[e, k, 0] - x, position[e, k, 1] - y
            before_x, before_y = dx - moved[k, 0] + moved[i, 0], dy - moved[k, 1] + moved[i, 1]
            if closest_approach(before_x, before_y, dx, dy) < robot_radius + robot_radius:
                if contact[i] == 0:
                    contact[i] = HIT_ROBOT
                if last_contact[e, i, people + k] != clock:
                    tally[e, i, CONTACTS] += _ONE if arrived[e, k] else _HALF
                last_contact[e, i, people + k] = clock + 1
        if collision[e, i] == 0:
            collision[e, i] = contact[i]
        if nearest < COMFORT_ZONE:
            tally[e, i, COMFORT_STEPS] += _ONE
        if nearest < PERSONAL_SPACE:
            tally[e, i, CLOSE_STEPS] += _ONE
        elif nearest < SOCIAL_SPACE:
            tally[e, i, PERSONAL_STEPS] += _ONE
        elif nearest < PUBLIC_SPACE:
            tally[e, i, SOCIAL_STEPS] += _ONE


@function
def _settle(state, e, p, moved, gap, contact, reward, parts):
    """Arrival, the end of the episode, and the reward of the step that led here."""
    position, goal, arrived = state.robot_position, state.robot_goal, state.arrived
    state.clock[e] += 1
    collided = False
    newly_arrived = 0
    all_arrived = True
    for i in range(moved.shape[0]):
        ends = contact[i] != 0 and p.collisions_end
        dx, dy = goal[e, i, 0] - position[e, i, 0], goal[e, i, 1] - position[e, i, 1]
        reached = not ends and math.sqrt(dx * dx + dy * dy) < p.robot_radius
        newly_arrived += not arrived[e, i] and reached
        all_arrived = all_arrived and (arrived[e, i] or reached)
        collided = collided or ends
    team_arrived = all_arrived and newly_arrived > 0
    for i in range(moved.shape[0]):
        hit, driving = contact[i] != 0, not arrived[e, i]
        dx, dy = goal[e, i, 0] - position[e, i, 0], goal[e, i, 1] - position[e, i, 1]
        distance = math.sqrt(dx * dx + dy * dy)
        dx, dy = dx + moved[i, 0], dy + moved[i, 1]
        progress = math.sqrt(dx * dx + dy * dy) - distance
        reached = driving and not (hit and p.collisions_end) and distance < p.robot_radius
        nearer, arrival, team, crash, discomfort, far, late = step_reward_parts(
            hit, reached, team_arrived, driving, gap[i], progress, distance, p
        )
        parts[0, e, i], parts[1, e, i], parts[2, e, i] = nearer, arrival, team
        parts[3, e, i], parts[4, e, i] = crash, discomfort
        parts[5, e, i], parts[6, e, i] = far, late
        reward[e, i] = nearer + arrival + team + crash + discomfort + far + late
        arrived[e, i] = arrived[e, i] or reached
    state.terminated[e] = collided or all_arrived
    state.truncated[e] = not state.terminated[e] and state.clock[e] >= p.time_limit_steps
