"""The training loop in one process: cases, folders, and going on bit for bit."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import torch

from mrsan import ConfigurationError, Scenario
from samarl.policies.card import LAST
from samarl.training.config import MAX_SEEDS, TrainerConfig
from samarl.training.curriculum import CurriculumStage
from samarl.training.run_dir import STATE, RunDir
from samarl.training.trainer import Trainer
from tests.learning import PPO_NUMBERS, crowded, policy_numbers

STAGES = [
    CurriculumStage(6, 0.0, 0.5, scenario=Scenario(humans=3, humans_min=0, robots=2)),
    CurriculumStage(6, 0.5, 1.0, 0.0, 1.0, 0.75, crowded(robots=2)),
    CurriculumStage(4, 0.0, 1.0, 0.5, 1.0, 0.5, Scenario(humans=3, robots=2, fov_degrees=90.0)),
]


def trainer(folder: Path, stages: list[CurriculumStage] = STAGES, **numbers: Any) -> Trainer:
    algorithm = {"name": "mappo", **PPO_NUMBERS, **numbers.pop("algorithm", {})}
    policy = numbers.pop("policy", policy_numbers())
    config: dict[str, Any] = {
        "steps": 10**6,
        "rollout": 12,
        "seed": 0,
        "threads": 1,
        "validate_every": 10**6,
        "validation_cases": 1,
        "save_every": 10**6,
        "ema_decay": 0.9,
    }
    trainer_config = TrainerConfig(**{**config, **numbers})
    return Trainer(folder, trainer_config, policy, algorithm, stages, "test")


def rounds(of: Trainer, number: int) -> Trainer:
    of.algorithm.set_progress(of.steps_done / of.config.steps)
    for _ in range(number):
        row = of.round()
        of.progress.rows.append(
            {key: value for key, value in row.items() if key.startswith("losses")}
        )
    return of


# That encoders resume from their memory is tested in `test_encoder.py`, of each of them.
@pytest.mark.parametrize("encoder", ["spatio_temporal", "gru", "set_pool"])
def test_a_run_goes_on_bit_for_bit_with_worlds_that_are_taken_back(
    encoder: str, tmp_path: Path
) -> None:
    numbers: dict[str, Any] = {"policy": policy_numbers(encoder=encoder), "steps": 900}
    whole = rounds(trainer(tmp_path / "whole", **numbers), 7)
    whole.save()
    cut = rounds(trainer(tmp_path / "cut", **numbers), 5)
    assert sum(int((~c.not_restarted).sum()) for c in cut.collectors) > 0
    cut.save()
    shutil.copytree(tmp_path / "cut", tmp_path / "again")
    rounds(cut, 1)  # and is killed here
    again = trainer(tmp_path / "again", **numbers)
    assert again.steps_done == cut.steps_done - 12 * 10
    rounds(again, 2).save()
    for name in (LAST,):
        files = [(tmp_path / run / name).read_bytes() for run in ("whole", "again")]
        assert files[0] == files[1]
    assert whole.progress.rows == again.progress.rows
    assert (tmp_path / "again" / STATE).is_file()


def test_a_seed_that_would_share_cases_with_another_is_refused(tmp_path: Path) -> None:
    for seed in (MAX_SEEDS, 2**63 - 1, -1):
        with pytest.raises(ConfigurationError, match=rf"^trainer\.seed .*{seed}\b.*0") as error:
            trainer(tmp_path / "run", seed=seed)
        assert "\n" not in str(error.value)
    assert not (tmp_path / "run").exists()
    trainer(tmp_path / "run", seed=MAX_SEEDS - 1)


def test_no_two_worlds_of_a_run_play_the_same_cases(tmp_path: Path) -> None:
    narrow = Scenario(humans=1, robots=1, fov_degrees=90.0)
    stages = [
        CurriculumStage(2500, scenario=Scenario(humans=1, robots=1)),
        CurriculumStage(1700, midway_start_probability=0.5, scenario=narrow),
        CurriculumStage(30, scenario=Scenario(humans=1, robots=1)),
    ]
    policy = policy_numbers("flat", "gru")
    cases: list[int] = []
    for seed in (0, 1):
        seed_trainer = trainer(tmp_path / str(seed), stages, seed=seed, rollout=1, policy=policy)
        for collector in seed_trainer.collectors:
            cases += collector.world.state.case.tolist()
            if collector.crowd is not None:
                cases += collector.crowd.world.state.case.tolist()
    assert len(cases) == 2 * (2500 + 2 * 1700 + 30)
    assert len(set(cases)) == len(cases)


def test_two_trainings_cannot_share_a_folder(tmp_path: Path) -> None:
    first = RunDir(tmp_path / "run")
    with pytest.raises(ConfigurationError, match=r"^run_dir .*run'") as error:
        trainer(tmp_path / "run")
    assert "\n" not in str(error.value)
    first.release()
    RunDir(tmp_path / "run").release()


def test_a_folder_of_another_configuration_is_refused(tmp_path: Path) -> None:
    first_trainer = trainer(tmp_path)
    first_trainer.save()
    first_trainer.run_dir.release()
    with pytest.raises(ConfigurationError, match=r"^algorithm\.epochs .*2.*run_dir"):
        trainer(tmp_path, algorithm={"epochs": 2})
    stages = [replace(STAGES[0], worlds=7), *STAGES[1:]]
    with pytest.raises(ConfigurationError, match=r"^curriculum\.stages\[0\]\.worlds .*7.* 6 "):
        trainer(tmp_path, stages)
    with pytest.raises(ConfigurationError, match=r"^trainer\.steps .*1.* 1000000"):
        trainer(tmp_path, steps=1)


def test_a_device_that_cannot_compute_is_refused(tmp_path: Path) -> None:
    for device in ("meta", "mkldnn", "xla", "hpu", "cuda:99", "gpu", ""):
        with pytest.raises(ConfigurationError, match=rf"^trainer\.device .*'{device}'") as error:
            trainer(tmp_path, device=device)
        assert "\n" not in str(error.value)


def test_the_saved_policy_is_the_mean_of_the_weights_after_each_update(tmp_path: Path) -> None:
    averaging_trainer, weights = trainer(tmp_path, ema_decay=0.75), []
    for _ in range(3):
        averaging_trainer.round()
        weights.append({k: v.clone() for k, v in averaging_trainer.policy.state_dict().items()})
    for name, value in averaging_trainer.averaged_policy.state_dict().items():
        mean = weights[0][name]
        for after in weights[1:]:
            mean = 0.75 * mean + 0.25 * after[name]
        torch.testing.assert_close(value, mean)
    assert any(
        not torch.equal(v, weights[-1][k])
        for k, v in averaging_trainer.averaged_policy.state_dict().items()
    )
