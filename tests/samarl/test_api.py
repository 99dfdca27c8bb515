"""`import samarl`: load, evaluate, record and train from Python."""

import json
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

import samarl
from mrsan import ConfigurationError, Kinematics, Observation, Reward, Scenario, Split
from samarl.agents import build_agent
from samarl.agents.learned import Learned
from samarl.agents.planners.orca import Orca
from samarl.agents.shielded import Shielded
from samarl.configuration import load_agent_config
from samarl.evaluation.runner import run_cases
from samarl.evaluation.trajectory import record_episode
from samarl.files import find_folder
from samarl.policies.checkpoint import load_policy
from tests.samarl.test_workflows import run

SMALL = Scenario(humans=3, robots=2, time_limit=10.0)
SHORT_TRAINING = {"seed": 3, "steps": 32, "rollout": 4, "validation_cases": 2, "threads": 1}


def test_importing_samarl_is_cheap() -> None:
    code = "import sys, samarl; print({'torch', 'numba', 'hydra', 'pandas'} & set(sys.modules))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout == "set()\n"
    with pytest.raises(AttributeError, match="no attribute 'evalute'"):
        _ = samarl.evalute


def test_an_agent_is_loaded_with_the_shield_of_its_file() -> None:
    agent = samarl.load_agent("samarl_waypoints", SMALL)
    assert isinstance(agent, Shielded)
    assert agent.agent == Learned(SMALL, "samarl_waypoints")
    assert agent.scenario == SMALL
    assert samarl.load_agent("samarl_waypoints", SMALL, shield=False) == Learned(
        SMALL, "samarl_waypoints"
    )
    assert samarl.load_agent("orca", safety_space=0.1) == Orca(
        Scenario(), **{**_fields("orca"), "safety_space": 0.1}
    )


def _fields(name: str) -> dict:
    config = load_agent_config(name)
    del config["_target_"]
    return config


@pytest.mark.parametrize("kind", ["name", "file", "training"])
def test_a_policy_is_driven_like_the_shipped_agent_of_its_kind(kind: str, tmp_path: Path) -> None:
    policy = find_folder("results") / "checkpoints/samarl_circle_seed0"
    for suffix in (".json", ".safetensors"):
        (tmp_path / f"best{suffix}").write_bytes(policy.with_suffix(suffix).read_bytes())
    named = {
        "name": "samarl_circle_seed0",
        "file": f"{policy}.safetensors",
        "training": tmp_path,
    }[kind]
    agent = samarl.load_agent(named)
    expected = build_agent(
        load_agent_config("samarl_flat") | {"checkpoint": "samarl_circle_seed0"}, Scenario()
    )
    assert agent.version() == expected.version()
    assert agent.label == (tmp_path.name if kind == "training" else "samarl_circle_seed0")


def test_files_may_have_any_name_and_extend_others(tmp_path: Path) -> None:
    (tmp_path / "orca.yaml").write_text("defaults: [cautious]\nmax_neighbors: 3\n")
    (tmp_path / "cautious.yaml").write_text("defaults: [orca]\nsafety_space: 0.9\n")
    (tmp_path / "lobby.yaml").write_text("defaults: [mixed]\nhumans: 4\n")
    config = load_agent_config("orca")
    cautious = samarl.load_agent(tmp_path / "cautious.yaml")
    assert cautious == build_agent(config | {"safety_space": 0.9}, Scenario())
    assert cautious.label == "cautious"
    lobby = samarl.load_scenario(tmp_path / "lobby.yaml", robots=2)
    assert lobby == replace(samarl.load_scenario("mixed"), humans=4, robots=2)


def test_mistakes_are_named() -> None:
    calls: list[tuple[Callable[[], Any], str]] = [
        (lambda: samarl.load_agent("smarl"), r"agent is 'smarl', .* did you mean samarl"),
        (lambda: samarl.load_agent("cadrl_shielded"), r" is 'cadrl_shielded', .*shield=true"),
        (lambda: samarl.load_agent("orca", reach=1), r"agent\.reach is not known"),
        (lambda: samarl.load_scenario("10p3"), r"scenario is '10p3', .* did you mean 10p3r"),
        (lambda: samarl.evaluate("orca", cases=[4, 4]), r"cases is \[4, 4\]; .* different"),
        (lambda: samarl.evaluate("orca", split="tset"), r"split is 'tset'; .* test"),
        (lambda: samarl.record("orca", case=-1), r"case index is -1"),
        (lambda: samarl.train(trainer={"stepps": 2}), r"trainer\.stepps is not .* trainer\.steps"),
        (lambda: load_policy("smarl"), r"checkpoint is 'smarl', .* did you mean samarl"),
    ]
    for call, message in calls:
        with pytest.raises(ConfigurationError, match=message) as error:
            call()
        assert "\n" not in str(error.value)


def test_the_result_is_that_of_the_command(tmp_path: Path) -> None:
    words = ["agent=straight", "evaluation.cases=6", "scenario.humans=3", "scenario.robots=2"]
    run("evaluate", *words, "hydra.run.dir=here", cwd=tmp_path)
    row = json.loads((tmp_path / "here/row.json").read_text())["row"]
    result = samarl.evaluate("straight", samarl.load_scenario(humans=3, robots=2), cases=6)
    assert {**result.row, "command": ""} == {**row, "command": ""}
    again = eval(result.row["command"], {"samarl": samarl})
    assert again.row == result.row
    expected = f"success, %    {row['success_rate']:.1f} [{row['success_low']:.1f}, "
    assert expected in repr(result)

    table = result.to_pandas()
    assert len(table) == 12
    assert table.groupby("case").success.first().tolist() == result.success.tolist()
    assert table.social_score.mean() == pytest.approx(row["social_score"], abs=0.01)
    second = table[(table.case == Split.test.case(1)) & (table.robot == 1)].iloc[0]
    assert second.path_length == result.episodes.path_length[1, 1]
    assert (result.success == (table.outcome == "arrived").to_numpy().reshape(6, 2).all(1)).all()


def test_an_agent_is_created_again_for_another_scenario() -> None:
    agent = samarl.load_agent("orca", shield=True)
    wide = Scenario(humans=3, robots=2, robot_speed=0.6, time_step=0.5, time_limit=20.0)
    result = samarl.evaluate(agent, wide, cases=3)
    own = build_agent(load_agent_config("orca") | {"shield": True}, wide)
    expected = run_cases(own, wide, result.episodes.case, 3)
    assert (result.episodes.path_length == expected.path_length).all()
    assert result.row["method"] == "orca"
    assert agent.scenario == Scenario()


def test_a_record_is_the_motion_of_the_case() -> None:
    scenario = replace(SMALL, late_probability=0.5, kinematics=Kinematics.holonomic)
    table = samarl.record("straight", scenario, case=5)
    trajectory = record_episode(
        samarl.load_agent("straight", scenario), scenario, Split.test.case(5)
    )
    steps = len(trajectory.robot_position)
    present = trajectory.human_present.sum()
    assert len(table) == 2 * steps + present < 5 * steps
    assert (table.time == 0.25 * table.step).all()
    robot = table[(table.kind == "robot") & (table.id == 1)]
    assert robot[["x", "y"]].to_numpy().tolist() == trajectory.robot_position[:, 1].tolist()
    for kind, number in (("robot", 1), ("human", 0)):
        path = table[(table.kind == kind) & (table.id == number)]
        velocity = np.diff(path[["x", "y"]], axis=0) / 0.25
        np.testing.assert_allclose(velocity, path[["vx", "vy"]][1:], atol=1e-4)
    assert robot.heading.notna().all()
    assert table[table.kind == "human"].heading.isna().all()
    to_goal = np.hypot(robot.x - robot.goal_x, robot.y - robot.goal_y)
    assert (np.diff(to_goal) <= 1e-5).all()


def test_waypoints_and_the_shield_are_recorded() -> None:
    table = samarl.record("samarl_waypoints", SMALL, case=1)
    robots = table[table.kind == "robot"]
    is_last = robots.step == robots.step.max()
    assert robots[is_last].waypoint_x.isna().all()
    assert robots[(robots.step == 0)].waypoint_x.notna().all()
    assert not robots[is_last].shielded.any()
    free = samarl.load_agent("samarl_waypoints", SMALL, shield=False)
    assert not samarl.record(free, case=1).shielded.any()


def test_samarl_record_writes_the_table(tmp_path: Path) -> None:
    words = ["agent=straight", "case=5", "scenario.humans=3", "scenario.robots=2"]
    table = samarl.record("straight", samarl.load_scenario(humans=3, robots=2), case=5)
    done = run("record", *words, "output=case.csv", cwd=tmp_path)
    assert done.stdout == "written to case.csv\n"
    pd.testing.assert_frame_equal(
        pd.read_csv(tmp_path / "case.csv"), table, check_dtype=False, check_exact=False
    )
    done = run("record", "output=case.txt", cwd=tmp_path, code=2)
    assert done.stderr == "error: output is 'case.txt'; it must end in .csv for format=table\n"


def test_a_training_can_be_evaluated_and_resumed(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    scenario = replace(samarl.load_scenario("10p3r"), humans=2, reward=Reward(time=-0.5))
    arguments = {
        "policy": "flat",
        "encoder": {"width": 16},
        "scenario": scenario,
        "worlds": 4,
        "run_dir": tmp_path / "run (1)",
    }
    trained = samarl.train(trainer=SHORT_TRAINING, **arguments)
    folder = tmp_path / "run (1)"
    assert trained.folder == folder
    assert trained.scenario == scenario
    assert trained.curves().steps.iloc[-1] == 32
    provenance = json.loads((folder / "last.json").read_text())["provenance"]
    (stage,) = provenance["configuration"]["curriculum"]["stages"]
    assert (stage["worlds"], stage["begin"]) == (4, 0.0)
    assert stage["scenario"] == json.loads(json.dumps(vars(scenario), default=_as_saved))
    assert provenance["command"].startswith("samarl.train(run_dir=")
    result = samarl.evaluate(folder, scenario, cases=2)
    assert result.row["method"] == "run (1)"
    capsys.readouterr()
    for other in (trained.evaluate(cases=2), samarl.evaluate(folder, cases=2)):
        assert (other.episodes.path_length == result.episodes.path_length).all()
    note = capsys.readouterr().err
    assert str(folder) in note
    assert "the scenario of its training" in note

    more = {**SHORT_TRAINING, "steps": 64}
    samarl.train(trainer=more, **arguments)
    assert "resuming at step 32 of 64" in capsys.readouterr().out
    trained.resume(steps=96)
    assert "resuming at step 64 of 96" in capsys.readouterr().out
    with pytest.raises(ConfigurationError, match=r"trainer\.seed is 4; the run in .* has 3"):
        samarl.train(trainer=more | {"seed": 4}, **arguments)


def test_functions_and_objects_are_evaluated() -> None:
    class Mine:
        def act(self, observation: Observation) -> np.ndarray:
            return towards_goals(observation)

    def towards_goals(observation: Observation) -> np.ndarray:
        assert observation.ego.shape[1:2] == (2,)
        return np.zeros((*observation.ego.shape[:2], 3), np.float32)

    of_function = samarl.evaluate(towards_goals, SMALL, cases=2)
    of_object = samarl.evaluate(Mine(), SMALL, cases=2)
    assert [r.row["method"] for r in (of_function, of_object)] == ["towards_goals", "Mine"]
    assert not of_function.success.any()
    assert (of_function.episodes.path_length == of_object.episodes.path_length).all()
    with pytest.raises(ConfigurationError, match=r"agent is 3; it must be"):
        samarl.evaluate(3, SMALL, cases=2)


def _as_saved(value: object) -> object:
    return vars(value) if hasattr(value, "__dataclass_fields__") else str(value)
