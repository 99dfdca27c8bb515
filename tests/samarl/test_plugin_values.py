"""What agents, predictors, features, metrics and policies of users return is checked and named."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from mrsan import (
    ActionError,
    ConfigurationError,
    PluginError,
    Scenario,
    ValueSensor,
    register_sensor,
)
from mrsan.reward import REWARD_TERMS
from mrsan.sensors.registry import SENSORS
from samarl.agents import Agent
from samarl.agents.shielded import Shielded
from samarl.errors import TrainingError
from samarl.evaluation.metrics import Metric
from samarl.evaluation.runner import run_cases
from samarl.evaluation.trajectory import record_episode
from samarl.observations.features import ADDITIONAL_FEATURES, register_features
from samarl.planning.shield import Shield
from samarl.policies.policy import Decision
from samarl.training.curriculum import CurriculumStage
from samarl.training.trainer import Trainer
from tests.learning import PPO_NUMBERS, policy_numbers, trainer_config

SCENARIO = Scenario(humans=3, robots=2)
CASES = np.arange(2)


@pytest.fixture(autouse=True)
def _registries() -> Iterator[None]:
    """What a test registers is forgotten after it."""
    registries: tuple[dict[str, Any], ...]
    registries = SENSORS, ADDITIONAL_FEATURES, REWARD_TERMS
    before = [dict(registry) for registry in registries]
    yield
    for registry, entries in zip(registries, before, strict=True):
        registry.clear()
        registry.update(entries)


@dataclass
class Faulty(Agent):
    """Stands for three steps and then returns something else."""

    fault: Any = None  # from valid actions [E, N, A] to what it returns instead
    steps: int = 0

    def act(self, observation: Any) -> Any:
        self.steps += 1
        action = np.zeros((*observation.ego.shape[:2], 3), np.float32)
        return self.fault(action) if self.steps > 3 else action


def nan_of_robot_1(action: np.ndarray) -> np.ndarray:
    action[-1, 1, 2] = np.nan
    return action


def test_actions_are_refused_with_the_agent_that_chose_them() -> None:
    """Also below a shield, whose compiled code would otherwise read whatever it is given."""
    faults: dict[str, Callable[[np.ndarray], Any]] = {
        r"action of robot 1 in world \d is .*nan.* at step 3": nan_of_robot_1,
        r"shape \(\d, 1, 3\); .*\(\d, 2, 3\)": lambda action: action[:, :1],
        r"shape \(1,\)|not an array": lambda action: None,
        r"robot 0 in world 0 is \[2.0": lambda action: action + 2,
    }
    for words, fault in faults.items():
        for wrap in (False, True):
            agent: Agent = Faulty(SCENARIO, fault)
            if wrap:
                agent = Shielded(SCENARIO, agent, Shield())
            with pytest.raises(ActionError, match=rf"^agent Faulty: .*{words}") as error:
                run_cases(agent, SCENARIO, CASES, 2)
            assert "\n" not in str(error.value)
    with pytest.raises(ActionError, match=r"^agent Faulty: "):
        record_episode(Faulty(SCENARIO, nan_of_robot_1), SCENARIO, 0)


def test_metrics_are_finite_numbers_or_undefined() -> None:
    for value, shown in ((float("nan"), "nan"), ("three", "'three'"), (np.ones(2), "array")):
        metric = Metric(("mine",), "", "", 2, lambda episodes, value=value: value)
        with pytest.raises(PluginError, match=f"metric mine is .*{shown}.*; .*finite"):
            metric.row_fields(None)  # type: ignore[arg-type]
    undefined = Metric(("mine",), "", "", 2, lambda episodes: None)
    assert undefined.row_fields(None) == {"mine": None}  # type: ignore[arg-type]


def trainer(folder: Path, scenario: Scenario, **algorithm: Any) -> Trainer:
    config = trainer_config(steps=64, rollout=4)
    numbers = {"name": "mappo", **PPO_NUMBERS, **algorithm}
    policy = policy_numbers("flat", "gru")
    return Trainer(folder, config, policy, numbers, [CurriculumStage(2, scenario=scenario)], "test")


def test_training_names_policies_teachers_and_features(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    chosen = Decision.action.fget
    with monkeypatch.context() as patch:
        action = property(lambda decision: nan_of_robot_1(chosen(decision).copy()))
        patch.setattr(Decision, "action", action)
        with pytest.raises(ActionError, match=r"^policy \w+: .*robot 1 in world 1 .*at step 0"):
            trainer(tmp_path / "policy", SCENARIO).run()
    imitation = {"teacher": "orca", "teacher_coefficient": 1.0, "teacher_end": 1.0}
    teacher = trainer(tmp_path / "teacher", SCENARIO, **imitation)
    teacher.collectors[0].teacher = Faulty(SCENARIO, nan_of_robot_1, steps=2)
    with pytest.raises(ActionError, match=r"^teacher Faulty: .*robot 1 in world 1 .*at step"):
        teacher.run()

    @register_sensor("compass")
    class Compass(ValueSensor):
        shape = (2,)

        def observe(self, state: Any, worlds: Any, values: Any) -> None:
            values[worlds] = 0.0

    for features, words in (
        (torch.log, r"are -inf for robot 0 in world 0 at index \[0\]"),
        (lambda observed: observed[:1], r"has shape \(1, 2\); it must have \(\d, 2\)"),
    ):
        register_features("compass")(lambda observed, scenario, f=features: f(observed))
        with pytest.raises(PluginError, match=rf"features compass {words}"):
            trainer(tmp_path / "features", replace(SCENARIO, sensors={"compass": {}})).run()


def test_a_gradient_that_is_not_finite_ends_a_run_with_an_error_of_training(
    tmp_path: Path,
) -> None:
    run = trainer(tmp_path, SCENARIO)
    run.round()
    with torch.no_grad():
        next(run.algorithm.parameters()).fill_(np.nan)
    with pytest.raises(TrainingError, match=r"step \d+: .*gradient .*finite") as error:
        run.run()
    assert not isinstance(error.value, ConfigurationError)
    assert "\n" not in str(error.value)
