"""Robots that move along paths from elsewhere, such as those of a physics engine."""

from mrsan.kernels import function

# Columns of a path: the robot at one moment, in the world frame.
PATH_COLUMNS = ("x", "y", "velocity_x", "velocity_y", "heading")


@function
def pieces_of_path(path):
    """Return in how many straight pieces robots move."""
    return path.shape[2]


@function
def move_along_path(state, e, i, path, p, remaining, touches_wall):
    """Return the end of a robot's path, and whether it touches a wall; see `move_by_action`.

    Args:
        state: the worlds.
        e: which of them.
        i: which robot.
        path: [E, N, K, 5] `PATH_COLUMNS` at K moments, evenly spaced, the last at the end.
        p: the scenario's parameters.
        remaining: [K, N, 2], written for this robot.
        touches_wall: the function that knows the place.
    """
    last = path.shape[2] - 1
    end_x, end_y = path[e, i, last, 0], path[e, i, last, 1]
    x, y = state.robot_position[e, i, 0], state.robot_position[e, i, 1]
    hits_wall = False
    for k in range(last + 1):
        remaining[k, i, 0], remaining[k, i, 1] = end_x - x, end_y - y
        new_x, new_y = path[e, i, k, 0], path[e, i, k, 1]
        hits_wall = hits_wall or touches_wall(state, e, x, y, new_x - x, new_y - y, p)
        x, y = new_x, new_y
    return end_x, end_y, path[e, i, last, 2], path[e, i, last, 3], path[e, i, last, 4], hits_wall
