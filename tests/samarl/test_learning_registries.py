"""Every name that YAML files may say: composed, trained for two rounds, saved and loaded."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from hydra import compose, initialize_config_dir
from hydra.core.config_store import ConfigStore
from hydra.core.hydra_config import HydraConfig
from omegaconf import OmegaConf

from mrsan import Scenario, World
from samarl.agents.learned import DeployedPolicy
from samarl.algorithms import ALGORITHMS
from samarl.commands.train import settings_in
from samarl.configuration import register_schemas
from samarl.encoders import ENCODERS
from samarl.files import find_folder
from samarl.policies.card import LAST
from samarl.policies.checkpoint import load_policy
from samarl.policies.policy import POLICIES
from samarl.registry import Registry
from samarl.training.run import build_trainer
from samarl.training.settings import train_schema

KINDS: dict[str, Registry[Any]] = {"encoder": ENCODERS, "policy": POLICIES, "algorithm": ALGORITHMS}
STAGES = (
    "curriculum.stages=[{worlds: 3, failure_restart_probability: 0.5, noise_correlation: 0.5,"
    "scenario: {humans: 3, robots: 2}}]"
)
SMALL = [
    STAGES,
    "trainer.rollout=4",
    "trainer.steps=24",
    "trainer.threads=1",
    "trainer.validation_cases=1",
]
VALUES = "policy=lookahead encoder=pairwise algorithm=value_learning algorithm.learning_starts=4"
PPO = "algorithm.minibatches=2 algorithm.epochs=1"
SOFT = (
    "policy=squashed encoder=temporal_spatial_graph algorithm=soft_actor_critic "
    "algorithm.learning_starts=8 algorithm.updates=2 algorithm.batch=2"
)
TOGETHER = {
    "policy=lookahead": VALUES,
    "algorithm=value_learning": VALUES,
    "policy=squashed": SOFT,
    "algorithm=soft_actor_critic": SOFT,
}
"""What only works with others; everything else works with the defaults."""


VARIANTS = {"goal_hidden": "hierarchical"}
"""Files with other settings of what the file under its own name also describes."""


@pytest.fixture(autouse=True)
def conf(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """The folder of YAML files, and no command line left by a command in this process."""
    monkeypatch.setattr(HydraConfig.instance(), "cfg", None)
    register_schemas()
    ConfigStore.instance().store(name="train_schema", node=train_schema())
    with initialize_config_dir(str(find_folder("conf")), version_base="1.3"):
        yield


@pytest.mark.parametrize("kind", KINDS)
def test_every_name_has_a_file_and_every_file_a_name(kind: str) -> None:
    files = list((find_folder("conf") / kind).glob("*.yaml"))
    assert {path.stem for path in files} - VARIANTS.keys() == set(KINDS[kind])
    for path in files:
        values = OmegaConf.to_container(
            compose("train", [f"{kind}={path.stem}"])[kind], resolve=True
        )
        assert isinstance(values, dict)
        assert values["name"] == VARIANTS.get(path.stem, path.stem)
        KINDS[kind].config({str(key): value for key, value in values.items()})  # complete


@pytest.mark.parametrize(
    "name", sorted(path.stem for path in (find_folder("conf") / "experiment").glob("*.yaml"))
)
def test_every_experiment_begins(name: str, tmp_path: Path) -> None:
    overrides = [f"experiment={name}", f"run_dir={tmp_path}/run", "trainer.device=cpu"]
    trainer = build_trainer(settings_in(compose("train", overrides)), "test")
    assert trainer.steps_done == 0


@pytest.mark.parametrize(
    "choice",
    [f"{kind}={name}" for kind, registry in KINDS.items() for name in registry]
    + ["policy.num_parameter_sets=2", "encoder=gru policy.num_parameter_sets=2 algorithm=ippo"]
    + [
        f"{SOFT} {other}"
        for other in (
            "policy.num_parameter_sets=2",
            "encoder=social_attention",
            "encoder=social_attention algorithm.critic=concatenation algorithm.robots=2",
            "encoder=spatio_temporal",
            "algorithm.team_reward=false",
        )
    ],
)
def test_every_name_trains_and_its_checkpoint_drives_as_before(choice: str, tmp_path: Path) -> None:
    alone = choice if SOFT in choice else f"{choice} {PPO}"
    choices = TOGETHER.get(choice, alone).split()
    overrides = [*SMALL, *choices, f"run_dir={tmp_path}/run"]
    trainer = build_trainer(settings_in(compose("train", overrides)), "test")
    before = {key: value.clone() for key, value in trainer.policy.state_dict().items()}
    trainer.algorithm.set_progress(0.0)
    for _ in range(2):
        row = trainer.round()
        assert all(np.isfinite(value) for value in row.values()), row
    assert any(not torch.equal(v, before[k]) for k, v in trainer.policy.state_dict().items())
    trainer.save()
    loaded, card = load_policy(tmp_path / "run" / LAST)
    assert card.policy == trainer.policy_name
    scenario = Scenario(humans=3, robots=2)
    one, two = (DeployedPolicy(p.eval(), scenario) for p in (trainer.averaged_policy, loaded))
    worlds = World(scenario, 2)
    observation = worlds.reset([0, 1])
    for _ in range(3):
        actions = one.act(observation)
        np.testing.assert_array_equal(actions, two.act(observation))
        observation = worlds.step(actions).observation
