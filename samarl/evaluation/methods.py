"""Methods: agents with settings, as rows of tables name them, and their labels for readers.

`cadrl shield=true` is the agent `cadrl` of `conf/agent/` with `agent.shield=true`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import yaml

from mrsan import ConfigurationError
from samarl.evaluation.summary import Row

_LABELS = {
    "cadrl": "CADRL",
    "masac": "MASAC",
    "mlga2c": "MLGA2C",
    "model_predictive": "Motion-primitive planner",
    "model_predictive predictor=recurrent": "Motion-primitive planner, learned prediction",
    "msa3c": "MSA3C",
    "msa3c_one_frame": "MSA3C without TSG",
    "msa3cpred": "MSA3CPred",
    "msa3cpred track_velocity=true": "MSA3CPred, tracked",
    "msa3cpred_concatenation": "MSA3CPred, concatenating critics",
    "msa3cpred_f5": "MSA3CPred, 5 m",
    "orca": "ORCA",
    "perimeter": "Around the crowd",
    "right_of_way": "Right of way",
    "right_of_way central=true": "Right of way, central (privileged)",
    "right_of_way macro_level=enter": "Right of way, everybody enters",
    "right_of_way macro_level=random": "Right of way, random",
    "right_of_way macro_level=right_of_way_macro": "Right of way, learned",
    "right_of_way macro_level=ablation_intents": "Right of way, learned without intents",
    "right_of_way macro_level=ablation_priorities": "Right of way, learned without priorities",
    "samarl": "SAMARL, shielded",
    "samarl checkpoint=samarl_first_half": "SAMARL, first half, shielded",
    "samarl checkpoint=samarl_first_half right_of_way=rule": "SAMARL, first half, rule, shielded",
    "samarl right_of_way=null": "SAMARL without right of way, shielded",
    "samarl right_of_way=rule": "SAMARL, rule, shielded",
    "samarl_10p3r": "SAMARL-10p3r, shielded",
    "samarl_circle": "One level, circle, shielded",
    "samarl_flat": "One level, shielded",
    "samarl_flat checkpoint=samarl_flat_first_half": "One level, first half, shielded",
    "samarl_general": "SAMARL-General, shielded",
    "samarl_places": "SAMARL-Places, shielded",
    "samarl_places right_of_way=right_of_way_macro": (
        "SAMARL-Places, learned right of way, shielded"
    ),
    "samarl_places right_of_way=rule": "SAMARL-Places, right of way, shielded",
    "samarl_planned": "SAMARL-Planned, shielded",
    "samarl_ppo": "SAMARL-PPO, shielded",
    "samarl_srnn": "SAMARL-SRNN, shielded",
    "samarl_transformer": "SAMARL-Transformer, shielded",
    "samarl_transformer checkpoint=ablation_cross_modal": (
        "SAMARL-Transformer without cross-modal attention, shielded"
    ),
    "samarl_transformer checkpoint=ablation_graph": (
        "SAMARL-Transformer without graph convolution, shielded"
    ),
    "samarl_transformer checkpoint=ablation_history": (
        "SAMARL-Transformer without history, shielded"
    ),
    "samarl_transformer checkpoint=ablation_local_critics": (
        "SAMARL-Transformer with local critics, shielded"
    ),
    "samarl_transformer checkpoint=ablation_one_block": (
        "SAMARL-Transformer with one block, shielded"
    ),
    "samarl_transformer track_velocity=true": "SAMARL-Transformer, tracked, shielded",
    "samarl_waypoints": "SAMARL-Waypoints, shielded",
    "samarl_waypoints checkpoint=samarl_waypoints_and_rule right_of_way=rule": (
        "Waypoints and rule, shielded"
    ),
    "samarl_waypoints waypoints=first": "SAMARL-Waypoints, first waypoint, shielded",
    "samarl_waypoints waypoints=random": "SAMARL-Waypoints, random waypoints, shielded",
    "samarl_waypoints waypoints=shuffled": "SAMARL-Waypoints, shuffled waypoints, shielded",
    "sarl": "SARL",
    "social_force": "Social force",
    "social_force_places": "Social force for walled environments",
    "straight": "Straight",
}
_SHIELDED = ", shielded"


def method_name(entry: Any) -> tuple[str, str | None]:
    """Return the method of an entry of `agents`, and its label if the entry has one.

    It is `NAME`, `NAME SETTING=VALUE ...`, or `{agent: NAME, SETTING: VALUE, label: LABEL}`.

    Raises:
        ConfigurationError: it is none of these.
    """
    if isinstance(entry, str):
        return " ".join(entry.split()) if "=" in entry else entry, None
    if not isinstance(entry, Mapping) or "agent" not in entry:
        raise ConfigurationError(
            f"agents has {entry!r:.60}; it must be a name, or a mapping with the name as `agent`"
        )
    settings = {str(key): value for key, value in entry.items() if key not in ("agent", "label")}
    words = [f"{key}={_text(value)}" for key, value in settings.items()]
    return " ".join([str(entry["agent"]), *words]), entry.get("label")


def split_method(method: str) -> tuple[str, dict[str, Any]]:
    """Return the agent of a method, which may be a path with blanks, and its settings."""
    words = method.split(" ")
    count = len(words)
    while count > 1 and "=" in words[count - 1]:
        count -= 1
    settings = dict(word.split("=", 1) for word in words[count:])
    return " ".join(words[:count]), {key: yaml.safe_load(text) for key, text in settings.items()}


def method_words(method: str) -> list[str]:
    """Return the words that select a method on a command line."""
    agent, settings = split_method(method)
    return [f"agent={agent}", *(f"agent.{key}={_text(value)}" for key, value in settings.items())]


def method_of_policy(policy: str) -> str:
    """Return the method that drives with an included policy by its name."""
    words = {f"checkpoint={policy}", f"macro_level={policy}"}
    return next((method for method in _LABELS if words & set(method.split())), policy)


def is_ablation(method: str) -> bool:
    """Return whether a method is an included agent with other waypoints, weights or choices."""
    settings = split_method(method)[1]
    choices = str(settings.get("macro_level"))
    return (
        not settings.keys().isdisjoint(("waypoints", "checkpoint"))
        or choices in ("random", "enter")
        or choices.startswith("ablation_")
    )


def label_of(method: str) -> str:
    """Return the name of a method for readers; that of a custom agent is its own."""
    if method.endswith(" shield=true"):
        return label_of(method.removesuffix(" shield=true") + " shield=false") + _SHIELDED
    if method.endswith(" shield=false"):
        return label_of(method.removesuffix(" shield=false")).removesuffix(_SHIELDED)
    return _LABELS.get(method, method)


def labelled(rows: Sequence[Row]) -> list[Row]:
    """Return rows whose methods have their labels as names."""
    return [row | {"method": label_of(row["method"])} for row in rows]


def _text(value: Any) -> str:
    """Return a value as in YAML, on one line."""
    return yaml.safe_dump(value, default_flow_style=True, width=10**6).splitlines()[0]
