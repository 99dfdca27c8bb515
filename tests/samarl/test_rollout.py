"""What is learned from is what was done: log-probabilities, restarts, the ends of episodes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from samarl.encoders import ENCODERS
from samarl.policies.policy import LOCAL
from tests.learning import SCENARIO, choices, collector, crowded, policy


@pytest.mark.parametrize(
    ("name", "encoder", "actors"),
    [("hierarchical", encoder, 1) for encoder in ENCODERS]
    + [
        ("hierarchical", "structural_rnn", 2),
        ("flat", "gru", 1),
        ("flat", "spatio_temporal", 2),
        ("squashed", "temporal_spatial_graph", 1),
        ("squashed", "gru", 2),
    ],
)
def test_training_computes_the_log_probabilities_of_acting(
    name: str, encoder: str, actors: int
) -> None:
    model = policy(name, encoder, gain=30.0, num_parameter_sets=actors)
    going = collector(
        model, 12, 12, crowded(), failure_restart_probability=1.0, noise_correlation=0.75
    )
    ended = restarted = compared = 0
    for _ in range(4):  # all but the first go on in the middle of episodes
        rollout = going.collect()
        restarted += len(rollout.steps) - 12
        ended += sum(len(episodes.case) for episodes in rollout.episodes)
        began = rollout.steps["mask"][:, 0, 0]
        assert (rollout.steps["mask"][:12].sum(1) > 0).all()
        for level, (choice, stored, sequence) in choices(model, rollout).items():
            exact = torch.ones_like(stored, dtype=torch.bool)
            if not model.history:  # a hidden state after a restart is only about the same
                exact = began[sequence]
            torch.testing.assert_close(
                choice.log_prob[exact],
                stored[exact],
                atol=1e-4,
                rtol=0,
                msg=lambda m, level=level: f"{level} {m}",
            )
            compared += int(exact.sum())
            assert torch.isfinite(choice.log_prob).all()
    assert restarted > 1
    assert ended > 3
    assert compared > 500


def test_rollouts_overlap_by_the_step_that_was_decided_and_not_taken() -> None:
    going = collector(policy(), 6, 5, noise_correlation=0.75)
    first, second = going.collect(), going.collect()
    for key in (
        "is_init",
        ("agents", "action"),
        ("agents", "sample_log_prob"),
        ("agents", "waypoint_features"),
        ("agents", "previous_noise"),
        ("agents", "speed"),
        ("agents", "macro", "action"),
    ):
        assert torch.equal(first.steps[key][:, -1], second.steps[key][:, 0]), key
    assert torch.equal(first.frames.ego[:, -1], second.frames.ego[:, 3])
    assert not first.steps["next", "agents", "reward"][:, -1].any()
    assert first.state is not None
    assert second.state is not None
    assert torch.equal(first.state.humans[:, -1], second.state.humans[:, 0])


def test_a_timeout_bootstraps_and_the_next_episode_begins() -> None:
    going = collector(policy(), 6, 8, replace(SCENARIO, humans=0, time_limit=1.0))
    steps = going.collect().steps
    # 1 s is 4 steps: everybody is still on the way.
    done = steps["next", "done"][:, :, 0]
    assert done[0].nonzero().flatten().tolist() == [3, 7]
    assert (done == done[:1]).all()
    assert steps["is_init"][0, :, 0].nonzero().flatten().tolist() == [0, 4, 8]
    assert not steps["next", "agents", "terminated"].any()


def test_a_collision_ends_the_stream_of_the_robot_and_cuts_short_those_of_its_team() -> None:
    steps = collector(policy(), 32, 40, crowded()).collect().steps
    terminated, done = steps["next", "agents", "terminated"], steps["next", "done"]
    alone = terminated.sum(-1) == 1
    hit = steps["next", "agents", "macro", "reward"] <= -15.0
    assert (alone & hit.any(-1)).any()
    assert terminated[hit].all()
    cut = done & ~terminated
    assert cut[alone].any()
    assert not hit[cut].any()
    assert done.squeeze(-1)[alone].all()


def test_a_robot_that_stands_for_too_long_ends_the_episode_and_pays() -> None:
    """Robot 0 brakes for ever; robot 1 drives on, and its stream is only cut short."""
    model = policy("flat", num_parameter_sets=2)
    with torch.no_grad():
        for networks, acceleration in zip(model.networks, (-3.0, 3.0), strict=True):
            head = networks.heads[LOCAL]
            head.body[-1].weight.zero_()
            head.body[-1].bias.copy_(torch.tensor([acceleration, 0.0, 0.0]))
            head.log_std.fill_(-5.0)
    scenario = replace(SCENARIO, humans=0)
    rollouts = []
    for stage in ({"standstill_limit": 1.0, "standstill_penalty": 7.0}, {}):
        torch.manual_seed(0)
        rollouts.append(collector(model, 4, 9, scenario, **stage).collect().steps)
    steps, free = rollouts
    # 1 s is 4 steps.
    done, terminated = steps["next", "done"][..., 0], steps["next", "agents", "terminated"]
    assert done[0].nonzero().flatten().tolist() == [3, 7]
    assert (done == done[:1]).all()
    assert torch.equal(terminated[..., 0], done)
    assert not terminated[..., 1].any()
    assert steps["is_init"][0, :, 0].nonzero().flatten().tolist() == [0, 4, 8]
    paid = free["next", "agents", "reward"] - steps["next", "agents", "reward"]
    assert paid[:, 3, 0].tolist() == pytest.approx([7.0] * 4, abs=1e-5)
    assert not paid[:, :3].any()
    assert not paid[:, 3, 1].any()
    assert not free["next", "done"].any()


def test_a_robot_that_creeps_stands() -> None:
    """In four steps robot 0 creeps 0.44 m, and robot 1 drives 0.8 m."""
    going = collector(policy("flat"), 3, 1, replace(SCENARIO, humans=0), standstill_limit=1.0)
    position = going.world.state.robot_position
    stood = []
    for _ in range(8):
        position[:, 0, 0] += 0.11
        position[:, 1, 0] += 0.2
        stood.append(going._update_standstill().tolist())
    # 1 s is 4 steps. Robot 0 has left the place after the fifth.
    assert [both[0][0] for both in stood] == [False, False, False, True, False, False, False, False]
    assert not any(both[e][1] for both in stood for e in range(3))


def test_exploration_keeps_its_direction_for_a_while() -> None:
    torch.manual_seed(0)
    model = policy(gain=0.0)
    going = collector(model, 64, 40, replace(SCENARIO, humans=0), noise_correlation=0.75)
    head = model.networks[0].heads[LOCAL]
    noise = (going.collect().steps["agents", "action"] - head.body[-1].bias) / head.log_std.exp()
    noise = noise.detach()
    begins = going.begins.view(64, 2, -1)[:, 0, going.past : going.past + 41]
    assert begins[:, 0].all()
    assert noise.mean().item() == pytest.approx(0.0, abs=0.05)
    assert noise.square().mean().item() == pytest.approx(1.0, abs=0.06)
    same = ~begins[:, 1:]
    product = (noise[:, 1:] * noise[:, :-1])[same].mean().item()
    assert product == pytest.approx(0.75, abs=0.06)
    assert (noise[:, :, 1] * noise[:, :, 0]).mean().item() == pytest.approx(0.0, abs=0.06)


def test_with_a_narrow_view_progress_is_measured_on_the_way_round() -> None:
    wide = replace(SCENARIO, humans=0, fov_degrees=180.0)
    rewards = []
    for scenario in (wide, replace(wide, fov_degrees=179.0)):
        going = collector(policy(), 8, 4, scenario)
        torch.manual_seed(1)
        rewards.append(going.collect().steps["next", "agents", "macro", "reward"][:, :-1].mean())
    # They set out towards the goal, through the middle: that is no progress on the way round.
    assert rewards[0] > 0.05
    assert rewards[1] < -0.05


def test_a_collision_is_tried_again_from_shortly_before() -> None:
    torch.manual_seed(0)
    going = collector(policy(gain=30.0), 24, 1, crowded(), failure_restart_probability=1.0)
    state, again = going.world.state, 0
    for _ in range(40):
        moments = [
            (snapshot["robot_position"].copy(), snapshot["clock"].copy())
            for snapshot, _ in going.snapshots.snapshots
        ]
        age = going.age.copy()
        rollout = going.collect()
        for sequence in range(24, len(rollout.steps)):
            same = [
                e
                for e in range(24)
                if torch.equal(
                    rollout.steps["agents", "action"][e, 0],
                    rollout.steps["agents", "action"][sequence, 0],
                )
            ]
            (e,) = same
            back = [
                k
                for k in range(1, len(moments) + 1)
                if np.array_equal(moments[-k][0][e], state.robot_position[e])
                and moments[-k][1][e] == state.clock[e]
            ]
            assert back
            assert min(back) <= age[e] + 1
            again += 1
        assert not state.done.any()
        assert (state.collision == 0).all()
    assert again > 5
