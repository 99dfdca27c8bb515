"""The vector environment of Stable-Baselines3 against the worlds themselves."""

import numpy as np
import pytest
from stable_baselines3 import PPO
from stable_baselines3.common.vec_env import VecMonitor, VecNormalize

from mrsan import ActionError, Episodes, Layout, Observation, Outcome, Scenario, World, social_score
from mrsan.metrics import episodes_of
from mrsan.sb3_env import SB3VecEnv

E, N = 4, 2
SCENARIO = Scenario(
    robots=N, humans=5, circle_radius=3.0, goal_distance=2.0, time_limit=4.0, fov_degrees=180.0
)
WALLED = Scenario(robots=1, humans=2, layout=Layout.doorway, lidar_rays=12, time_limit=4.0)


@pytest.mark.parametrize("scenario", [SCENARIO, WALLED], ids=["open", "walled"])
def test_every_robot_of_every_world_is_an_environment(scenario: Scenario) -> None:
    """Worlds that are reset by hand as soon as they end see and earn the same."""
    robots = scenario.robots
    envs, world = SB3VecEnv(scenario, worlds=E), World(scenario, E)
    envs.seed(20)
    observation, expected = envs.reset(), world.reset(20 + np.arange(E))
    rng = np.random.default_rng(0)
    ends = {"terminated": 0, "truncated": 0}
    for _ in range(50):
        actions = rng.uniform(-1, 1, (E * robots, 3)).astype(np.float32)
        actions[:, 0] = 1.0
        observation, reward, done, infos = envs.step(actions)
        step = world.step(actions.reshape(E, robots, 3))
        expected, ended = step.observation, step.terminated | step.truncated
        np.testing.assert_array_equal(reward.reshape(E, robots), step.reward)
        np.testing.assert_array_equal(
            done.reshape(E, robots), np.repeat(ended, robots).reshape(E, robots)
        )
        arrived = [info["arrived"] for info in infos]
        np.testing.assert_array_equal(np.reshape(arrived, (E, robots)), world.state.arrived)
        for e in np.flatnonzero(ended):
            record = episodes_of(world.state, scenario, np.arange(E) == e)
            for n in range(robots):
                info = infos[robots * e + n]
                _check_ending(info, record, n)
                assert info["TimeLimit.truncated"] == (step.truncated[e] and not step.terminated[e])
                for key, value in _not_empty(expected).items():
                    np.testing.assert_array_equal(info["terminal_observation"][key], value[e, n])
            ends["truncated" if step.truncated[e] else "terminated"] += 1
        for row in np.flatnonzero(~done):
            assert infos[row].keys() == {"arrived"}
        if ended.any():
            expected = world.reset(worlds=ended)
        for key, value in _not_empty(expected).items():
            np.testing.assert_array_equal(observation[key].reshape(value.shape), value)
    assert min(ends.values()) > 0


def _not_empty(observation: Observation) -> dict[str, np.ndarray]:
    """The arrays of an observation; a single robot has none of team-mates."""
    return {key: value for key, value in observation.arrays().items() if value.size}


def _check_ending(info: dict, record: Episodes, robot: int) -> None:
    assert info["is_success"] == record.success[0]
    assert info["outcome"] == Outcome(int(record.outcome[0, robot])).name
    assert info["social_score"] == social_score(record)[0, robot]


def test_seeds_choose_cases_and_later_resets_the_next_episodes() -> None:
    envs = SB3VecEnv(worlds=3, robots=2, humans=1)
    envs.reset()
    drawn = envs.world.state.case.copy()
    assert (np.diff(drawn) == 1).all()
    envs.reset()
    assert envs.world.state.case.tolist() == drawn.tolist()
    assert envs.world.state.episode.tolist() == [1, 1, 1]
    envs.seed(7)
    envs.reset()
    assert envs.world.state.case.tolist() == [7, 8, 9]
    assert envs.world.state.episode.tolist() == [0, 0, 0]


def test_stable_baselines_learns_through_its_own_wrappers() -> None:
    envs = VecNormalize(VecMonitor(SB3VecEnv(SCENARIO, worlds=E)), norm_obs=False)
    numbers = {"n_steps": 16, "batch_size": 64}
    learner = PPO("MultiInputPolicy", envs, device="cpu", seed=0, **numbers)
    learner.learn(20 * E * N)
    assert learner.num_timesteps >= 20 * E * N
    assert len(learner.ep_info_buffer) == len(learner.ep_success_buffer) > 0
    assert max(info["l"] for info in learner.ep_info_buffer) <= 16  # 4 s


def test_pictures_and_invalid_actions() -> None:
    envs = SB3VecEnv(worlds=2, robots=1, humans=1, render_mode="rgb_array")
    envs.reset()
    assert envs.render().shape == (1024, 512, 3)
    with pytest.raises(ActionError, match=r"robot 0 in world 1 .* must lie in \[-1, 1\]"):
        envs.step(np.array([[0, 0, 0], [0, 0, 1.5]]))
    with pytest.raises(AttributeError, match="no environments with a method 'close_door'"):
        envs.env_method("close_door")
    assert envs.env_is_wrapped(VecMonitor) == [False, False]
    assert SB3VecEnv(worlds=2).get_attr("render_mode", 0) == [None]
