"""Policies small enough for tests."""

from typing import Any

import torch

from samarl.policies.checkpoint import make_policy
from samarl.policies.policy import Policy

ENCODERS: dict[str, dict[str, Any]] = {
    "spatio_temporal": {"width": 8, "heads": 2, "history": 3, "features": 8},
    "gru": {"width": 8, "features": 8},
    "set_pool": {"width": 8, "features": 8},
    "structural_rnn": {"embedding": 8, "edge": 8, "node": 8, "attention": 8, "features": 8},
}
SHARED = {
    "num_parameter_sets": 1,
    "hidden": 8,
    "track_time": 1.0,
    "perimeter_below_fov": 180.0,
    "round_radius": 7.0,
}
WAYPOINTS = {
    "macro_steps": 4,
    "waypoint_ahead": 2.0,
    "waypoint_range": 2.0,
    "waypoint_progress": 1.5,
    "local_goal": True,
    "arrival_bonus": 5.0,
}


def small_policy(
    name: str = "hierarchical",
    encoder: str = "spatio_temporal",
    action_size: int = 3,
    **numbers: Any,
) -> Policy:
    """A policy with random weights, the same every time."""
    torch.manual_seed(0)
    config = SHARED | (WAYPOINTS if name == "hierarchical" else {}) | numbers
    config["encoder"] = {"name": encoder, **ENCODERS[encoder]}
    return make_policy(name, config, action_size)
