"""The parts of a trainer: policy, algorithm and collectors."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from torch import Tensor
from torch.nn.functional import pad

from mrsan import ConfigurationError, Scenario
from samarl.agents import build_agent
from samarl.agents.agent import Agent
from samarl.agents.planners.right_of_way import RightOfWay
from samarl.algorithms import ALGORITHMS
from samarl.algorithms.algorithm import Algorithm
from samarl.configuration import load_method_config
from samarl.launch import per_process, rank, world_size
from samarl.observations.features import empty_frames
from samarl.observations.frames import FeatureSizes
from samarl.policies.checkpoint import load_policy, make_policy
from samarl.policies.policy import Policy
from samarl.training.collector import RolloutCollector
from samarl.training.config import TrainerConfig
from samarl.training.curriculum import CurriculumStage

CASES_PER_SEED = 2**20  # training cases; each world uses two, one of them for `WarmStartCrowd`


def build_policy(settings: Mapping[str, Any], scenario: Scenario) -> Policy:
    """Return a policy with random weights.

    Args:
        settings: `name` and configuration of the policy, with its encoder.
        scenario: of the first stage; its robots and sensors are those of all stages.

    Raises:
        ConfigurationError: a setting is not valid.
    """
    config = {key: value for key, value in settings.items() if key != "name"}
    sizes = FeatureSizes.of(empty_frames(scenario))
    return make_policy(str(settings.get("name")), config, scenario.action_size, sizes)


def load_initial_weights(policy: Policy, path: Path) -> dict[str, Any]:
    """Load the weights of another policy, except its exploration noise.

    A policy of one level may initialise one of two levels, for example: what only the new policy
    has keeps its initial weights, and what only the new policy observes has no effect at first.

    Args:
        policy: its weights are overwritten.
        path: file of a policy with the same sizes, but for such additions.

    Returns:
        The provenance of the weights.

    Raises:
        ConfigurationError: the file is damaged, or its policy has other sizes.
    """
    initial_policy, card = load_policy(path)
    weights = policy.state_dict()
    initial = {
        name: _padded(value, weights[name]) if name in weights else value
        for name, value in initial_policy.state_dict().items()
    }
    if len(initial_policy.networks) != len(policy.networks) or any(
        name not in weights or value.shape != weights[name].shape for name, value in initial.items()
    ):
        raise ConfigurationError(
            f"init_from is {str(path)!r} with {card.config}; its sizes must be those of this run's "
            "policy"
        )
    weights |= {name: value for name, value in initial.items() if "log_std" not in name}
    policy.load_state_dict(weights)
    return {"sha256": card.sha256, **card.provenance}


def _padded(initial: Tensor, weights: Tensor) -> Tensor:
    """Return initial weights [..., I], with zeros for the additional inputs of `weights`."""
    if weights.dim() < 2 or initial.dim() != weights.dim():
        return initial
    return pad(initial, (0, max(weights.shape[-1] - initial.shape[-1], 0)))


def build_algorithm(settings: Mapping[str, Any], policy: Policy) -> Algorithm:
    """Return the algorithm that trains a policy.

    Raises:
        ConfigurationError: a setting is not valid, or there are several processes and the algorithm
            does not support them.
    """
    name = str(settings.get("name"))
    entry = ALGORITHMS[name]
    if world_size() > 1 and not entry.cls.supports_data_parallel:
        supported = [other for other in ALGORITHMS if ALGORITHMS[other].cls.supports_data_parallel]
        raise ConfigurationError(
            f"algorithm.name is {name!r}; with several processes it must be one that averages its "
            f"gradients: {', '.join(supported)}"
        )
    return entry.cls(policy, ALGORITHMS.config(settings))


def build_teacher(name: str | None, scenario: Scenario) -> Agent | None:
    """Return the agent of `conf/agent/` that the policy imitates; None without a name.

    Raises:
        ConfigurationError: there is no such agent, or it cannot drive the robots of the scenario.
    """
    return _build_agent(name, "teacher", scenario)


def build_guide(name: str | None, scenario: Scenario) -> RightOfWay | None:
    """Return the agent of `CurriculumStage.guide`; None without a name.

    Raises:
        ConfigurationError: there is no such agent, or it does not direct drivers.
    """
    field = "curriculum.stages.guide"
    guide = _build_agent(name, field, scenario)
    if guide is None or isinstance(guide, RightOfWay):
        return guide
    raise ConfigurationError(f"{field} is {name!r}; it must be right_of_way")


def _build_agent(name: str | None, field: str, scenario: Scenario) -> Agent | None:
    if name is None:
        return None
    return build_agent(load_method_config(name, field), scenario)


def build_collectors(
    config: TrainerConfig, stages: list[CurriculumStage], policy: Policy, algorithm: Algorithm
) -> list[RolloutCollector]:
    """Return a collector for every stage, with the worlds of this process.

    No two worlds of a training, of all seeds, stages and processes, use the same training case.

    Raises:
        ConfigurationError: there are too many worlds, or their number is not a multiple of the
            number of processes.
    """
    total_worlds = sum(stage.worlds for stage in stages)
    if 2 * total_worlds > CASES_PER_SEED:
        raise ConfigurationError(
            f"curriculum.stages has {total_worlds} worlds; it must have at most "
            f"{CASES_PER_SEED // 2}"
        )
    first_case = config.seed * CASES_PER_SEED
    collectors = []
    for index, stage in enumerate(stages):
        process_stage = per_process(stage, f"curriculum.stages[{index}]", "worlds")
        collectors.append(
            RolloutCollector(
                process_stage,
                policy,
                config.rollout,
                first_case + 2 * process_stage.worlds * rank(),
                algorithm.uses_global_state,
                algorithm.uses_shield_targets,
                build_teacher(stage.teacher or algorithm.teacher, stage.scenario),
                build_guide(stage.guide, stage.scenario),
            )
        )
        first_case += 2 * stage.worlds
    return collectors
