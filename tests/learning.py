"""Small policies, and what they learn from."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import torch
from tensordict import TensorDict
from torch import Tensor

from mrsan import Scenario
from samarl.algorithms import ALGORITHMS
from samarl.algorithms.advantages import streams
from samarl.algorithms.ppo import PPO
from samarl.observations.features import empty_frames
from samarl.observations.frames import FeatureSizes
from samarl.policies.checkpoint import make_policy
from samarl.policies.policy import LOCAL, Policy
from samarl.policies.stochastic import ActionEvaluation, StochasticPolicy
from samarl.rollout import Rollout
from samarl.training.collector import RolloutCollector
from samarl.training.config import TrainerConfig
from samarl.training.curriculum import CurriculumStage

SCENARIO = Scenario(humans=4, robots=2, fov_degrees=120.0, time_limit=5.0)
ENCODERS: dict[str, dict[str, Any]] = {
    "spatio_temporal": {"width": 16, "heads": 2, "history": 4, "features": 16},
    "gru": {"width": 16, "features": 16},
    "structural_rnn": {"embedding": 16, "edge": 16, "node": 16, "attention": 8, "features": 16},
    "temporal_spatial_graph": {
        "embedding": 16,
        "edge": 16,
        "node": 16,
        "attention": 8,
        "heads": 2,
        "features": 16,
    },
    "pairwise": {"width": 16},
    "set_pool": {"width": 16, "features": 16},
    "social_attention": {"embedding": 16, "interaction": 8},
}
POLICIES: dict[str, dict[str, Any]] = {
    "flat": {},
    "squashed": {},
    "lookahead": {
        "discount": 0.9,
        "turns": 5,
        "speeds": 5,
        "directions": 16,
    },
    "hierarchical": {
        "macro_steps": 4,
        "waypoint_ahead": 2.0,
        "waypoint_range": 2.0,
        "waypoint_progress": 1.5,
        "local_goal": True,
        "arrival_bonus": 18.75,
    },
}
PPO_NUMBERS: dict[str, Any] = {
    "learning_rate": 1e-3,
    "epochs": 1,
    "minibatches": 2,
    "discount": 0.95,
    "macro_discount": 0.9,
    "gae_lambda": 0.8,
    "clip_epsilon": 0.2,
    "entropy_coefficient": 0.01,
    "macro_entropy_coefficient": 0.01,
    "critic_coefficient": 0.5,
    "max_gradient_norm": 1.0,
    "advantage_filter_fraction": 1.0,
    "action_limit_penalty": 0.01,
    "std_start": 1.0,
    "std_end": 0.1,
    "critic_width": 8,
    "critic_features": 8,
    "shield_coefficient": 0.0,
    "teacher": None,
    "teacher_coefficient": 0.0,
    "teacher_end": 1.0,
    "path_penalty": 0.0,
    "macro_std": 0.0,
}
VALUE_NUMBERS: dict[str, Any] = {
    "learning_rate": 1e-3,
    "imitation": 0.5,
    "epsilon_start": 0.5,
    "epsilon_end": 0.1,
    "epsilon_share": 0.4,
    "replay": 1000,
    "learning_starts": 16,
    "batch": 16,
    "updates": 4,
    "max_gradient_norm": 10.0,
}
SOFT_NUMBERS: dict[str, Any] = {
    "learning_rate": 1e-3,
    "discount": 0.95,
    "temperature_start": 0.02,
    "target_rate": 0.01,
    "policy_delay": 2,
    "replay": 2000,
    "learning_starts": 100,
    "batch": 8,
    "updates": 4,
    "max_gradient_norm": 10.0,
    "critic": "attention",
    "critic_width": 16,
    "critic_heads": 2,
    "robots": 3,
    "team_reward": True,
}


def policy_numbers(
    name: str = "hierarchical",
    encoder: str = "spatio_temporal",
    encoder_numbers: dict[str, Any] | None = None,
    **changes: Any,
) -> dict[str, Any]:
    """As of a YAML file."""
    shared = {
        "num_parameter_sets": 1,
        "hidden": 16,
        "track_time": 2.0,
        "perimeter_below_fov": 180.0,
        "round_radius": 7.0,
        "encoder": encoder_numbers or {"name": encoder, **ENCODERS[encoder]},
    }
    return {"name": name, **shared, **POLICIES[name], **changes}


def policy(
    name: str = "hierarchical",
    encoder: str = "spatio_temporal",
    gain: float = 1.0,
    scenario: Scenario | None = None,
    **changes: Any,
) -> Policy:
    """A policy whose means depend on the input `gain` times as much as they do at first."""
    torch.manual_seed(0)
    numbers = policy_numbers(name, encoder, **changes)
    sizes = None if scenario is None else FeatureSizes.of(empty_frames(scenario))
    model = make_policy(numbers.pop("name"), numbers, 3, sizes)
    with torch.no_grad():
        for networks in model.networks:
            for head in networks.heads.values():
                head.body[-1].weight.mul_(gain)
    return model


def trainer_config(steps: int, rollout: int) -> TrainerConfig:
    """One that neither validates nor saves before the end."""
    return TrainerConfig(
        steps=steps,
        rollout=rollout,
        seed=0,
        threads=1,
        validate_every=10**6,
        validation_cases=1,
        save_every=10**6,
        ema_decay=0.9,
    )


def algorithm(of: Policy, name: str = "mappo", **changes: Any) -> PPO:
    """What trains it."""
    ppo = ALGORITHMS[name].cls(of, ALGORITHMS.config({"name": name, **PPO_NUMBERS, **changes}))
    assert isinstance(ppo, PPO)
    return ppo


def collector(
    of: Policy,
    worlds: int = 12,
    steps: int = 10,
    scenario: Scenario = SCENARIO,
    **stage: Any,
) -> RolloutCollector:
    """What collects rollouts with it, with the true state."""
    return RolloutCollector(
        CurriculumStage(worlds, scenario=scenario, **stage),
        of,
        steps,
        0,
        uses_global_state=True,
    )


def crowded(**changes: Any) -> Scenario:
    """Where untrained policies collide."""
    return replace(SCENARIO, **{"humans": 10, "circle_radius": 4.0, **changes})


def choices(
    of: StochasticPolicy, rollout: Rollout
) -> dict[str, tuple[ActionEvaluation, Tensor, Tensor]]:
    """The evaluation of what each level did, the stored log-probability and the sequence."""
    steps, n = rollout.steps, rollout.robots
    acts = streams(steps).acts.transpose(1, 2)
    length = acts.shape[2]
    flat = acts.reshape(-1, length).nonzero()
    row, step = flat[:, 0], flat[:, 1]
    at = (row // n, step, row % n)
    decisions, stored = {}, {}
    waypoints = steps["agents"].get("waypoint_features")
    for level in of.levels:
        keys = ("agents",) if level == LOCAL else ("agents", level)
        index = torch.arange(len(row))
        if level != LOCAL:
            index = steps[(*keys, "decision_mask")][at].nonzero().squeeze(1)
        of_level = tuple(number[index] for number in at)
        batch = {"index": index, "action": steps[(*keys, "action")][of_level]}
        if level == LOCAL:
            batch["previous_noise"] = steps["agents", "previous_noise"][of_level]
            batch["noise_correlation"] = torch.full((len(index), 1), rollout.correlation)
        decisions[level] = TensorDict(batch, [len(index)])
        stored[level] = (steps[(*keys, "sample_log_prob")][of_level], of_level[0])
    with torch.no_grad():
        evaluations = of.evaluate(
            rollout.sequences(torch.arange(len(steps))),
            row * (length + 1) + step,
            None if waypoints is None else waypoints[at],
            decisions,
        )
    return {level: (evaluations[level], *stored[level]) for level in of.levels}
