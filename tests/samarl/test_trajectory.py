"""Trajectories of episodes, and the figures and animations drawn from them."""

from dataclasses import replace
from pathlib import Path

import imageio_ffmpeg
import numpy as np
import pytest
import torch
from PIL import Image, ImageColor

from mrsan import Outcome, Scenario
from samarl.agents import build_agent
from samarl.encoders.transformer_layers import Pool
from samarl.evaluation.trajectory import record_episode
from samarl.policies.checkpoint import save_policy
from samarl.report.animation import (
    ending,
    save_animation,
)
from samarl.report.style import COLOURS
from tests.learning import policy

SCENARIO = Scenario(humans=4, robots=3, fov_degrees=120.0, time_limit=4.0)
STRAIGHT = {"_target_": "samarl.agents.planners.straight.Straight"}


def test_visible_agents_are_in_the_field_of_view() -> None:
    trajectory = record_episode(build_agent(STRAIGHT, SCENARIO), SCENARIO, 3)
    humans = trajectory.human_position[:, None] - trajectory.robot_position[:, :, None]
    robots = trajectory.robot_position[:, None] - trajectory.robot_position[:, :, None]
    ahead = trajectory.robot_heading[..., None]
    for offset, visible in (
        (humans, trajectory.humans_visible),
        (robots, trajectory.robots_visible),
    ):
        bearing = np.arctan2(offset[..., 1], offset[..., 0]) - ahead
        angle = np.abs(np.degrees((bearing + np.pi) % (2 * np.pi) - np.pi))
        distance = np.linalg.norm(offset, axis=-1)
        expected = (angle < 60) & (distance < 10) & (distance > 0)
        borderline = (np.abs(angle - 60) < 0.01) | (np.abs(distance - 10) < 1e-4)
        assert (visible == expected)[~borderline].all()
        assert visible.any()
        assert not visible.all()
    assert trajectory.waypoint is trajectory.human_attention is trajectory.robot_attention is None


@pytest.mark.parametrize("actors", [1, 3])
def test_a_policy_explains_its_waypoints_and_attention(tmp_path: Path, actors: int) -> None:
    path = tmp_path / "policy.safetensors"
    save_policy(path, policy(num_parameter_sets=actors), "hierarchical", {})
    config = {"_target_": "samarl.agents.learned.Learned", "checkpoint": str(path)}
    trajectory = record_episode(build_agent(config, SCENARIO), SCENARIO, 3)
    steps = len(trajectory.robot_position) - 1
    assert trajectory.waypoint is not None
    assert trajectory.human_attention is not None
    assert trajectory.robot_attention is not None
    assert trajectory.waypoint.shape == (steps, 3, 2)
    # A waypoint is kept for at most four steps, which is `macro_steps` of the small policy.
    changes = (np.diff(trajectory.waypoint, axis=0) != 0).any(-1).sum(0)
    assert (changes >= (steps - 1) // 4).all()
    for share in (trajectory.human_attention, trajectory.robot_attention):
        assert (share >= 0).all()
        assert (share.sum(-1) < 1).all()  # "nobody" has a share too
    first = trajectory.human_attention[0]
    assert ((first > 0) == trajectory.humans_visible[0]).all()  # no tracks yet
    assert (np.diagonal(trajectory.robot_attention, axis1=1, axis2=2) == 0).all()


def test_attention_weights_reproduce_the_pooled_features() -> None:
    torch.manual_seed(0)
    pool = Pool(8, heads=1)
    torch.nn.init.normal_(pool.nobody)
    own, tokens = torch.randn(5, 8), torch.randn(5, 3, 8)
    masked = torch.where(torch.rand(5, 3, 1) < 0.4, -1e9, torch.randn(5, 3, 1))
    shares = pool.weights(own, tokens, masked)
    assert (shares[masked[..., 0] < -1e8] == 0).all()
    value, nobody = pool.key_value(tokens)[..., 8:], pool.nobody[8:]
    rest = 1 - shares.sum(-1, keepdim=True)
    by_hand = pool.out((shares.unsqueeze(-1) * value).sum(1) + rest * nobody)
    torch.testing.assert_close(by_hand, pool(own, tokens, masked), atol=1e-5, rtol=0)


def test_animations_are_smooth_and_as_fast_as_the_episode(tmp_path: Path) -> None:
    scenario = replace(SCENARIO, time_limit=1.5)
    trajectory = record_episode(build_agent(STRAIGHT, scenario), scenario, 3)
    steps = len(trajectory.robot_position) - 1
    shorter = replace(trajectory, robot_position=trajectory.robot_position[:-3])
    save_animation([(trajectory, "one"), (shorter, "two")], tmp_path / "case.gif")
    with Image.open(tmp_path / "case.gif") as picture:
        assert picture.n_frames == 3 * steps + 1  # type: ignore[attr-defined]
        seconds = 0.0
        for number in range(3 * steps):
            picture.seek(number)
            seconds += picture.info["duration"] / 1000
        assert seconds == pytest.approx(0.25 * steps, abs=0.01)
        pixels = np.asarray(picture.convert("RGB"), int).reshape(-1, 3)
        for colour in COLOURS[: SCENARIO.robots]:  # every robot keeps its colour in the palette
            assert np.abs(pixels - ImageColor.getrgb(colour)).max(1).min() < 8
    save_animation([(trajectory, "a title")], tmp_path / "case.mp4")
    pictures = imageio_ffmpeg.read_frames(str(tmp_path / "case.mp4"))
    assert next(pictures)["fps"] == 20
    assert sum(1 for _ in pictures) == 5 * steps + 1 + 3 * 20  # the last one is shown for 3 s
    assert sorted(file.name for file in tmp_path.iterdir()) == ["case.gif", "case.mp4"]


def test_an_animation_tells_how_the_episode_ended() -> None:
    assert ending([Outcome.arrived, Outcome.arrived]) == "Success: all robots arrived"
    hit = [Outcome.hit_human, Outcome.interrupted, Outcome.arrived]
    assert ending(hit) == "Failure: robot 0 hit a person"
    assert ending([Outcome.hit_robot] * 2) == "Failure: robots 0 and 1 hit a robot"
    both = [Outcome.timeout, Outcome.hit_wall]
    assert ending(both) == "Failure:\nrobot 0 ran out of time\nrobot 1 hit a wall"
