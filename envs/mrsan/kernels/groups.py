"""Groups of people who walk abreast or stand and talk, and robots that pass through them.

A group is named by the number of its first member; its members have consecutive numbers. The
forces are those of Moussaid et al. (2010), as changes of the preferred velocity.
"""

import math

import numpy as np

from mrsan.kernels import function, rng
from mrsan.kernels.contact import closest_approach
from mrsan.kernels.habits import stands
from mrsan.kernels.social_state import GROUP, NO_GROUP
from mrsan.kernels.tally import INTRUSION_STEPS

MOST_MEMBERS = 4

# Draws of the stream rng.GROUP.
_START, _SIZE, _TALKS, _ANGLE, CENTRE_X, CENTRE_Y = range(6)

_ZERO = np.float32(0.0)
_ONE = np.float32(1.0)
_TINY = np.float32(1e-6)
_TWO = np.float32(2.0)
_PI = np.float32(math.pi)
_TWO_PI = np.float32(2.0 * math.pi)


@function
def draw_group(social, j, key, settings):
    """Draw the group of human `j` and write it to `social` [M, 3]; the ones before have theirs."""
    people, group = social.shape[0], NO_GROUP
    if j > 0 and social[j - 1, GROUP] != NO_GROUP:
        before = social[j - 1, GROUP]
        if j - before < size_of_group(key, before, people, settings):
            group = before
    if group == NO_GROUP and j < people - 1:
        if rng.uniform(key, rng.GROUP, j, 0, _START) < settings.group_start_probability:
            group = j
    social[j, GROUP] = group


@function
def size_of_group(key, group, people, settings):
    """Return how many members a group has: what is drawn, or fewer at the end of the `people`."""
    choices = np.float32(settings.group_size_max - settings.group_size_min + 1)
    drawn = settings.group_size_min + int(rng.uniform(key, rng.GROUP, group, 0, _SIZE) * choices)
    return min(min(drawn, settings.group_size_max), people - group)


@function
def talks(key, group, settings):
    """Return whether a group stands and talks."""
    return rng.uniform(key, rng.GROUP, group, 0, _TALKS) < settings.group_standing_share


@function
def talking_radius(size, p, settings):
    """Return the radius of the circle of a group that talks, m."""
    between = (
        p.human_radius_max + p.human_radius_max + max(settings.group_gap, p.human_safety_space)
    )
    if size < 2:
        return settings.group_talk_radius
    return max(settings.group_talk_radius, between / (_TWO * math.sin(_PI / np.float32(size))))


@function
def offset_in_circle(key, group, k, size, radius):
    """Return where member `k` of a group that talks begins, relative to its centre, m."""
    share = rng.uniform(key, rng.GROUP, group, 0, _ANGLE) + np.float32(k) / np.float32(size)
    return radius * math.cos(_TWO_PI * share), radius * math.sin(_TWO_PI * share)


@function
def group_velocity(state, e, j, present, preferred_x, preferred_y, speed, p, settings):
    """Return the preferred velocity (x, y) of a member of a group, m/s.

    Args:
        state: the worlds.
        e: which of them.
        j: number of the member.
        present: numbers of the people who are present.
        preferred_x: its preferred velocity without a group, x (m/s).
        preferred_y: its preferred velocity without a group, y (m/s).
        speed: its preferred speed (m/s).
        p: the scenario's parameters.
        settings: those of `mrsan.crowds.social_settings`.
    """
    position, social, key = state.human_position[e], state.human_social[e], state.key[e]
    group, x, y = social[j, GROUP], position[j, 0], position[j, 1]
    members, leader = 0, -1
    centre_x = centre_y = _ZERO
    for row in range(present.shape[0]):
        k = present[row]
        if social[k, GROUP] == group:
            leader = k if leader < 0 else leader
            centre_x, centre_y = centre_x + position[k, 0], centre_y + position[k, 1]
            members += 1
    if members < 2:
        return preferred_x, preferred_y
    dx, dy = centre_x / np.float32(members) - x, centre_y / np.float32(members) - y
    distance = math.sqrt(dx * dx + dy * dy)
    dx, dy = dx / max(distance, _TINY), dy / max(distance, _TINY)
    if talks(key, group, settings):
        away = (distance - talking_radius(members, p, settings)) / settings.group_relaxation_time
        return away * dx, away * dy
    if j != leader:
        preferred_x, preferred_y = _follow(state, e, j, leader, speed, p)
    vx, vy = _side_step(state, e, j, present, preferred_x, preferred_y, settings)
    slowing = _slowing(preferred_x, preferred_y, dx, dy, settings)
    vx, vy = vx + preferred_x * slowing, vy + preferred_y * slowing
    if distance > settings.group_spread * np.float32(members - 1):
        vx, vy = vx + settings.group_attraction * dx, vy + settings.group_attraction * dy
    return vx, vy


@function
def _follow(state, e, j, leader, speed, p):
    """Take over the leader's goal; return the velocity (x, y) parallel to the leader's, m/s."""
    goal, position = state.human_goal[e], state.human_position[e]
    goal[j, 0], goal[j, 1] = goal[leader, 0], goal[leader, 1]
    dx, dy = goal[leader, 0] - position[leader, 0], goal[leader, 1] - position[leader, 1]
    scale = speed / max(math.sqrt(dx * dx + dy * dy), _TINY)
    if stands(state.key[e], leader, state.clock[e], p):
        scale = _ZERO
    return dx * scale, dy * scale


@function
def _slowing(ahead_x, ahead_y, to_centre_x, to_centre_y, settings):
    """Return the factor of the speed of a member who turns the head towards the group's centre.

    The force -gaze * angle * velocity and the drive to the preferred velocity balance at this
    share of it; `angle` is how far the centre lies outside the field of view.
    """
    speed = math.sqrt(ahead_x * ahead_x + ahead_y * ahead_y)
    cosine = (ahead_x * to_centre_x + ahead_y * to_centre_y) / max(speed, _TINY)
    angle = math.acos(min(max(cosine, -_ONE), _ONE)) - settings.group_half_gaze_fov
    return _ONE / (_ONE + settings.group_gaze * max(angle, _ZERO))


@function
def _side_step(state, e, j, present, ahead_x, ahead_y, settings):
    """Return the velocity (x, y) with which a member steps aside from those it walks in line with.

    The repulsion acts across the walking direction: along it, members would queue up.
    """
    position, radius, social = state.human_position[e], state.human_radius[e], state.human_social[e]
    speed = max(math.sqrt(ahead_x * ahead_x + ahead_y * ahead_y), _TINY)
    left_x, left_y, left = -ahead_y / speed, ahead_x / speed, _ZERO
    for row in range(present.shape[0]):
        k = present[row]
        if k == j or social[k, GROUP] != social[j, GROUP]:
            continue
        dx, dy = position[j, 0] - position[k, 0], position[j, 1] - position[k, 1]
        across = dx * left_x + dy * left_y
        if abs(across) < radius[j] + radius[k] + settings.group_gap:
            to_left = across > _ZERO or (across == _ZERO and j > k)
            left += settings.group_repulsion if to_left else -settings.group_repulsion
    return left * left_x, left * left_y


@function
def count_intrusions(state, e, p, settings):
    """Count the step for every driving robot that is in the hull of a group, or too near to it."""
    limit = settings.group_intrusion_distance
    for i in range(state.robot_heading.shape[1]):
        x, y = state.robot_position[e, i, 0], state.robot_position[e, i, 1]
        if not state.arrived[e, i] and _intrudes(state, e, x, y, limit):
            state.tally[e, i, INTRUSION_STEPS] += _ONE


@function
def _intrudes(state, e, x, y, limit):
    """Return whether (x, y) is in the convex hull of the members of a group, or within `limit`.

    The hull of up to four points is covered by the triangles of three of them, and its border by
    the segments between two.
    """
    position = state.human_position[e]
    for a in range(position.shape[0]):
        for b in range(a + 1, _end_of_group(state, e, a)):
            if not _together(state, e, a, b):
                continue
            ax, ay = position[a, 0] - x, position[a, 1] - y
            bx, by = position[b, 0] - x, position[b, 1] - y
            if closest_approach(ax, ay, bx, by) <= limit:
                return True
            for c in range(b + 1, _end_of_group(state, e, a)):
                cx, cy = position[c, 0] - x, position[c, 1] - y
                if _together(state, e, a, c) and _surround(ax, ay, bx, by, cx, cy):
                    return True
    return False


@function
def _end_of_group(state, e, a):
    """Return the number after the last person who may be in the group of human `a`."""
    group = state.human_social[e, a, GROUP]
    return 0 if group == NO_GROUP else min(group + MOST_MEMBERS, state.human_radius.shape[1])


@function
def _together(state, e, a, b):
    """Return whether two humans are present and in the same group."""
    social, present = state.human_social[e], state.human_present[e]
    return present[a] and present[b] and social[a, GROUP] == social[b, GROUP]


@function
def _surround(ax, ay, bx, by, cx, cy):
    """Return whether the origin lies inside a triangle."""
    ab, bc, ca = ax * by - ay * bx, bx * cy - by * cx, cx * ay - cy * ax
    return (ab >= _ZERO and bc >= _ZERO and ca >= _ZERO) or (
        ab <= _ZERO and bc <= _ZERO and ca <= _ZERO
    )
