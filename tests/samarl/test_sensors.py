"""Groups of entities and sensors that the package does not know are passed on by their names."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from gymnasium.utils.env_checker import check_env
from torch import Tensor, nn
from torchrl.envs.utils import check_env_specs

from mrsan import (
    ConfigurationError,
    EntitySensor,
    Layout,
    Scenario,
    ValueSensor,
    World,
    register_sensor,
)
from mrsan.fields import number, required
from mrsan.gymnasium_env import GymnasiumEnv
from mrsan.pettingzoo_env import PettingZooEnv
from mrsan.se2 import unrotate_vectors
from mrsan.sensors.registry import SENSORS
from mrsan.torchrl_env import TorchRLEnv
from samarl.agents.learned import Learned
from samarl.encoders import ENCODERS, Encoder
from samarl.export import export_agent
from samarl.observations.features import ADDITIONAL_FEATURES, empty_frames, register_features
from samarl.observations.frames import FeatureSizes, Frames
from samarl.policies.checkpoint import load_policy
from samarl.runtime import Driver, InputError
from samarl.runtime.simulation import as_seen, sensor_readings
from samarl.training.config import TrainerConfig
from samarl.training.curriculum import CurriculumStage
from samarl.training.trainer import Trainer
from tests import learning
from tests.learning import PPO_NUMBERS, policy_numbers

SETTINGS: dict[str, Any] = {"posts": {"number": 5}, "compass": {}}
OTHERS = Scenario(humans=2, robots=2, time_limit=5.0)  # without the sensors


@dataclass
class PostsSettings:
    """Settings of `posts`."""

    number: int = number(4, 1, 64)


class Posts(EntitySensor):
    """Fixed posts on a circle, of which those within the sensing range are observed."""

    def __init__(self, scenario: Scenario, settings: PostsSettings) -> None:
        super().__init__(scenario, settings)
        self.slots, self.features = settings.number, 2
        angle = 2 * np.pi * np.arange(self.slots) / self.slots
        self.position = 3.0 * np.stack([np.cos(angle), np.sin(angle)], -1)

    def observe(
        self, state: Any, worlds: np.ndarray, features: np.ndarray, mask: np.ndarray
    ) -> None:
        offset = self.position - state.robot_position[worlds][:, :, None]
        heading = state.robot_heading[worlds][:, :, None]
        position = unrotate_vectors(offset, np.stack([np.cos(heading), np.sin(heading)], -1))
        in_range = np.linalg.norm(position, axis=-1) <= self.scenario.sensing_range
        features[worlds] = np.where(in_range[..., None], position, 0.0)
        mask[worlds] = in_range


class Compass(ValueSensor):
    """The heading."""

    shape = (2,)

    def observe(self, state: Any, worlds: np.ndarray, values: np.ndarray) -> None:
        heading = state.robot_heading[worlds]
        values[worlds] = np.stack([np.cos(heading), np.sin(heading)], -1)


@dataclass
class SumsConfig:
    """Sizes of `Sums`."""

    features: int = required(2, 64)


class Sums(Encoder):
    """The sum of each group, and the sensors."""

    def __init__(self, config: SumsConfig, sizes: FeatureSizes) -> None:
        super().__init__(config, sizes)
        self.features, self.sizes = config.features, sizes
        inputs = 2 * sizes.ego + sum(sizes.entities.values())
        inputs += sum(int(np.prod(shape)) for shape in sizes.sensors.values())
        self.out = nn.Linear(inputs, config.features)

    def observe(
        self, frames: Frames, is_init: Tensor, state: Any, samples: Tensor | None = None
    ) -> Tensor:
        parts = [frames.entities[group].features.sum(2) for group in self.sizes.entities]
        parts += [frames.sensors[name].flatten(2) for name in self.sizes.sensors]
        scene = torch.cat([frames.ego, *parts], -1).flatten(0, 1)
        return scene if samples is None else scene[samples]

    def read(self, scene: Tensor, query: Tensor) -> Tensor:
        return torch.relu(self.out(torch.cat([query, scene], -1)))


@pytest.fixture(autouse=True)
def scenario(monkeypatch: pytest.MonkeyPatch) -> Iterator[Scenario]:
    """A scenario with both sensors, which are registered while a test runs."""
    monkeypatch.setattr(ENCODERS, "_entries", dict(ENCODERS._entries))
    before = dict(SENSORS), dict(ADDITIONAL_FEATURES)
    register_sensor("posts", PostsSettings)(Posts)
    register_sensor("compass")(Compass)
    register_features("posts")(lambda observed, scenario: torch.cat([observed, observed / 5], -1))
    ENCODERS.register("sums", SumsConfig)(Sums)
    yield replace(OTHERS, sensors=SETTINGS)
    for registry, entries in zip((SENSORS, ADDITIONAL_FEATURES), before, strict=True):
        registry.clear()  # type: ignore[attr-defined]
        registry.update(entries)  # type: ignore[attr-defined]


def train(folder: Path, scenario: Scenario) -> Trainer:
    trainer = Trainer(
        folder,
        TrainerConfig(
            steps=1000,
            rollout=10,
            seed=0,
            threads=1,
            validate_every=1000,
            validation_cases=2,
            save_every=1000,
            ema_decay=0.5,
        ),
        policy_numbers("flat", "sums", encoder_numbers={"name": "sums", "features": 16}),
        {"name": "mappo", **PPO_NUMBERS},
        [CurriculumStage(10, scenario=scenario)],
        "test",
    )
    trainer.run()
    return trainer


def test_every_environment_passes_them_on(scenario: Scenario) -> None:
    arrays = World(scenario, 3).reset().arrays()
    assert arrays["posts"].shape == (3, 2, 5, 2)
    assert arrays["posts_visible"].dtype == np.bool_
    assert arrays["compass"].shape == (3, 2, 2)
    env = TorchRLEnv(scenario, worlds=3, seed=0)
    check_env_specs(env)
    env.set_seed(0)
    np.testing.assert_array_equal(env.reset()["agents", "observation", "posts"], arrays["posts"])
    observations, _ = PettingZooEnv(scenario).reset(seed=0)
    np.testing.assert_array_equal(observations["robot_1"]["posts"], arrays["posts"][0, 1])
    single = GymnasiumEnv(humans=2, sensors={"posts": None, "compass": {}})
    check_env(single, skip_render_check=True)
    assert set(single.reset()[0]) == {
        *("ego", "humans", "humans_visible", "posts", "posts_visible", "compass")
    }


def test_a_policy_is_trained_on_them_and_drives_a_robot_with_them(
    tmp_path: Path, scenario: Scenario
) -> None:
    trainer = train(tmp_path, scenario)
    policy, card = load_policy(tmp_path / "last.safetensors")
    assert policy.sizes == FeatureSizes.of(empty_frames(scenario))
    assert policy.sizes.entities["posts"] == 4
    assert card.sizes["sensors"] == {"compass": [2]}
    encoder: Any = trainer.policy.networks[0].encoder
    learner: Any = trainer.algorithm
    moments = learner.optimiser.state[encoder.out.weight]["exp_avg"]
    ego, agents = policy.sizes.ego, 2 * 10
    of_posts = moments[:, 2 * ego + agents : 2 * ego + agents + 4]
    of_compass = moments[:, 2 * ego + agents + 4 :]
    assert of_posts.abs().amin() > 0.0
    assert of_compass.abs().amin() > 0.0

    agent = Learned(scenario, str(tmp_path / "last.safetensors"))
    export_agent(tmp_path / "policy.onnx", agent, "mine")
    drivers = [Driver.load(tmp_path / "policy.onnx") for _ in range(2)]
    assert drivers[0].sensor_inputs == {
        "posts": ((5, 2), np.float32),
        "posts_known": ((5,), np.bool_),
        "compass": ((2,), np.float32),
    }
    for driver in drivers:
        driver.reset(centre=(0.0, 0.0))  # the frame is that of the world
    world = World(scenario, 1)
    observation = world.reset([0])
    for step in range(5):
        action = agent.act(observation)
        for robot, driver in enumerate(drivers):
            own, detections = as_seen(observation, robot)
            readings = sensor_readings(observation, robot)
            command = driver.step(own, detections, step * scenario.time_step, readings)
            np.testing.assert_allclose(command.action, action[0, robot], atol=1e-4)
        observation = world.step(action).observation


def test_wrong_readings_are_named(tmp_path: Path, scenario: Scenario) -> None:
    train(tmp_path, scenario)
    export_agent(tmp_path / "p.onnx", Learned(scenario, str(tmp_path / "last.safetensors")), "mine")
    driver = Driver.load(tmp_path / "p.onnx")
    observation = World(scenario, 1).reset([0])
    own, detections = as_seen(observation, 0)
    readings = sensor_readings(observation, 0)
    for wrong, words in (
        ({}, ["posts", "[5, 2]"]),
        (readings | {"lidar": [1.0]}, ["lidar", "compass"]),
        (readings | {"compass": [1.0]}, ["compass", "[2]"]),
        (readings | {"compass": [1.0, np.nan]}, ["compass", "nan"]),
        (readings | {"compass": "north"}, ["compass", "north"]),
    ):
        with pytest.raises(InputError) as error:
            driver.step(own, detections, 1.0, wrong)
        assert all(word in str(error.value) for word in words)
    driver.step(own, detections, 1.0, readings)  # nothing was lost


def test_a_policy_that_observes_passages_needs_them() -> None:
    scenario = Scenario(layout=Layout.rooms, humans=2, robots=2, next_passages=2)
    policy = learning.policy("flat", "set_pool", 1.0, scenario)
    assert policy.sizes.entities["passages"] == 12
    policy.check(replace(scenario, next_passages=1))
    with pytest.raises(ConfigurationError, match=r"scenario\.next_passages is 0"):
        policy.check(replace(scenario, next_passages=0))
