"""People who follow their recorded tracks, regardless of robots."""

import math

import numpy as np

from mrsan.kernels import function, rng
from mrsan.kernels.layout import draw_route_on_floor

NOT_ASSIGNED = -1
_ZERO = np.float32(0.0)
_FAR = np.float32(np.inf)
_STANDS = np.float32(1.0)  # a person displaced by less during the episode stands, m
_ENTRY_DISTANCE = np.float32(3.0)  # m; nobody appears nearer to a driving robot than this
_TRIES = 64  # attempts after which the required clearance is reduced
_DIRECT = 1024  # attempts after which the length of a route is drawn before its ends
_LEAST_ROOM = 10  # reductions until no clearance is required


@function
def begin_recording(state, e, key, recording, p):
    """Draw the step of the recording at which the episode begins."""
    latest = max(recording.steps - p.time_limit_steps, 0)
    share = rng.uniform(key, rng.RECORDING, 0, 0, 0)
    state.record_step[e] = min(int(share * np.float32(latest + 1)), latest)


@function
def draw_recorded_route(start, goal, key, i, attempt, begin, recording, p):
    """Draw a start that people do not cross soon, and a goal where nobody stands, on the floor.

    Returns:
        Whether this attempt has these properties and its route has a permitted length.
    """
    half_x, half_y = recording.half_size[0], recording.half_size[1]
    direct = attempt >= _DIRECT
    if not draw_route_on_floor(start, goal, key, i, attempt, half_x, half_y, direct, p):
        return False
    share = np.float32(max(_LEAST_ROOM - attempt // _TRIES, 0)) / np.float32(_LEAST_ROOM)
    gap = p.robot_radius + p.human_radius_max + p.spawn_clearance * share
    end = begin + p.time_limit_steps
    for q in range(recording.first.shape[0]):
        if recording.first[q] > end or recording.last[q] < begin:
            continue
        first, last = max(recording.first[q], begin), min(recording.last[q], end)
        first_place, last_place = _place(recording, q, first), _place(recording, q, last)
        dx, dy = last_place[0] - first_place[0], last_place[1] - first_place[1]
        stands = math.hypot(dx, dy) < _STANDS
        for step in range(first, min(last, begin + p.start_clear_time_steps) + 1):
            x, y = _place(recording, q, step)
            if math.hypot(x - start[0], y - start[1]) < gap:
                return False
        dx, dy = first_place[0] - goal[0], first_place[1] - goal[1]
        if stands and math.hypot(dx, dy) < gap:
            return False
    return True


@function
def follow(state, e, recording, p):
    """Free the slots of people whose tracks have ended; assign free slots to the nearest people."""
    position, present = state.human_position[e], state.human_present[e]
    track, entry = state.human_track[e], state.human_entry[e]
    step = state.clock[e]
    now = state.record_step[e] + step
    free = 0
    for j in range(present.shape[0]):
        if present[j] and now >= recording.last[track[j]]:
            present[j], track[j] = False, NOT_ASSIGNED
            entry[j] = step + p.slot_reuse_delay_steps  # robots forget the person meanwhile
        free += not present[j] and entry[j] <= step
    for j in range(present.shape[0]):
        if free == 0:
            return
        if present[j] or entry[j] > step:
            continue
        free -= 1
        q = _nearest(state, e, now, recording)
        if q == NOT_ASSIGNED:
            return
        place, end = _place(recording, q, now), _place(recording, q, recording.last[q])
        present[j], track[j] = True, q
        state.human_radius[e, j] = rng.uniform_between(
            p.human_radius_min, p.human_radius_max, np.uint64(q), rng.HUMAN_TRAITS, 0, 0, 0
        )
        state.human_speed[e, j] = p.human_speed_max
        position[j, 0], position[j, 1] = place[0], place[1]
        following = _place(recording, q, now + 1)
        for k in range(2):
            state.human_velocity[e, j, k] = (following[k] - place[k]) / p.time_step
            state.human_goal[e, j, k] = end[k]


@function
def recorded_velocity(state, e, j, recording, p):
    """Return the velocity that leads human `j` to its recorded position at the next step, m/s."""
    next_step = state.record_step[e] + state.clock[e] + 1
    place = _place(recording, state.human_track[e, j], next_step)
    position = state.human_position[e, j]
    return (place[0] - position[0]) / p.time_step, (place[1] - position[1]) / p.time_step


@function
def _nearest(state, e, now, recording):
    """Return the person without a slot who is nearest to a robot and may enter, or `NOT_ASSIGNED`.

    Tracks begin anywhere, because annotators follow people only within the image. After the first
    step people enter once no driving robot is within 3 m.
    """
    entry_squared = _ENTRY_DISTANCE * _ENTRY_DISTANCE if state.clock[e] > 0 else _ZERO
    nearest, least = NOT_ASSIGNED, _FAR
    for q in range(recording.first.shape[0]):
        if recording.first[q] > now:
            break  # people are ordered by their first step
        if recording.last[q] <= now or _has_a_slot(state, e, q):
            continue
        x, y = _place(recording, q, now)
        enters, nearest_squared = True, _FAR
        for i in range(state.robot_heading.shape[1]):
            dx, dy = state.robot_position[e, i, 0] - x, state.robot_position[e, i, 1] - y
            squared = dx * dx + dy * dy
            nearest_squared = min(nearest_squared, squared)
            enters &= state.arrived[e, i] or squared >= entry_squared
        if enters and nearest_squared < least:
            nearest, least = q, nearest_squared
    return nearest


@function
def _has_a_slot(state, e, q):
    assigned = False
    for j in range(state.human_track.shape[1]):
        assigned = assigned or state.human_track[e, j] == q
    return assigned


@function
def _place(recording, q, step):
    row = recording.row[q] + step - recording.first[q]
    return recording.position[row, 0], recording.position[row, 1]
