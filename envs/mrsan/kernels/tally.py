"""The columns of `State.tally`, which accumulates each robot's statistics until it arrives.

They share one array because every array of the state costs time wherever kernels pass the state.
Counts of steps are exact up to 16 million.
"""

TALLY = (
    "path_length",  # m
    "closest_human",  # smallest surface distance at any moment of a step, m; inf: none
    "driven_steps",
    "close_steps",  # ending within 0.45 m of the nearest human
    "personal_steps",  # ending between 0.45 and 1.2 m
    "social_steps",  # ending between 1.2 and 3.6 m
    "standing_steps",  # ending slower than 0.05 m/s
    "jerk_sum",  # sum of the norms, m/s^3
    "heading_change",  # sum of absolute turns, rad
    "min_time_to_collision",  # smallest time to collision with a human after a step, s; inf: none
    "ran_into",  # contacts in which the human did not approach faster than the robot
    "contacts",  # contacts begun; half for each of two moving robots
    "comfort_steps",  # ending within 0.25 m of the nearest human
    "still_steps",  # consecutive steps until now in which every driving robot stood
    "deadlocks",  # times that they reached `mrsan.parameters.DEADLOCK_TIME`
    "intrusion_steps",  # ending in the hull of a group of people, or too near to it
)
PATH_LENGTH, CLOSEST_HUMAN, DRIVEN_STEPS, CLOSE_STEPS, PERSONAL_STEPS, SOCIAL_STEPS = range(6)
STANDING_STEPS, JERK_SUM, HEADING_CHANGE, SOONEST_COLLISION, RAN_INTO = range(6, 11)
CONTACTS, COMFORT_STEPS, STILL_STEPS, DEADLOCKS, INTRUSION_STEPS = range(11, 16)
