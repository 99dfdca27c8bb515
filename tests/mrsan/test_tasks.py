"""Named tasks: what happens in them never changes, and every interface plays the same."""

import hashlib

import gymnasium
import numpy as np
import pytest
import torch
from tensordict import TensorDict

from mrsan import TASKS, ConfigurationError, Scenario, World
from mrsan.pettingzoo_env import PettingZooEnv
from mrsan.tasks import IDS, find_task
from mrsan.torchrl_env import TorchRLEnv

STEPS, CASES = 100, np.arange(4)
# Whoever changes a number raises the version of the task: published results cite the id.
DIGESTS = {
    "mrsan/SAMARL-90-3-v0": "4d2e4de97b6bc959",
    "mrsan/SAMARL-90-5-v0": "eadafec17000c794",
    "mrsan/SAMARL-360-5-v0": "c851031586dd0bf7",
    "mrsan/SAMARL-360-3-v0": "b5ca31b16f1c5bfb",
    "mrsan/MSA3C-5p3r-v0": "1706995ccc75dff5",
    "mrsan/MSA3C-10p3r-v0": "9fd3dc800e15270b",
    "mrsan/MSA3C-20p3r-v0": "465862be54fa2ba6",
    "mrsan/Crossing-v0": "f987726dfeac2bc5",
    "mrsan/Opposite-v0": "526238c12907a30b",
    "mrsan/Square-v0": "99e9c2edd23df9d7",
    "mrsan/Doorway-v0": "1dd4dd6479ab3d6c",
    "mrsan/Corridor-v0": "d786875235b26303",
    "mrsan/Intersection-v0": "b39093dd9f27b460",
    "mrsan/Corner-v0": "a00872b3a68e317d",
    "mrsan/Rooms-v0": "96c4b7353562d337",
    "mrsan/Pillars-v0": "478f85258c974266",
    "mrsan/NarrowDoorway-v0": "d76e298e757f840b",
    "mrsan/NarrowCorridor-v0": "29632f0d9efc30df",
}


def actions(step: int, *shape: int) -> np.ndarray:
    """Return actions in [-1, 1] that every processor computes alike; they tend to accelerate."""
    numbers = np.arange(np.prod(shape)).reshape(shape) * 7919 + step * 104_729
    return np.clip((numbers % 2001 - 800) / 1000, -1, 1).astype(np.float32)


def digest(scenario: Scenario) -> str:
    """Return a digest of 100 steps to a millimetre: where all are, what they see, the rewards."""
    world = World(scenario, len(CASES), auto_reset=True)
    world.reset(CASES)
    sha = hashlib.sha256()
    for t in range(STEPS):
        step = world.step(actions(t, len(CASES), scenario.robots, scenario.action_size))
        s = world.state
        seen = step.observation.arrays().values()
        for array in (s.robot_position, s.human_position, s.episode, step.reward, *seen):
            rounded = np.round(array.astype(np.float64), 3) + 0.0  # without negative zeros
            sha.update(rounded.tobytes())
    return sha.hexdigest()[:16]


def test_what_happens_in_a_task_never_changes() -> None:
    digests = {task.id: digest(task.scenario) for task in TASKS.values()}
    assert digests == DIGESTS


def test_the_digest_sees_a_changed_number() -> None:
    task = find_task("mrsan/SAMARL-360-3-v0")
    changed = Scenario(**task.fields, human_safety_space=0.26)
    assert digest(changed) != DIGESTS[task.id]
    dearer = Scenario(**task.fields, reward={"collision": -0.26})
    assert digest(dearer) != DIGESTS[task.id]


def test_a_task_is_the_same_in_all_libraries() -> None:
    name, case = "mrsan/Doorway-v0", 3
    scenario = IDS[name].scenario
    world = World(scenario)
    expected = world.reset([case])
    single, vector = gymnasium.make(name), gymnasium.make_vec(name, num_envs=2)
    zoo, rl = PettingZooEnv(name), TorchRLEnv(name, worlds=2)
    seen, batch = single.reset(seed=case)[0], vector.reset(seed=case)[0]
    separate = zoo.reset(seed=case)[0]
    tensors = rl.reset(TensorDict({"case": torch.tensor([case, case + 1])}, [2]))
    for t in range(8):
        for key in ("ego", "humans"):
            array = expected.arrays()[key][0]
            np.testing.assert_array_equal(seen[key], array)
            np.testing.assert_array_equal(batch[key][0], array)
            np.testing.assert_array_equal(np.stack([o[key] for o in separate.values()]), array)
            np.testing.assert_array_equal(tensors["agents", "observation", key][0], array)
        assert single.observation_space.contains(seen)
        action = 0.2 * actions(t, 2, scenario.robots, scenario.action_size)
        step = world.step(action[:1])
        expected = step.observation
        seen, reward, *_ = single.step(action[0])
        batch, rewards, *_ = vector.step(action)
        separate, alone, *_ = zoo.step(dict(zip(zoo.agents, action[0], strict=True)))
        tensors["agents", "action"] = torch.from_numpy(action)
        tensors = rl.step(tensors)["next"]
        assert reward == rewards[0] == step.reward[0].mean(dtype=np.float64)
        assert list(alone.values()) == step.reward[0].tolist()
        assert tensors["agents", "reward"][0, :, 0].tolist() == step.reward[0].tolist()


def test_a_team_ends_as_one_in_gymnasium() -> None:
    vector = gymnasium.make_vec("mrsan/SAMARL-360-3-v0", num_envs=2, time_limit=1.0)
    vector.reset(seed=0)
    for _ in range(4):
        *_, truncated, info = vector.step(np.zeros(vector.action_space.shape, np.float32))
    assert truncated.all()
    assert info["outcome"].tolist() == ["timeout timeout timeout"] * 2
    assert not info["is_success"].any()
    assert not info["arrived"].any()


def test_a_task_that_does_not_exist() -> None:
    with pytest.raises(ConfigurationError, match=r"scenario is 'doorwy'.*did you mean doorway"):
        PettingZooEnv("doorwy")
