"""Training in a custom scenario instead of a curriculum."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from hydra.core.hydra_config import HydraConfig
from omegaconf import DictConfig

from mrsan import ConfigurationError, Scenario
from samarl.commands.train import settings_in
from samarl.configuration import composed, hydra_tree, load_scenario, register_schemas
from samarl.training.curriculum import CurriculumStage
from samarl.training.settings import train_schema
from tests.samarl.test_workflows import run

SHORT = ["trainer.steps=64", "trainer.rollout=4", "trainer.validation_cases=2", "encoder.width=16"]


@pytest.fixture(autouse=True)
def _own_hydra(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(HydraConfig.instance(), "cfg", None)


def training(*words: str) -> DictConfig:
    """The configuration of `samarl-train` with these settings."""
    register_schemas(train_schema=train_schema())
    with hydra_tree():
        config = composed("train", words)
    HydraConfig.instance().set_config(config)
    return config


def stages(*words: str) -> list[CurriculumStage]:
    return settings_in(training(*words)).stages


def test_a_scenario_replaces_those_of_the_curriculum() -> None:
    # At its end circle.yaml has two stages of 96 worlds, with restarts before collisions.
    (stage,) = stages("scenario.humans=5", "scenario.robots=2")
    assert stage == CurriculumStage(192, 0.0, 1.0, 0.0, 0.8, 0.75, Scenario(humans=5, robots=2))
    assert stages("scenario=samarl", "worlds=7")[0].worlds == 7
    # The other settings remain those of an experiment, here 32 worlds without restarts.
    (stage,) = stages("experiment=msa3c", "scenario=20p3r")
    assert stage == CurriculumStage(32, scenario=load_scenario("20p3r"))
    assert len(stages("experiment=msa3c")) == 2
    assert [s.worlds for s in stages()] == [96, 48, 96, 96]


def test_a_stage_may_name_its_scenario() -> None:
    words = "{name: 10p3r, humans: 4, reward: {time: -0.5}}"
    named, unnamed = stages(
        f"curriculum.stages=[{{worlds: 8, scenario: {words}}}, {{worlds: 2, end: 0.5}}]"
    )
    task = load_scenario("10p3r")
    assert named.scenario == replace(task, humans=4, reward=replace(task.reward, time=-0.5))
    assert unnamed.scenario == Scenario()
    (named,) = stages("curriculum.stages=[{worlds: 8, scenario: 10p3r}]")
    assert named.scenario == task
    first, *others = stages("curriculum.stages.0.scenario.fov_degrees=90")
    assert first.scenario == Scenario(humans_min=0, fov_degrees=90.0)
    assert others == stages()[1:]


def test_mistakes_are_named() -> None:
    stage = r"curriculum\.stages\[0\]"
    for words, message in (
        ("scenario.humans=5 curriculum=views", "scenario is set, and curriculum as well"),
        ("worlds=4", "worlds is 4; it must be null without a scenario"),
        ("worlds=0 scenario=mixed", r"worlds is 0; .*\[1, 1e\+06\]"),
        ("curriculum.stages.1.scenario.fov=90", r"stages\[1\]\.scenario: fov is not known; did"),
        ("curriculum.stages=[{worlds:8,scenario:10p}]", rf"{stage}\.scenario: .* mean 10p3r"),
        ("curriculum.stages=[{worlds:8,scenario:10}]", rf"{stage}\.scenario has 10; it must map"),
        ("curriculum.stages=[{}]", rf"{stage}\.worlds has no value"),
    ):
        with pytest.raises(ConfigurationError, match=message):
            stages(*words.split())


def test_the_recipe_of_the_guide(tmp_path: Path) -> None:
    """Train in the scenario of a file, resume, evaluate and draw."""
    (tmp_path / "conf/scenario").mkdir(parents=True)
    (tmp_path / "conf/scenario/lobby.yaml").write_text(
        "defaults: [samarl]\nname: lobby\nlayout: square\nhumans: 4\nrobots: 2\ntime_limit: 5.0\n"
    )
    task = ["--config-dir", "conf", "scenario=lobby"]
    run("train", *task, "policy=flat", "worlds=8", "run_dir=lobby", *SHORT, cwd=tmp_path)
    assert _stages_of(tmp_path / "lobby/last.json") == [(8, "lobby", 4, "Layout.square")]
    # The folder knows its scenario without the file.
    done = run("train", "resume=lobby", "trainer.steps=128", cwd=tmp_path)
    assert "resuming at step 64 of 128" in done.stdout
    assert _stages_of(tmp_path / "lobby/last.json") == [(8, "lobby", 4, "Layout.square")]

    policy = ["agent=samarl_flat", "checkpoint=lobby/best.safetensors"]
    done = run("evaluate", *task, *policy, "evaluation.cases=3", cwd=tmp_path)
    assert "| samarl_flat " in done.stdout
    assert "| lobby " in done.stdout
    run("render", *task, *policy, "case=1", "output=lobby.png", cwd=tmp_path)
    assert (tmp_path / "lobby.png").stat().st_size > 10_000


def _stages_of(card: Path) -> list[tuple[Any, ...]]:
    saved = json.loads(card.read_text(encoding="utf-8"))["provenance"]["configuration"][
        "curriculum"
    ]["stages"]
    names = ("name", "humans", "layout")
    return [(stage["worlds"], *(stage["scenario"][name] for name in names)) for stage in saved]
