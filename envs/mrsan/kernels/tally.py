"""What happened to a robot while it was on its way: the numbers of `State.tally`, in its order.

They lie in one array, not in one each: every array of the state costs time wherever kernels hand
the state on. Steps are counted exactly up to 16 million.
"""

TALLY = (
    "path_length",  # m
    "closest_human",  # smallest surface distance at any moment of a step, m; inf: none
    "driven_steps",
    "close_steps",  # that ended within 0.45 m of the nearest human
    "personal_steps",  # of the others, within 1.2 m
    "social_steps",  # of the rest, within 3.6 m
    "standing_steps",  # that ended slower than 0.05 m/s
    "jerk_sum",  # of the norm, m/s^3
    "heading_change",  # sum of the turns to either side
    "soonest_collision",  # smallest time to one with a human after a step, s; inf: none
    "ran_into",  # humans it hit that did not come to it faster than it to them
    "contacts",  # how often it began to touch somebody; half for each of two robots that drive
    "comfort_steps",  # that ended within 0.25 m of the nearest human
)
PATH_LENGTH, CLOSEST_HUMAN, DRIVEN_STEPS, CLOSE_STEPS, PERSONAL_STEPS, SOCIAL_STEPS = range(6)
STANDING_STEPS, JERK_SUM, HEADING_CHANGE, SOONEST_COLLISION, RAN_INTO = range(6, 11)
CONTACTS, COMFORT_STEPS = range(11, 13)
