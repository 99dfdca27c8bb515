"""Mirror images, of which `benchmarks.learning_leads` makes use."""

import numpy as np
import torch

from benchmarks.mirror_images import TURNED, mirrored
from mrsan import Scenario, World
from mrsan.state import State
from samarl.observations.features import frames_of, state_of
from samarl.observations.frames import Frames
from samarl.observations.tracker import Tracker

VECTORS = ("human_position", "human_velocity", "human_goal", "robot_position", "robot_velocity")
VECTORS += ("robot_goal", "robot_start")


def mirror_image(state: State) -> State:
    """Return the worlds with y replaced by -y."""
    changed = {name: getattr(state, name) * np.float32([1, -1]) for name in VECTORS}
    return state._replace(robot_heading=-state.robot_heading, **changed)


def seen_and_true(world: World) -> tuple[Frames, Frames]:
    scenario, worlds = world.scenario, world.worlds
    tracker = Tracker(1.0, scenario.time_step)
    tracks = tracker.initial(worlds, scenario.robots, scenario.humans)
    seen = tracker.update(world.observe(), tracks, np.ones(worlds, np.bool_))
    return frames_of(seen, scenario), state_of(world)


def test_a_mirror_image_is_what_robots_see_in_a_mirrored_world_and_their_actions_lead_there() -> (
    None
):
    scenario = Scenario(fov_degrees=120.0, humans=6, robots=3)
    world, image = World(scenario, 8), World(scenario, 8)
    world.reset(np.arange(8))
    image.reset(np.arange(8))
    action = np.random.default_rng(0).uniform(-1, 1, (8, 3, 3)).astype(np.float32)
    for _ in range(5):
        world.step(action)
    image.restore(mirror_image(world.state))
    for left, right in zip(seen_and_true(world), seen_and_true(image), strict=True):
        for name, values in mirrored(left).named().items():
            torch.testing.assert_close(values, right.named()[name], atol=1e-5, rtol=0.0)
    world.step(action)
    image.step(action * np.float32(TURNED))
    expected = world.state.robot_position * np.float32([1, -1])
    np.testing.assert_allclose(image.state.robot_position, expected, atol=1e-5)
