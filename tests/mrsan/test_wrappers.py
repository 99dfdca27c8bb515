"""The three wrappers pass their libraries' checks and give the same numbers."""

import warnings

import gymnasium
import numpy as np
import pytest
import torch
from gymnasium.utils.env_checker import check_env
from pettingzoo.test import parallel_api_test
from tensordict import TensorDict
from torchrl.envs.utils import check_env_specs

from mrsan import (
    ActionError,
    Kinematics,
    Layout,
    Scenario,
    Step,
    TeamPerception,
    World,
)
from mrsan.gymnasium_env import GymnasiumEnv, GymnasiumVectorEnv
from mrsan.pettingzoo_env import PettingZooEnv
from mrsan.torchrl_env import TorchRLEnv

CASES = np.array([3, 50, 7])
SCENARIOS = {
    "one robot": Scenario(robots=1, humans=4),
    "noisy": Scenario(robots=3, humans=4, fov_degrees=90.0, position_noise=0.1),
    "told": Scenario(robots=3, humans=4, fov_degrees=90.0, team_perception=TeamPerception.tracks),
    "unicycles": Scenario(robots=2, humans=0, kinematics=Kinematics.unicycle),
    "walled": Scenario(robots=2, humans=4, layout=Layout.doorway, lidar_rays=12),
}


@pytest.mark.parametrize("humans", [0, 5])
def test_gymnasiums_own_check(humans: int) -> None:
    env = gymnasium.make("mrsan/SocialNavigation-v0", humans=humans)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        warnings.filterwarnings("ignore", message=".*no screen.*")
        check_env(env.unwrapped)


@pytest.mark.parametrize("scenario", SCENARIOS.values(), ids=SCENARIOS.keys())
def test_pettingzoos_own_check(scenario: Scenario) -> None:
    parallel_api_test(PettingZooEnv(scenario), num_cycles=60)


@pytest.mark.parametrize("worlds", [1, 4])
@pytest.mark.parametrize("scenario", SCENARIOS.values(), ids=SCENARIOS.keys())
def test_torchrls_own_check(scenario: Scenario, worlds: int) -> None:
    check_env_specs(TorchRLEnv(scenario, worlds=worlds, seed=0))


@pytest.mark.parametrize("scenario", SCENARIOS.values(), ids=SCENARIOS.keys())
def test_all_wrappers_play_a_case_alike(scenario: Scenario) -> None:
    rng = np.random.default_rng(0)
    shape = (30, len(CASES), scenario.robots, scenario.action_size)
    actions = rng.uniform(-1, 1, shape).astype(np.float32)
    world, batch = World(scenario, 3), TorchRLEnv(scenario, worlds=3)
    singles = [PettingZooEnv(scenario) for _ in CASES]
    gyms = [GymnasiumEnv(scenario) for _ in CASES if scenario.robots == 1]
    expected = world.reset(CASES)
    td = batch.reset(TensorDict({"case": torch.from_numpy(CASES)}, [3]))
    parallel = [env.reset(seed=int(case))[0] for env, case in zip(singles, CASES, strict=True)]
    single = [env.reset(seed=int(case))[0] for env, case in zip(gyms, CASES, strict=False)]
    for t in range(len(actions)):
        seen = expected.arrays()
        assert set(td["agents", "observation"].keys()) == set(seen)
        for key, value in seen.items():
            np.testing.assert_array_equal(td["agents", "observation", key].numpy(), value)
            for e in range(3):
                for i in range(scenario.robots):
                    if value.shape[2]:
                        np.testing.assert_array_equal(parallel[e][f"robot_{i}"][key], value[e, i])
                if gyms and value.shape[2]:
                    np.testing.assert_array_equal(single[e][key], value[e, 0])
        step = world.step(actions[t])
        expected = step.observation
        td = batch.step(td.set(("agents", "action"), torch.from_numpy(actions[t])))["next"]
        np.testing.assert_array_equal(td["agents", "reward"][..., 0].numpy(), step.reward)
        for name, part in step.reward_parts._asdict().items():
            batch_part = td["agents", "reward_parts", name]
            np.testing.assert_array_equal(batch_part[..., 0].numpy(), part)
        np.testing.assert_array_equal(td["terminated"][:, 0].numpy(), step.terminated)
        np.testing.assert_array_equal(td["truncated"][:, 0].numpy(), step.truncated)
        arrived = world.state.arrived
        np.testing.assert_array_equal(td["success"][:, 0].numpy(), arrived.all(1))
        np.testing.assert_array_equal(td["agents", "active_mask"][..., 0].numpy(), ~arrived)
        for e, env in enumerate(singles):
            if not env.agents:  # its episode is over: the world stands still
                continue
            joint = {agent: actions[t, e, i] for i, agent in enumerate(env.agents)}
            parallel[e], reward, terminated, truncated, infos = env.step(joint)
            assert list(reward.values()) == step.reward[e].tolist()
            assert set(terminated.values()) == {bool(step.terminated[e])}
            assert set(truncated.values()) == {bool(step.truncated[e])}
            assert [info["arrived"] for info in infos.values()] == arrived[e].tolist()
            for i, info in enumerate(infos.values()):
                assert info["reward_parts"] == parts_of(step, e, i)
        for e, env in enumerate(gyms):
            single[e], reward, terminated, truncated, info = env.step(actions[t, e, 0])
            assert reward == step.reward[e, 0]
            assert info["reward_parts"] == parts_of(step, e, 0)
            assert (terminated, truncated) == (step.terminated[e], step.truncated[e])


def parts_of(step: Step, world: int, robot: int) -> dict[str, float]:
    parts = step.reward_parts._asdict()
    return {name: part[world, robot].item() for name, part in parts.items()}


def test_without_a_seed_the_next_episode_of_the_case_begins() -> None:
    world = World(Scenario(robots=1))
    world.reset([9])
    following = world.reset().ego[0, 0]
    env, parallel = GymnasiumEnv(), PettingZooEnv(robots=1)
    env.reset(seed=9)
    parallel.reset(seed=9)
    np.testing.assert_array_equal(env.reset()[0]["ego"], following)
    np.testing.assert_array_equal(parallel.reset()[0]["robot_0"]["ego"], following)
    batch = TorchRLEnv(robots=1, seed=9)
    batch.reset()
    np.testing.assert_array_equal(batch.reset()["agents", "observation", "ego"][0, 0], following)


def test_torchrl_resets_only_the_worlds_it_is_told_to() -> None:
    env = TorchRLEnv(robots=2, humans=3, worlds=4, seed=20)
    td = env.reset()
    for _ in range(3):
        td = env.step(td.set(("agents", "action"), torch.full((4, 2, 3), 0.3)))["next"]
    mask = torch.tensor([[False], [True], [False], [True]])
    partial = env.reset(td.clone().set("_reset", mask))
    ego, before = (x["agents", "observation", "ego"] for x in (partial, td))
    assert torch.equal(ego[[0, 2]], before[[0, 2]])
    assert (ego[[1, 3], :, 10] == 0).all()
    assert env.world.state.episode.tolist() == [0, 1, 0, 1]
    assert env.world.state.case.tolist() == [20, 21, 22, 23]
    chosen = TensorDict({"case": torch.tensor([0, 77, 0, 0])}, [4])
    env.reset(chosen.set("_reset", torch.tensor([[False], [True], [False], [False]])))
    assert env.world.state.case.tolist() == [20, 77, 22, 23]


def test_torchrl_has_one_reward_and_its_parts() -> None:
    env = TorchRLEnv(robots=2, humans=3, worlds=3, seed=0)
    assert env.reward_keys == [("agents", "reward")]
    td = env.rollout(20, break_when_any_done=False)
    parts = td["next", "agents", "reward_parts"]
    assert torch.equal(sum(parts.values()), td["next", "agents", "reward"])
    assert parts["progress"].any()
    assert not any(part[:, 0].any() for part in td["agents", "reward_parts"].values())


def test_pettingzoo_ends_with_all_agents_and_says_how() -> None:
    env = PettingZooEnv(robots=2, humans=0, time_limit=1.0)
    env.reset(seed=1)
    for _ in range(4):
        assert env.agents == ["robot_0", "robot_1"]
        *_, infos = env.step({agent: np.zeros(3, np.float32) for agent in env.agents})
    assert env.agents == []
    assert infos["robot_0"]["outcome"] == "timeout"
    assert infos["robot_0"]["social_score"] == 0


BAD = {
    "nan": (np.array([0, np.nan, 0]), r"every element must lie in \[-1, 1\]"),
    "infinite": (np.array([np.inf, 0, 0]), r"every element must lie in \[-1, 1\]"),
    "too large": (np.array([0, 0, 1.01]), r"every element must lie in \[-1, 1\]"),
    "too short": (np.zeros(2), r"has shape \(2,\); it must have \(3,\)"),
    "too deep": (np.zeros((1, 3)), r"has shape \(1, 3\); it must have \(3,\)"),
}


@pytest.mark.parametrize("bad", BAD)
def test_bad_actions_are_refused(bad: str) -> None:
    action, message = BAD[bad]
    env = GymnasiumEnv()
    env.reset(seed=0)
    with pytest.raises(ActionError, match=message):
        env.step(action)
    parallel = PettingZooEnv(robots=2)
    parallel.reset(seed=0)
    with pytest.raises(ActionError, match=message):
        parallel.step({"robot_0": np.zeros(3), "robot_1": action})
    vector = GymnasiumVectorEnv(2)
    vector.reset(seed=0)
    batch = np.stack([np.zeros_like(action), action])
    with pytest.raises(ActionError, match=r"must lie in|have shape .*must have \(2, 3\)"):
        vector.step(batch)
    if action.shape == (3,):  # the shape of a TensorDict is TorchRL's to check
        torchrl = TorchRLEnv(robots=2, worlds=2, seed=0)
        td = torchrl.reset()
        joint = torch.zeros(2, 2, 3)
        joint[1, 1] = torch.from_numpy(action)
        with pytest.raises(ActionError, match=r"action of robot 1 in world 1 .* must lie in"):
            torchrl.step(td.set(("agents", "action"), joint))


def test_gymnasium_makes_it_by_its_id() -> None:
    env = gymnasium.make("mrsan/SocialNavigation-v0", humans=5)
    observation, _ = env.reset(seed=4)
    assert observation["humans"].shape == (5, 5)
    assert env.observation_space.contains(observation)
    vector = gymnasium.make_vec("mrsan/SocialNavigation-v0", num_envs=3, humans=5)
    batch, _ = vector.reset(seed=4)
    assert isinstance(vector.unwrapped, GymnasiumVectorEnv)
    np.testing.assert_array_equal(batch["ego"][0], observation["ego"])
    sync = gymnasium.make_vec(
        "mrsan/SocialNavigation-v0", num_envs=3, humans=5, vectorization_mode="sync"
    )
    np.testing.assert_array_equal(sync.reset(seed=4)[0]["ego"], batch["ego"])
