"""Going back: a restored world is the world it was, to the last bit."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from mrsan import CrowdReaction, Groups, Scenario, Step, World

E, STEPS = 24, 60
SCENARIO = Scenario(
    robots=2,
    humans=6,
    humans_min=2,
    time_limit=8.0,
    fov_degrees=120.0,
    occlusion=True,
    position_noise=0.1,
    missed_detection=0.1,
    crowd_reaction=CrowdReaction.reciprocal,
    goal_change_interval=1.0,
)
SOCIAL = replace(
    SCENARIO,
    crowd_reaction=CrowdReaction.mixed,
    groups=Groups(share=0.7, standing_share=0.3),
)
COUNTED = replace(SCENARIO, humans=12, terminate_on_collision=False, radius_noise=0.1)
ACTIONS = np.random.default_rng(0).uniform(-1, 1, (STEPS, E, 2, 3)).astype(np.float32)
SOME = np.arange(E) % 3 == 0


def bits(values: Any) -> list[bytes]:
    """The bytes of all arrays in nested tuples and dicts."""
    if isinstance(values, dict):
        values = tuple(values.values())
    if isinstance(values, tuple):
        return [part for value in values for part in bits(value)]
    return [b"" if values is None else np.ascontiguousarray(values).tobytes()]


def begun(auto_reset: bool = True, scenario: Scenario = SCENARIO) -> World:
    world = World(scenario, E, auto_reset)
    world.reset(np.arange(E))
    for action in ACTIONS[:10]:
        world.step(action)
    return world


def go_on(world: World) -> list[Step]:
    return [world.step(action) for action in ACTIONS]


@pytest.mark.parametrize("auto_reset", [True, False])
@pytest.mark.parametrize("scenario", [SCENARIO, COUNTED, SOCIAL])
def test_the_same_actions_lead_to_the_same_bits(scenario: Scenario, auto_reset: bool) -> None:
    """Eight seconds are 32 steps: every world ends on the way, and most begin again."""
    world = begun(auto_reset, scenario)
    past, seen = world.snapshot(), bits(world.observe())
    first, state = go_on(world), bits(world.state)
    assert any((step.terminated | step.truncated).any() for step in first)
    assert bits(world.state) != bits(past)
    for again in (world, begun(auto_reset, scenario), World(scenario, E, auto_reset)):
        again.restore(past)
        assert bits(again.observe()) == seen
        assert [bits(step) for step in go_on(again)] == [bits(step) for step in first]
        assert bits(again.state) == state


def test_only_the_chosen_worlds_go_back() -> None:
    """Each then is where it was, and where it is, as if it were alone."""
    world = begun()
    past = world.snapshot()
    go_on(world)
    present = world.snapshot()
    world.restore(past, worlds=SOME)
    for then, now, mixed in zip(past, present, world.state, strict=True):
        np.testing.assert_array_equal(
            mixed, np.where(SOME.reshape(-1, *[1] * (then.ndim - 1)), then, now)
        )
    later = go_on(world)
    alone = begun()
    for some, start in ((SOME, past), (~SOME, present)):
        alone.restore(start)
        for step, theirs in zip(go_on(alone), later, strict=True):
            assert bits(step.observation.of_worlds(some)) == bits(
                theirs.observation.of_worlds(some)
            )
            np.testing.assert_array_equal(step.reward[some], theirs.reward[some])


def test_what_does_not_fit_is_refused_and_nothing_is_written() -> None:
    world = begun()
    before, past = bits(world.state), World(SCENARIO, E).snapshot()
    for snapshot, worlds, message in (
        (World(SCENARIO, 2).snapshot(), None, r"snapshot.case has shape \(2,\); .* \(24,\)"),
        (past._replace(clock=past.clock.astype(float)), None, "clock has type float64; .* int32"),
        (past, [True] * 3, "it must be 24 booleans"),
    ):
        with pytest.raises(ValueError, match=message):
            world.restore(snapshot, worlds)
        assert bits(world.state) == before
