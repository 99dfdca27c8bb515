"""One step of every world: people move, robots move, contacts, arrival, reward, time limit."""

import math

import numpy as np

from mrsan.kernels import function, kernel
from mrsan.kernels.contact import (
    closest_to_human,
    closest_to_robot,
    comes_to_the_other,
    time_to_collision,
)
from mrsan.kernels.kinematics import brake, next_velocity, wrap_angle
from mrsan.kernels.orca import allocate_orca_scratch
from mrsan.kernels.people import enter_and_leave, orca_crowd, walk_to_goals
from mrsan.kernels.tally import (
    CLOSE_STEPS,
    CLOSEST_HUMAN,
    COMFORT_STEPS,
    CONTACTS,
    DEADLOCKS,
    DRIVEN_STEPS,
    HEADING_CHANGE,
    JERK_SUM,
    PATH_LENGTH,
    PERSONAL_STEPS,
    RAN_INTO,
    SOCIAL_STEPS,
    SOONEST_COLLISION,
    STANDING_STEPS,
    STILL_STEPS,
)
from mrsan.reward import step_reward_parts, sum_of_parts


@function
def no_wall(state, e, x, y, dx, dy, p):
    """Return whether a robot touches a wall: never, without walls."""
    return False


@function
def straight_progress(state, e, i, progress, p):
    """Return the progress of a robot, m: that towards its goal, without walls."""
    return progress


@function
def no_groups(state, e, p, settings):
    """Count no robots in groups, without groups."""


@function
def one_piece(action):
    """Return in how many straight pieces robots move: in one, if they move by actions."""
    return 1


@function
def move_by_action(state, e, i, action, p, remaining, touches_wall):
    """Return the next position, velocity and heading of a robot, and whether it touches a wall.

    SAMARL, Eq. 1-3, within the arena.
    """
    x, y = state.robot_position[e, i, 0], state.robot_position[e, i, 1]
    vx, vy = state.robot_velocity[e, i, 0], state.robot_velocity[e, i, 1]
    heading, arrived = state.robot_heading[e, i], state.arrived[e, i]
    dt, wall = p.time_step, p.arena_radius - p.robot_radius
    if arrived:
        new_vx, new_vy, heading = brake(vx, vy, heading, p)
    else:
        new_vx, new_vy, heading = next_velocity(vx, vy, heading, action[e, i], p)
    if p.instant_velocity:
        new_x, new_y = x + new_vx * dt, y + new_vy * dt
    else:
        new_x = x + _HALF * (vx + new_vx) * dt  # Eq. 1
        new_y = y + _HALF * (vy + new_vy) * dt
    distance = math.sqrt(new_x * new_x + new_y * new_y)
    if distance > wall:
        new_x, new_y = new_x * wall / distance, new_y * wall / distance
        new_vx = new_vy = _ZERO
    hits_wall = touches_wall(state, e, x, y, new_x - x, new_y - y, p)
    if hits_wall and (arrived or not p.terminate_on_collision):  # it stops there
        new_x, new_y = x, y
        new_vx = new_vy = _ZERO
    remaining[0, i, 0], remaining[0, i, 1] = new_x - x, new_y - y
    return new_x, new_y, new_vx, new_vy, heading, hits_wall


# How robots move, see also `mrsan.kernels.along`; the functions of a crowd model, see
# `mrsan.crowds`, those that know the place, see `mrsan.kernels.walled`, and those that know groups,
# see `mrsan.kernels.groups`; `advance.variant` replaces them.
pieces = one_piece
move_robot = move_by_action
touches_wall = no_wall
route_progress = straight_progress
count_intrusions = no_groups
update_presence = enter_and_leave
choose_velocities = walk_to_goals
crowd_velocity = orca_crowd

# Outer limits of the intimate, personal and social space of a person, from surface to surface, m
# (Hall, The Hidden Dimension, 1966).
PERSONAL_SPACE = np.float32(0.45)
SOCIAL_SPACE = np.float32(1.2)
PUBLIC_SPACE = np.float32(3.6)
COMFORT_ZONE = np.float32(0.25)  # round a person (MSA3C, Table 1), m
STANDING_SPEED = np.float32(0.05)  # a slower robot stands, m/s

HIT_HUMAN = 1
HIT_ROBOT = 2
HIT_WALL = 5  # 3 and 4 are other outcomes, see `mrsan.metrics.Outcome`

_ZERO = np.float32(0.0)
_HALF = np.float32(0.5)
_ONE = np.float32(1.0)
_FAR = np.float32(np.inf)


@kernel
def advance(first, last, state, action, p, crowd_settings, recording, reward, parts):
    """Move every world that has not ended by one time step, in place.

    Args:
        first: the first world.
        last: the world after the last one.
        state: the worlds.
        action: [E, N, A] in [-1, 1], or what the variant of `move_robot` takes instead.
        p: the scenario's parameters.
        crowd_settings: the settings of the crowd model, see `mrsan.crowds`.
        recording: the tracks of recorded people.
        reward: [E, N], written; zero in worlds that had ended.
        parts: [9, E, N], written: its terms in the order of `RewardParts`.
    """
    robots = reward.shape[1]
    people = state.human_radius.shape[1]
    agents, scratch = allocate_orca_scratch(people + robots)
    slots = np.empty(people, np.int32)
    human_velocities = np.empty((people, 2), np.float32)
    # Displacement of each robot from K moments of the step, the first at its start, to its end.
    remaining = np.empty((pieces(action), robots, 2), np.float32)
    human_gap = np.empty(robots, np.float32)
    contact = np.empty(robots, np.int8)
    for e in range(first, last):
        if state.terminated[e] or state.truncated[e]:
            reward[e, :] = _ZERO
            parts[:, e, :] = _ZERO
            continue
        update_presence(state, e, p, recording)
        present = slots[: _list_present(state.human_present[e], slots)]
        choose_velocities(
            state,
            e,
            p,
            crowd_settings,
            recording,
            present,
            agents,
            human_velocities,
            scratch,
            crowd_velocity,
        )
        _move_robots(state, e, action, p, remaining, contact, move_robot, touches_wall)
        _move_humans(state, e, p, present, human_velocities)
        _find_contacts(state, e, p, present, remaining, human_gap, contact)
        count_intrusions(state, e, p, crowd_settings)
        _finish_step(state, e, p, remaining[0], human_gap, contact, reward, parts, route_progress)


@function
def _list_present(present, slots):
    """Write the numbers of the humans who are present; return how many there are."""
    count = 0
    for j in range(present.shape[0]):
        if present[j]:
            slots[count] = j
            count += 1
    return count


@function
def _move_robots(state, e, action, p, remaining, contact, move_robot, touches_wall):
    """Move the robots, write `remaining` and update their tallies.

    `contact` is 0, or `HIT_WALL` for a robot that touches a wall on its way.
    """
    position, velocity = state.robot_position, state.robot_velocity
    headings, arrived, acceleration = state.robot_heading, state.arrived, state.robot_acceleration
    dt, tally = p.time_step, state.tally
    for i in range(contact.shape[0]):
        vx, vy = velocity[e, i, 0], velocity[e, i, 1]
        new_x, new_y, new_vx, new_vy, heading, hits_wall = move_robot(
            state, e, i, action, p, remaining, touches_wall
        )
        contact[i] = HIT_WALL if hits_wall else 0
        dx, dy = remaining[0, i, 0], remaining[0, i, 1]
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
        position[e, i, 0], position[e, i, 1] = new_x, new_y
        velocity[e, i, 0], velocity[e, i, 1] = new_vx, new_vy
        headings[e, i] = heading


@function
def _move_humans(state, e, p, present, human_velocities):
    position, velocity = state.human_position, state.human_velocity
    for row in range(present.shape[0]):
        for k in range(2):
            velocity[e, present[row], k] = human_velocities[row, k]
            position[e, present[row], k] += human_velocities[row, k] * p.time_step


@function
def _find_contacts(state, e, p, present, remaining, human_gap, contact):
    """Find the agents that robots touch during the step, and the distances to people.

    Args:
        state: the worlds.
        e: which of them.
        p: the scenario's parameters.
        present: the numbers of the humans who are present.
        remaining: [K, N, 2] displacement of each robot from K moments, evenly spaced from the start
            of the step on, to its end, m; it moves straight between them.
        human_gap: [N], written: surface distance to the nearest human after the step, m.
        contact: [N], updated: 0 or `HIT_WALL` before, then what the robot touches (HIT_*); a human
            takes precedence, then a robot.
    """
    position, arrived, collision = state.robot_position, state.arrived, state.collision
    last_contact, clock = state.last_contact, state.clock[e]
    velocity, tally = state.robot_velocity, state.tally
    human_position, human_velocity = state.human_position, state.human_velocity
    human_radius = state.human_radius
    people = human_radius.shape[1]
    dt, robot_radius, robots = p.time_step, p.robot_radius, remaining.shape[1]
    for i in range(robots):
        human_gap[i] = _FAR
        if arrived[e, i]:  # a parked robot takes part in no contacts
            contact[i] = 0
            continue
        if contact[i] == HIT_WALL:
            if last_contact[e, i, people + i] != clock:
                tally[e, i, CONTACTS] += _ONE
            last_contact[e, i, people + i] = clock + 1
        x, y, vx, vy = position[e, i, 0], position[e, i, 1], velocity[e, i, 0], velocity[e, i, 1]
        own_x, own_y = remaining[0, i, 0], remaining[0, i, 1]
        nearest = _FAR
        closest, soonest = tally[e, i, CLOSEST_HUMAN], tally[e, i, SOONEST_COLLISION]
        for row in range(present.shape[0]):
            j = present[row]
            dx, dy = human_position[e, j, 0] - x, human_position[e, j, 1] - y
            human_vx, human_vy = human_velocity[e, j, 0], human_velocity[e, j, 1]
            radii = human_radius[e, j] + robot_radius
            before_x = dx - human_vx * dt + own_x
            before_y = dy - human_vy * dt + own_y
            approach = closest_to_human(dx, dy, human_vx * dt, human_vy * dt, remaining[:, i])
            approach -= radii
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
        human_gap[i] = nearest
        tally[e, i, CLOSEST_HUMAN], tally[e, i, SOONEST_COLLISION] = closest, soonest
        with_robots = last_contact[e, i, people:]
        if _touches_robots(
            i, position[e], remaining, arrived[e], robot_radius, clock, with_robots, tally[e, i]
        ):
            if contact[i] != HIT_HUMAN:
                contact[i] = HIT_ROBOT
        if collision[e, i] == 0:
            collision[e, i] = contact[i]
        _tally_space(nearest, tally[e, i])


@function
def _touches_robots(i, position, remaining, arrived, radius, clock, last_contact, tally):
    """Return whether robot `i` touches another one during the step; count the new contacts."""
    touches = False
    for k in range(position.shape[0]):
        if k == i:
            continue
        dx, dy = position[k, 0] - position[i, 0], position[k, 1] - position[i, 1]
        if closest_to_robot(dx, dy, remaining[:, i], remaining[:, k]) < radius + radius:
            touches = True
            if last_contact[k] != clock:
                tally[CONTACTS] += _ONE if arrived[k] else _HALF
            last_contact[k] = clock + 1
    return touches


@function
def _tally_space(nearest, tally):
    """Count the step in the space of the nearest person in which the robot is."""
    if nearest < COMFORT_ZONE:
        tally[COMFORT_STEPS] += _ONE
    if nearest < PERSONAL_SPACE:
        tally[CLOSE_STEPS] += _ONE
    elif nearest < SOCIAL_SPACE:
        tally[PERSONAL_STEPS] += _ONE
    elif nearest < PUBLIC_SPACE:
        tally[SOCIAL_STEPS] += _ONE


@function
def _tally_standstill(velocity, arrived, tally, p):
    """Count the steps in which every driving robot stands, and the deadlocks."""
    standing = True
    for i in range(arrived.shape[0]):
        speed_squared = velocity[i, 0] * velocity[i, 0] + velocity[i, 1] * velocity[i, 1]
        if not arrived[i] and not speed_squared < STANDING_SPEED * STANDING_SPEED:
            standing = False
    for i in range(arrived.shape[0]):
        if not arrived[i]:
            tally[i, STILL_STEPS] = tally[i, STILL_STEPS] + _ONE if standing else _ZERO
            tally[i, DEADLOCKS] += tally[i, STILL_STEPS] == p.deadlock_steps


@function
def _finish_step(state, e, p, displacement, human_gap, contact, reward, parts, route_progress):
    """Update arrivals and the end of the episode, and write the reward of the step."""
    position, goal, arrived = state.robot_position, state.robot_goal, state.arrived
    state.clock[e] += 1
    collided = False
    newly_arrived = 0
    all_arrived = True
    _tally_standstill(state.robot_velocity[e], arrived[e], state.tally[e], p)
    for i in range(displacement.shape[0]):
        ends = contact[i] != 0 and p.terminate_on_collision
        dx, dy = goal[e, i, 0] - position[e, i, 0], goal[e, i, 1] - position[e, i, 1]
        reached = not ends and math.sqrt(dx * dx + dy * dy) < p.robot_radius
        newly_arrived += not arrived[e, i] and reached
        all_arrived = all_arrived and (arrived[e, i] or reached)
        collided = collided or ends
    team_arrived = all_arrived and newly_arrived > 0
    for i in range(displacement.shape[0]):
        hit, driving = contact[i] != 0, not arrived[e, i]
        dx, dy = goal[e, i, 0] - position[e, i, 0], goal[e, i, 1] - position[e, i, 1]
        distance = math.sqrt(dx * dx + dy * dy)
        dx, dy = dx + displacement[i, 0], dy + displacement[i, 1]
        progress = math.sqrt(dx * dx + dy * dy) - distance
        progress = route_progress(state, e, i, progress, p)
        reached = driving and not (hit and p.terminate_on_collision) and distance < p.robot_radius
        terms = step_reward_parts(
            hit, reached, team_arrived, driving, human_gap[i], progress, distance, p
        )
        for k in range(len(terms)):
            parts[k, e, i] = terms[k]
        reward[e, i] = sum_of_parts(terms)
        arrived[e, i] = arrived[e, i] or reached
    state.terminated[e] = collided or all_arrived
    state.truncated[e] = not state.terminated[e] and state.clock[e] >= p.time_limit_steps
