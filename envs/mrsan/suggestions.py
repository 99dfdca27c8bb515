"""Suggestions of names for an unknown one, in error messages."""

from __future__ import annotations

import difflib
import re
from collections.abc import Iterable

_MAX_LISTED = 20  # names in an error message
# Words of other simulators and libraries for the settings of this project.
_ENTITIES = {
    "agent": "robots",
    "human": "humans",
    "ped": "humans",
    "pedestrian": "humans",
    "people": "humans",
    "person": "humans",
    "robot": "robots",
}
_COUNT_WORDS = {"count", "n", "nb", "num", "number", "of"}  # as in n_humans and human_num
_SYNONYMS = {
    "delta_t": "time_step",
    "dt": "time_step",
    "duration": "time_limit",
    "fov": "fov_degrees",
    "gamma": "discount",
    "lr": "learning_rate",
    "max_steps": "time_limit",
    "timestep": "time_step",
}
# Settings of earlier versions, and what they are now: a name, or a name with a value or settings.
RENAMED = {
    "collisions_end": "terminate_on_collision",
    "goal_turn_spread_degrees": "goal_rotation_range_degrees",
    "known_origin": "observe_map_position",
    "lidar_sees": "lidar_targets",
    "local_discount": "discount",
    "model_predictive_recurrent": "model_predictive agent.predictor=recurrent",
    "msa3cpred_transfer": "msa3cpred agent.track_velocity=true",
    "robot_way_max": "route_length_max",
    "robot_way_min": "route_length_min",
    "robots_visible": "crowd_reaction=reciprocal",
    "round_below": "perimeter_below_fov",
    "samarl_anywhere": "samarl",
    "samarl_first_waypoint": "samarl_waypoints agent.waypoints=first",
    "samarl_random_waypoints": "samarl_waypoints agent.waypoints=random",
    "samarl_shuffled_waypoints": "samarl_waypoints agent.waypoints=shuffled",
    "samarl_transfer": "samarl_transformer agent.track_velocity=true agent.shield=false",
    "walls_hide": "walls_occlude",
}


def renamed(name: str, names: Iterable[str]) -> str | None:
    """Return what a setting of an earlier version is now, if that is among `names`."""
    new = RENAMED.get(name)
    for ending, value in (("_unshielded", "false"), ("_shielded", "true")):
        if new is None and name.endswith(ending):
            new = f"{name.removesuffix(ending)} agent.shield={value}"
    return new if new is not None and re.split("[= ]", new)[0] in names else None


def _synonym(name: str) -> str | None:
    """Return this project's word for a name that is common elsewhere."""
    words = [word for word in name.lower().split("_") if word not in _COUNT_WORDS]
    return _ENTITIES.get("_".join(words).removesuffix("s"), _SYNONYMS.get(name.lower()))


def closest_names(name: str, names: Iterable[str], count: int = 3) -> list[str]:
    """Return the names most similar to `name`, best first."""
    ordered = sorted(set(names), key=lambda other: (len(other), other))
    close = difflib.get_close_matches(name, ordered, count, 0.8)
    synonym = [other for other in ordered if other == _synonym(name)]
    longer = [other for other in ordered if other.startswith(name)]
    initials = [
        other for other in ordered if "".join(word[:1] for word in other.split("_")) == name
    ]
    similar = difflib.get_close_matches(name, ordered, count)
    return list(dict.fromkeys([*synonym, *close, *longer, *initials, *similar]))[:count]


def choice_hint(name: str, names: Iterable[str], rest: str = "see --help") -> str:
    """Return a hint which of `names` is meant by an unknown name.

    `rest` is the hint if none is similar and there are too many to list.
    """
    options = sorted(names)
    if new := renamed(name, options):
        return f"it is now {new}"
    if close := closest_names(name, options):
        return f"did you mean {' or '.join(', '.join(close).rsplit(', ', 1))}?"
    return f"it must be one of {', '.join(options)}" if 0 < len(options) <= _MAX_LISTED else rest
