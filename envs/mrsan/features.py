"""The features of an observation; this is the only place that defines their order.

Indices are plain integers and slices, so compiled kernels can use them as well.
"""

# Features of the robot itself, `ego` [..., 11], in its body frame:
EGO_FEATURES = (
    "goal_x",  # position of the goal, m
    "goal_y",
    "velocity_x",  # own velocity, m/s
    "velocity_y",
    "origin_x",  # position of the origin of the map, m
    "origin_y",
    "heading_cos",  # heading in the world frame
    "heading_sin",
    "radius",  # m
    "preferred_speed",  # m/s
    "time",  # elapsed share of the time limit
)
GOAL_X, GOAL_Y, VELOCITY_X, VELOCITY_Y, ORIGIN_X, ORIGIN_Y = range(6)
HEADING_COS, HEADING_SIN, RADIUS, PREFERRED_SPEED, TIME = range(6, 11)
GOAL, VELOCITY, ORIGIN, HEADING = slice(0, 2), slice(2, 4), slice(4, 6), slice(6, 8)

# Features of another agent, relative to the robot:
OTHER_FEATURES = ("x", "y", "velocity_x", "velocity_y", "radius")
OTHER_X, OTHER_Y, OTHER_VELOCITY_X, OTHER_VELOCITY_Y, OTHER_RADIUS = range(5)
OTHER_POSITION, OTHER_VELOCITY = slice(0, 2), slice(2, 4)
