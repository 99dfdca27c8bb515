"""The predictor of people: its training data, its training, and its use by the planner."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from safetensors.numpy import save

from mrsan import ConfigurationError, Crowd, PluginError, Scenario, Split, World
from mrsan.prediction import PREDICTORS, ConstantVelocity, find_predictor, own_frame
from samarl.agents import build_agent
from samarl.configuration import load_agent_config
from samarl.planning.offset_predictor import OffsetPredictor
from samarl.prediction.learner import Learner, Network, save_predictor
from samarl.prediction.table import displacement
from samarl.prediction.training import Training
from samarl.prediction.windows import recorded_windows, simulate_windows

SMALL = Training(
    hidden=6,
    history=5,
    steps=4,
    rounds=20,
    worlds=2,
    duration=20,
    batch=64,
    learning_rate=0.01,
    max_gradient_norm=1.0,
    newly_seen=0.3,
    seed=3,
)
DT = 0.25


def test_windows_hold_the_positions_of_the_world() -> None:
    """People who stand still keep their positions."""
    windows = simulate_windows(Scenario(crowd=Crowd.still, humans=3), np.arange(2), SMALL)
    assert windows.past.shape == (6 * 6, 5, 2)  # every second step from 4 to 14
    np.testing.assert_array_equal(windows.future, windows.past[:, :4])
    assert not windows.velocity.any()
    assert windows.known.all()


def test_windows_of_a_recording_lie_within_the_recorded_tracks(tmp_path: Path) -> None:
    """One person walks at 1 m/s and turns; two others appear in a single frame each."""
    rows = [(20 + k, 1, 0.25 * min(k, 6), 0.25 * max(k - 6, 0)) for k in range(12)]
    path = tmp_path / "people.txt"
    path.write_text("\n".join(" ".join(map(str, row)) for row in rows) + "\n0 2 9 9\n60 3 9 9\n")
    windows = recorded_windows(path, 0.25, 0.25, SMALL)
    assert len(windows.past) == 2  # of eleven moments with a velocity, at the fifth and seventh
    np.testing.assert_allclose(windows.velocity[0], [1, 0], atol=1e-5)
    np.testing.assert_allclose(
        windows.future[0] - windows.past[0, -1],
        [[0.25, 0], [0.25, 0.25], [0.25, 0.5], [0.25, 0.75]],
        atol=1e-5,
    )
    with pytest.raises(
        ConfigurationError, match=r"recordings: .* has no track of at least 109 steps"
    ):
        recorded_windows(path, 0.25, 0.25, replace(SMALL, steps=104, duration=200))


def test_trained_and_simulated_network_agree() -> None:
    torch.manual_seed(0)
    network = Network(6)
    torch.nn.init.normal_(network.w_output)
    windows = simulate_windows(Scenario(), np.arange(4), SMALL)
    known = windows.known & (np.arange(5) >= np.arange(len(windows.known))[:, None] % 5)
    velocities, readable, ahead = own_frame(windows.past, known, windows.velocity, np.float32(DT))
    aside = network(torch.from_numpy(velocities), torch.from_numpy(readable), 4, DT)
    cos, sin = ahead[:, None, 0], ahead[:, None, 1]
    x, y = aside.detach().numpy()[..., 0], aside.detach().numpy()[..., 1]
    straight = ConstantVelocity(DT).predict(windows.past, known, windows.velocity, 4)
    expected = straight + np.stack([cos * x - sin * y, sin * x + cos * y], -1)
    positions = network.predictor(5, DT).predict(windows.past, known, windows.velocity, 4)
    np.testing.assert_allclose(positions, expected, atol=1e-5)


def test_training_reduces_the_error_and_resumes(tmp_path: Path) -> None:
    crowds = {"orca": Scenario(human_speed_max=1.5), "force": Scenario(crowd=Crowd.social_force)}
    whole = Learner(SMALL, crowds, tmp_path / "whole.safetensors")
    before = [weight.clone() for weight in whole.network.parameters()]
    whole.learn()
    half = Learner(SMALL, crowds, tmp_path / "half.safetensors")
    for half.round in range(10):
        half._one_round()
    half.save()
    again = Learner(SMALL, crowds, tmp_path / "half.safetensors")
    assert again.round == 10
    again.learn()
    for a, b, c in zip(whole.network.parameters(), again.network.parameters(), before, strict=True):
        assert torch.equal(a, b)
        assert not torch.equal(a, c)
    assert Learner(SMALL, crowds, tmp_path / "whole.safetensors").round == 20
    with pytest.raises(
        ConfigurationError, match=r"whole\.safetensors belongs to another training run"
    ):
        Learner(replace(SMALL, seed=4), crowds, tmp_path / "whole.safetensors")
    windows = simulate_windows(crowds["force"], Split.validation.case(0) + np.arange(20), SMALL)
    plain = displacement(ConstantVelocity(DT), windows, 4)
    assert displacement(again.predictor(), windows, 4)[-1] < plain[-1]


@pytest.mark.parametrize(
    ("crowd", "gain"), [(Scenario(), 0.05), (Scenario(crowd=Crowd.social_force), 0.1)]
)
def test_the_shipped_predictor_is_better_than_constant_velocity(
    crowd: Scenario, gain: float
) -> None:
    """In cases that it was neither trained nor measured on, after five steps."""
    cases = Split.validation.case(5000) + np.arange(30)
    windows = simulate_windows(crowd, cases, replace(SMALL, history=8, steps=5, duration=60))
    plain = displacement(ConstantVelocity(DT), windows, 5)[-1]
    assert displacement(find_predictor("recurrent", DT), windows, 5)[-1] < (1 - gain) * plain


SCENARIO = Scenario(robots=3, humans=16, fov_degrees=200.0)


def predicting_agent(predictor: str) -> dict[str, Any]:
    return load_agent_config("model_predictive") | {"predictor": predictor}


def driven(config: dict[str, Any], scenario: Scenario = SCENARIO) -> list[np.ndarray]:
    """What an agent does."""
    agent = build_agent(config, scenario)
    world, actions = World(scenario, 20), []
    observation = world.reset(Split.validation.case(0) + np.arange(20))
    for _ in range(50):
        actions.append(agent.act(observation))
        observation = world.step(actions[-1]).observation
    return actions


def test_the_default_predictor_is_constant_velocity(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """To the bit: as by default, through the interface of predictors, with weights of zero."""
    expected = driven(load_agent_config("model_predictive"))
    save_predictor(tmp_path / "zero.safetensors", Network(4).predictor(8, DT), {})
    monkeypatch.setitem(PREDICTORS, "straight", ConstantVelocity)
    names = ("constant_velocity", "straight", str(tmp_path / "zero.safetensors"))
    for name in names:
        np.testing.assert_array_equal(driven(predicting_agent(name)), expected)
    otherwise = driven(predicting_agent("recurrent"))
    assert any((a != b).any() for a, b in zip(otherwise, expected, strict=True))


class Sideways(ConstantVelocity):
    """Adds a velocity of 1 m/s in the world's +y direction."""

    history = 3

    def predict(self, past, known, velocity, steps):  # type: ignore[no-untyped-def]
        self.inputs = past.copy(), known.copy()
        position = super().predict(past, known, velocity, steps)
        position[..., 1] += DT * np.arange(1, steps + 1, dtype=np.float32)
        return position


def test_predicted_offsets_are_in_the_body_frame_and_only_of_visible_people(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    scenario = Scenario(robots=2, humans=6, fov_degrees=180.0)
    monkeypatch.setitem(PREDICTORS, "sideways", Sideways)
    world, offsets = World(scenario, 4), OffsetPredictor(scenario, "sideways", 5 * DT, "predictor")
    observation = world.reset(np.arange(4))
    offsets.reset(np.ones(4, np.bool_))
    for t in range(6):
        offset, visible = offsets.update(observation), observation.humans_visible
        heading = world.state.robot_heading[:, :, None, None]
        along = DT * np.arange(6) * np.stack([np.sin(heading), np.cos(heading)])
        expected = np.where(visible[..., None, None], np.moveaxis(along, 0, -1), 0.0)
        np.testing.assert_allclose(offset, expected, atol=1e-5)
        past, known = offsets.predictor.inputs
        np.testing.assert_array_equal(known[..., -1], visible)
        position = np.broadcast_to(world.state.human_position[:, None], (4, 2, 6, 2))
        np.testing.assert_allclose(past[..., -1, :][visible], position[visible], atol=1e-4)
        assert not known[..., : max(2 - t, 0)].any()
        observation = world.step(np.full((4, 2, 3), 0.3)).observation
    assert 0 < visible.sum() < visible.size


def test_the_planner_reacts_to_a_predicted_turn(monkeypatch: pytest.MonkeyPatch) -> None:
    """A person walks beside the robot and is predicted to turn towards it."""
    monkeypatch.setitem(PREDICTORS, "sideways", Sideways)
    scenario = Scenario(robots=1, humans=1)
    actions = []
    for name in ("constant_velocity", "sideways"):
        world = World(scenario)
        world.reset([0])
        state = world.state
        state.robot_position[0, 0], state.robot_goal[0, 0] = (0, 0), (8, 0)
        state.robot_heading[0, 0], state.robot_velocity[0, 0] = 0, (1, 0)
        state.human_position[0, 0], state.human_velocity[0, 0] = (0.0, -0.7), (1, 0)
        state.human_radius[0, 0] = 0.3
        actions.append(build_agent(predicting_agent(name), scenario).act(world.observe()))
        assert np.isfinite(actions[-1]).all()
    assert (actions[0] != actions[1]).any()


def test_the_command_trains_evaluates_and_reports_errors(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    from samarl.commands import predictor as command

    small = ["training.rounds=2", "training.worlds=2", "training.duration=20"]
    small += ["training.hidden=4", "validation_cases=2", "output=mine"]
    street = ["recordings=recordings", "frame_seconds.street=0.25"]
    recordings = tmp_path / "recordings"
    recordings.mkdir()
    rows = [(k, 1, 0.3 * k, 0.0) for k in range(60)]
    (recordings / "street.txt").write_text("\n".join(" ".join(map(str, row)) for row in rows))
    (recordings / "street.safetensors").write_bytes(save({}))
    monkeypatch.chdir(tmp_path)

    def said(*words: str) -> str:
        monkeypatch.setattr("sys.argv", ["samarl-predictor", *small, *words])
        command.main()
        return capsys.readouterr().out

    assert "| street" in said(*street)
    provenance = json.loads((tmp_path / "mine/recurrent.json").read_text())["provenance"]
    assert set(provenance["errors"]) == {"orca", "social_force", "mixed", "street"}
    assert provenance["errors"]["street"]["constant_velocity"] == pytest.approx([0.0] * 5, abs=1e-4)
    assert provenance["command"].startswith("samarl-predictor training.rounds=2")
    result = json.loads((tmp_path / "mine/prediction.json").read_text())
    assert result["errors"] == provenance["errors"]
    said(*street, "predictor=mine/recurrent.safetensors", "output=again")
    again = json.loads((tmp_path / "again/prediction.json").read_text())
    assert again["errors"] == result["errors"]
    for words, message in (
        ("shown_steps=9", "shown_steps is 9; it must be at most training.steps (8)"),
        ("training.duration=10", "training.duration is 10; it must be at least"),
        ("recordings=nowhere", "recordings is 'nowhere'; it must be a folder with *.txt files"),
        ("predictor=nobody", "predictor is 'nobody'; it must be a .safetensors file or one of"),
    ):
        with pytest.raises(SystemExit) as stopped:
            said(words)
        error = capsys.readouterr().err.strip()
        assert stopped.value.code == 2
        assert message in error
        assert len(error.splitlines()) == 1


def test_a_prediction_that_cannot_be_used_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    """The planner would take people whose positions are NaN for nobody."""

    class Broken(ConstantVelocity):
        def predict(self, past: Any, valid: Any, velocity: Any, steps: int) -> Any:
            positions = super().predict(past, valid, velocity, steps)
            return positions * np.float32(np.nan) if self.broken == "nan" else positions[..., :1, :]

    monkeypatch.setitem(PREDICTORS, "broken", Broken)
    scenario = Scenario(humans=3, robots=2)
    observation = World(scenario).reset([0])
    for broken, message in (("nan", r"predictor Broken is nan at index \[0, "), ("", "has shape")):
        monkeypatch.setattr(Broken, "broken", broken, raising=False)
        offsets = OffsetPredictor(scenario, "broken", 2.0, "agent.predictor")
        with pytest.raises(PluginError, match=message):
            offsets.update(observation)
