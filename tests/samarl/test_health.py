"""Warnings about training runs that are likely to fail."""

from pathlib import Path

import pytest

from mrsan import Scenario
from samarl.training.curriculum import CurriculumStage
from samarl.training.health import Health
from samarl.training.trainer import Trainer
from tests.learning import PPO_NUMBERS, policy_numbers, trainer_config


def test_each_warning_is_given_once() -> None:
    health = Health()
    fine = {"losses/actor_gradient_norm": 20.0, "losses/local_entropy": -5.0, "charts/success": 0.0}
    assert health.update(fine, 0.4) == []
    (diverges,) = health.update(fine | {"losses/actor_gradient_norm": 2000.0}, 0.45)
    assert "losses/actor_gradient_norm is 2e+03" in diverges
    (entropy,) = health.update(fine | {"losses/local_entropy": -20.0}, 0.46)
    assert "losses/local_entropy is -20" in entropy
    (failing,) = health.update(fine, 0.5)
    assert "no episode has succeeded" in failing
    assert health.update(fine | {"losses/local_entropy": 9.0}, 0.6) == []
    assert list(health.warnings.values()) == [diverges, entropy, failing]


def test_a_resumed_run_knows_what_was_before(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """It succeeded before it was resumed, and its gradients once were too large."""
    config = trainer_config(steps=40, rollout=4)
    stages = [CurriculumStage(2, scenario=Scenario(humans=1, robots=1))]
    policy, algorithm = policy_numbers("flat", "gru"), {"name": "mappo", **PPO_NUMBERS}
    run = Trainer(tmp_path, config, policy, algorithm, stages, "test")
    run.progress.rows.append(
        {"steps": 2.0, "charts/success": 0.1, "losses/actor_gradient_norm": 5000.0}
    )
    run.run()
    shown = capsys.readouterr().err
    assert "no episode has succeeded" not in shown
    assert shown.count("warning about this run: losses/actor_gradient_norm is 5e+03") == 1
