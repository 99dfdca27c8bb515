"""The columns of `State.human_social`; it has none without reactions and groups."""

SOCIAL = (
    "reaction",  # how the person reacts to robots, a value of `mrsan.Reaction`
    "elapsed",  # steps since the person noticed a robot for the first time; 0: not yet
    "group",  # number of the first person of the group; -1: it belongs to none
)
REACTION, ELAPSED, GROUP = range(3)
NO_GROUP = -1
