"""People may come and go within an episode; who is not present is nowhere."""

import numpy as np
import pytest
from staging import stage

from mrsan import Crowd, CrowdReaction, Scenario, State, World
from mrsan.kernels.tally import CLOSEST_HUMAN

COAST = [0.0, 0.0, 0.0]
DRIVER = (0, 0, 0, 1, 9, 0)
E = 40


def test_who_is_absent_is_not_hit_and_is_not_near() -> None:
    world = stage([DRIVER], [(0.5, 0, 0, 0)])
    world.state.human_present[0, 0] = False
    step = world.step([[COAST]])
    assert not step.observation.humans_visible.any()
    assert step.reward_parts.progress[0, 0] == pytest.approx(0.5)  # no discomfort in its place
    assert not world.state.done[0]
    assert world.state.tally[0, 0, CLOSEST_HUMAN] == np.inf
    world.state.human_present[0, 0] = True
    assert world.observe().humans_visible[0, 0, 0]
    assert world.step([[COAST]]).reward[0, 0] == -20


def without(state: State, here: np.ndarray, scenario: Scenario) -> World:
    """The same worlds with only the slots `here`."""
    world = World(scenario, E)
    world.restore(
        State(
            *(
                array[:, here] if name.startswith("human_") else array
                for name, array in state._asdict().items()
            )
        )._replace(message_buffer=world.state.message_buffer, last_contact=world.state.last_contact)
    )
    return world


@pytest.mark.parametrize("crowd", [Crowd.orca, Crowd.social_force])
def test_a_world_with_absent_people_is_the_world_without_them(crowd: Crowd) -> None:
    """To the last bit, for whoever leaves in the middle of an episode."""
    fields = {
        "robots": 2,
        "crowd": crowd,
        "occlusion": True,
        "fov_degrees": 150.0,
        "crowd_reaction": CrowdReaction.reciprocal,
        "goal_change_probability": 0.0,
    }
    world = World(Scenario(humans=8, **fields), E)
    world.reset(np.arange(E))
    rng = np.random.default_rng(1)
    for _ in range(10):
        world.step(rng.uniform(-1, 1, (E, 2, 3)))
    here = np.array([False, True, True, False, True, False, False, True])
    world.state.human_present[:] = here
    left = without(world.state, here, Scenario(humans=4, **fields))
    gone = world.state.human_position[:, ~here].copy()
    for _ in range(6):  # nobody comes to a goal so soon: a new one is drawn by the number of a slot
        actions = rng.uniform(-1, 1, (E, 2, 3)).astype(np.float32)
        step, theirs = world.step(actions), left.step(actions)
        np.testing.assert_array_equal(step.observation.ego, theirs.observation.ego)
        np.testing.assert_array_equal(
            step.observation.humans[:, :, here], theirs.observation.humans
        )
        assert not step.observation.humans_visible[..., ~here].any()
        np.testing.assert_array_equal(step.reward, theirs.reward)
        np.testing.assert_array_equal(step.terminated, theirs.terminated)
        np.testing.assert_array_equal(
            world.state.human_position[:, here], left.state.human_position
        )
    np.testing.assert_array_equal(world.state.human_position[:, ~here], gone)
