"""The features of an observation: their order stands here and nowhere else.

The numbers are plain integers and slices, so compiled kernels can use them as well.
"""

# What a robot knows of itself, `ego` [..., 11], in its body frame:
EGO_FEATURES = (
    "goal_x",  # the goal seen from the robot, m
    "goal_y",
    "velocity_x",  # own velocity, m/s
    "velocity_y",
    "origin_x",  # the origin of the map seen from the robot (its own position), m
    "origin_y",
    "heading_cos",  # the heading in the world frame
    "heading_sin",
    "radius",  # m
    "preferred_speed",  # m/s
    "time",  # share of the time limit used
)
GOAL_X, GOAL_Y, VELOCITY_X, VELOCITY_Y, ORIGIN_X, ORIGIN_Y = range(6)
HEADING_COS, HEADING_SIN, RADIUS, PREFERRED_SPEED, TIME = range(6, 11)
GOAL, VELOCITY, ORIGIN = slice(0, 2), slice(2, 4), slice(4, 6)

# What it sees of another agent, relative to itself:
OTHER_FEATURES = ("x", "y", "velocity_x", "velocity_y", "radius")
OTHER_X, OTHER_Y, OTHER_VELOCITY_X, OTHER_VELOCITY_Y, OTHER_RADIUS = range(5)
OTHER_POSITION, OTHER_VELOCITY = slice(0, 2), slice(2, 4)
