"""What others' libraries do with the environments, by their own means."""

from pathlib import Path

import gymnasium
import matplotlib
import matplotlib.pyplot as plt
import numpy as np
import pytest
from gymnasium.wrappers import RecordVideo
from stable_baselines3 import PPO
from stable_baselines3.common.env_checker import check_env
from stable_baselines3.common.env_util import make_vec_env
from torchrl.envs import GymEnv

from mrsan import Scenario, World
from mrsan.gymnasium_env import GymnasiumEnv
from mrsan.pettingzoo_env import PettingZooEnv
from mrsan.rendering import Renderer

NAME = "mrsan/SocialNavigation-v0"


def test_stable_baselines_checks_and_trains_past_a_time_limit() -> None:
    check_env(GymnasiumEnv(humans=5))
    numbers = {"humans": 5, "time_limit": 2.0}
    envs = make_vec_env(NAME, n_envs=2, seed=0, env_kwargs=numbers)
    learner = PPO("MultiInputPolicy", envs, n_steps=16, batch_size=16, n_epochs=1, device="cpu")
    learner.learn(64)
    assert learner.num_timesteps == 64
    assert len(learner.ep_success_buffer) == len(learner.ep_info_buffer) > 0
    PPO("MultiInputPolicy", NAME, device="cpu")


def test_torchrl_wraps_it_by_name() -> None:
    env = GymEnv(NAME, humans=3)
    assert env.rollout(5)["humans"].shape == (5, 3, 5)


def test_videos_are_recorded(tmp_path: Path) -> None:
    env = RecordVideo(
        gymnasium.make(NAME, render_mode="rgb_array"),
        str(tmp_path / "videos"),
        video_length=4,
        disable_logger=True,
    )
    env.reset(seed=0)
    for _ in range(6):
        env.step(np.zeros(env.action_space.shape, np.float32))
    env.close()
    (video,) = tmp_path.glob("videos/*.mp4")
    assert video.stat().st_size > 1000


def test_the_picture_shows_robots_people_and_goals_where_they_are() -> None:
    scenario = Scenario(robots=1, humans=1)
    world = World(scenario)
    world.reset([4])
    state = world.state
    state.robot_position[0, 0], state.robot_goal[0, 0] = (2.0, 0.0), (-4.0, 0.0)
    state.human_position[0, 0], state.human_velocity[0, 0] = (0.0, 3.0), 0.0
    picture = Renderer("rgb_array", scenario).picture(world).astype(int)
    scale = 512 / (2 * (scenario.circle_radius + scenario.spawn_jitter + 1.5))

    def colour(x: float, y: float) -> list[int]:
        return picture[round(256 - scale * y), round(256 + scale * x)].tolist()

    assert colour(1.85, 0.1) == colour(-4.0, 0.0) == [0x00, 0x72, 0xB2]  # robot and goal
    assert colour(0.0, 3.0) == [0x8C] * 3
    assert colour(0.5, 3.1) == [0xF0] * 3  # personal space
    assert colour(5.1, 5.1) == [0xFF] * 3


@pytest.mark.parametrize("make", [GymnasiumEnv, PettingZooEnv])
def test_a_window_follows_every_step(make: type, monkeypatch: pytest.MonkeyPatch) -> None:
    shown: list[float] = []
    monkeypatch.setattr(matplotlib, "get_backend", lambda: "windows")
    monkeypatch.setattr(plt, "pause", shown.append)
    env = make(robots=1, humans=2, render_mode="human")
    env.reset(seed=0)
    action = np.zeros(3, np.float32)
    env.step({"robot_0": action} if make is PettingZooEnv else action)
    assert shown == [0.25, 0.25]
    assert env.render() is None
    env.close()
    assert not plt.get_fignums()


def test_the_state_of_everybody_is_flat_and_true() -> None:
    env = PettingZooEnv(robots=2, humans=3, humans_min=0)
    env.reset(seed=2)
    state, true = env.state(), env.world.state
    assert env.state_space.contains(state)
    robot, humans = state[8:16], state[16:].reshape(3, 6)
    np.testing.assert_array_equal(
        robot[[0, 1, 5, 6]], [*true.robot_position[0, 1], *true.robot_goal[0, 1]]
    )
    np.testing.assert_array_equal(humans[:, 0], true.human_present[0])
    assert not humans[humans[:, 0] == 0].any()
