"""Hundreds of malformed configurations, each reported in one line."""

from __future__ import annotations

import dataclasses
import gc
import logging
import random
import re
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from hydra._internal.hydra import Hydra
from hydra.core.global_hydra import GlobalHydra

from mrsan import Reward, Scenario
from samarl import api
from samarl.commands import evaluate
from samarl.evaluation.runner import Evaluation
from samarl.files import find_folder
from samarl.user_files import reject_alias_bomb

CHUNKS, CHUNK = 4, 100
OWNERS = {"scenario": Scenario, "scenario.reward": Reward, "evaluation": Evaluation}
FIELDS = [
    (f"{path}.{f.name}", f)
    for path, owner in OWNERS.items()
    for f in dataclasses.fields(owner)
    if "low" in f.metadata
]
SWITCHES = ["scenario.turn_in_place", "scenario.occlusion", "scenario.map_known"]
SWITCHES += ["scenario.reward.literal"]
ENUMS = ["scenario.crowd", "scenario.kinematics", "evaluation.split"]
KNOBS = {
    "orca": ["neighbor_distance", "max_neighbors", "time_horizon", "safety_space"],
    "perimeter": ["radius", "lookahead", "entry_angle"],
    "social_force": ["relaxation_time", "strength", "reach", "wall_strength", "wall_reach"],
    "model_predictive": ["horizon", "directions", "speeds", "holds", "collision_discount"],
}
WORDS = ["fov", "robot", "pedestrians", "seed", "speed", "noise", "lr", "gamma", "x", "Robots"]
JARGON = re.compile(r"full_key|object_type|hydra\.cc|merging override|Exception|config group")
HARMLESS = ["scenario.robots=2", "evaluation.batch=4", "scenario.occlusion=true", "agent=straight"]


def out_of_range(r: random.Random) -> list[str]:
    name, field = r.choice(FIELDS)
    low, high = field.metadata["low"], field.metadata["high"]
    whole = "int" in str(field.type)
    beyond = r.choice([1, 7, 1000]) if whole else r.choice([0.01, 1.5, 1e4])
    return [f"{name}={r.choice([low - beyond, high + beyond])}"]


def not_finite(r: random.Random) -> list[str]:
    name, _ = r.choice(FIELDS)
    return [f"{name}={r.choice(['nan', 'inf', '-inf', 'NaN', '-Inf'])}"]


def wrong_type(r: random.Random) -> list[str]:
    name, field = r.choice([*FIELDS, *[(name, None) for name in SWITCHES]])
    values = ["abc", "[1,2]", "{a: 1}", "''", "1.2.3", "[]", "3m", "'1 000'"]
    if field is None:
        values += ["maybe", "null", "2.5"]
    else:
        values += ["true"] + ["2.5", "1e1"] * ("int" in str(field.type))
        values += ["null"] * ("None" not in str(field.type))
    return [f"{name}={r.choice(values)}"]


def bad_name(r: random.Random) -> list[str]:
    name = r.choice(ENUMS)
    return [f"{name}={r.choice(['orcas', 'TEST', '17', 'null', '[orca]', '1.5', 'none', 'x y'])}"]


def unknown_key(r: random.Random) -> list[str]:
    word, value = r.choice(WORDS), r.choice(["1", "abc", "null", "[1]"])
    path = r.choice(["", "scenario.", "scenario.reward.", "evaluation.", "agent."])
    return [f"{r.choice(['', '+', '++'])}{path}{word}_{r.randint(0, 99)}={value}"]


def deleted_key(r: random.Random) -> list[str]:
    name, _ = r.choice(FIELDS)
    return [r.choice([f"~{name}", f"~{name}_", "~scenario", "~agent", "~evaluation", "~nothing"])]


def broken_syntax(r: random.Random) -> list[str]:
    name, _ = r.choice(FIELDS)
    forms = [
        "{n}",
        "{n}=[1",
        "{n}={{a:",
        "{n}==1",
        "={v}",
        "{n} =,",
        "{n}=1,2,",
        "{n}=(1",
        "+",
        "~",
        "{n}='1",
        "{n}=1]",
        "{n}:3",
        "{n}=${{",
        "{n}=${{1",
        "+={v}",
        "=",
        "{n}=range(1",
        "{n}=a(1)",
        "{n}=choice(1,2)",
        "{n}=1,2",
    ]
    return [r.choice(forms).format(n=name, v=r.randint(0, 9))]


def bad_choice(r: random.Random) -> list[str]:
    group = r.choice(["agent", "scenario", "evaluation"])
    forms = [
        "nobody",
        "Orca",
        "orca.yml",
        "../config",
        "''",
        "null",
        "3",
        "[]",
        "[a,b]",
        "{a: 1}",
        "1.5",
    ]
    prefix = r.choice(["", "", "", "+"])
    return [f"{prefix}{group}={r.choice(forms)}"]


def bad_knob(r: random.Random) -> list[str]:
    agent = r.choice(list(KNOBS))
    knob = f"agent.{r.choice(KNOBS[agent])}"
    value = r.choice(["-1", "1e9", "nan", "inf", "abc", "null", "[1]", "{a: 1}", "true", "???"])
    return [f"agent={agent}", f"{knob}={value}"]


def bad_target(r: random.Random) -> list[str]:
    targets = [
        "null",
        "3",
        "nothing",
        "no.such.module.Agent",
        "os.system",
        "builtins.int",
        "[1]",
        "samarl.agents.planners.orca",
        "samarl.agents.planners.orca.Nobody",
        "''",
        "a b",
        "samarl.agents.agent.Agent",
        "mrsan.Scenario",
        ".Orca",
        "samarl..Orca",
    ]
    agent = r.choice(["orca", "straight"])
    return [f"agent={agent}", f"agent._target_={r.choice(targets)}"]


def bad_interpolation(r: random.Random) -> list[str]:
    name, _ = r.choice(FIELDS)
    forms = [
        "nowhere",
        name,
        "scenario.nothing",
        "oc.env:NO_SUCH_VARIABLE",
        "agent._target_",
        "no:1",
    ]
    return [f"{name}=${{{r.choice(forms)}}}"]


def missing_value(r: random.Random) -> list[str]:
    return [f"{r.choice(FIELDS)[0]}=???"]


def contradiction(r: random.Random) -> list[str]:
    x = r.randint(1, 9)
    return r.choice(
        [
            [f"scenario.humans={x}", f"scenario.humans_min={x + r.randint(1, 9)}"],
            [f"scenario.human_radius_min={0.3 + 0.1 * x:.1f}"],
            [f"scenario.human_speed_max={0.1 * x:.1f}"],
            ["scenario.time_step=0.5", f"scenario.time_limit={0.04 * x:.2f}"],
            [f"scenario.goal_distance={5 + x}"],
            [f"scenario.arena_radius={6 - 0.1 * x:.1f}"],
            ["scenario.robot_speed=2", f"scenario.arena_radius={6.7 - 0.1 * x:.1f}"],
        ]
    )


KINDS: list[Callable[[random.Random], list[str]]] = [
    out_of_range,
    out_of_range,
    out_of_range,
    not_finite,
    wrong_type,
    wrong_type,
    bad_name,
    unknown_key,
    unknown_key,
    deleted_key,
    broken_syntax,
    broken_syntax,
    bad_choice,
    bad_knob,
    bad_target,
    bad_interpolation,
    missing_value,
    contradiction,
]


def malformed(chunk: int) -> list[list[str]]:
    """Command lines, each wrong in one way and otherwise harmless."""
    lines = []
    for number in range(CHUNK):
        r = random.Random(1000 * chunk + number)
        wrong = KINDS[number % len(KINDS)](r)
        extra = [] if any(o.startswith("agent") for o in wrong) else r.sample(HARMLESS, 1)
        lines.append(["evaluation.cases=1", *extra, *wrong] if number % 3 else wrong)
    return lines


@pytest.fixture
def bare(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Iterator[None]:
    """A place of its own, and no traces."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("HYDRA_FULL_ERROR", "1")
    monkeypatch.setattr(sys, "path", list(sys.path))
    gc.disable()  # composing leaves many small objects; collecting them takes half of the time
    yield
    gc.enable()
    GlobalHydra.instance().clear()


def run(arguments: list[str], monkeypatch: pytest.MonkeyPatch) -> Any:
    """The exit code of the command, or what escaped from it."""
    monkeypatch.setattr(sys, "argv", ["samarl-evaluate", *arguments])
    # As in a shell: no log handler of pytest that would swallow a second line.
    monkeypatch.setattr(logging.getLogger(), "handlers", [])
    GlobalHydra.instance().clear()
    try:
        evaluate.main()
    except SystemExit as end:
        return end.code
    except Exception as error:
        return error
    return "no complaint"


@pytest.mark.parametrize("chunk", range(CHUNKS))
def test_every_malformed_configuration_ends_in_one_line(
    chunk: int, bare: None, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    # A configuration that reaches the simulator is valid by accident and reported as a failure.
    monkeypatch.setattr(api, "run_cases", lambda *_: pytest.fail("valid", pytrace=False))
    # Hydra composes twice, first to find out whether it sweeps, which takes most of the time.
    # Nine of ten command lines skip this.
    get_mode = Hydra.get_mode
    failures = []
    for number, arguments in enumerate(malformed(chunk)):
        skip = number % 10 != 0
        monkeypatch.setattr(Hydra, "get_mode", (lambda *_, **__: None) if skip else get_mode)
        capsys.readouterr()
        try:
            code = run(arguments, monkeypatch)
        except pytest.fail.Exception:
            code = "no error"
        output = capsys.readouterr().err
        lines = output.splitlines()
        if JARGON.search(output):
            failures.append(f"{' '.join(arguments)}\n    -> {output.strip()[-300:]}")
        if code != 2 or len(lines) != 1 or not lines[0].startswith("error: "):
            failures.append(f"{' '.join(arguments)}\n    -> {code!r}: {output.strip()[-300:]}")
    assert not failures, f"{len(failures)} of {CHUNK}:\n" + "\n".join(failures)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["scenario.fov_degrees=400"], "scenario.fov_degrees is 400.0; it must lie in (0, 360]"),
        (["scenario.robots=0"], "scenario.robots is 0; it must be a whole number in [1, 16]"),
        (
            ["scenario.humans_min=11"],
            "scenario.humans_min is 11; it must not exceed scenario.humans",
        ),
        (
            ["agent.max_neighbors=0"],
            "agent.max_neighbors is 0; it must be a whole number in [1, 80]",
        ),
        (
            ["agent=nobody"],
            "error: agent is 'nobody', which does not exist; ",
        ),
        (["agent=samrl"], "agent is 'samrl', which does not exist; did you mean samarl, "),
        (["agent=null"], "agent is 'null', which does not exist"),
        (["scenario.robots=[1,2]"], "scenario.robots: Value '[1, 2]'"),
        (["scenario.robots=(1"], "scenario.robots: Value '(1'"),
        (["scenario.robots=null"], "scenario.robots: field 'scenario.robots' is not Optional"),
        (["scenario.robots=???"], "scenario.robots has no value"),
        (["scenario.robots.x=1"], "scenario.robots: Value"),
        (["scenario.occlusion=maybe"], "scenario.occlusion: Value 'maybe' is not a valid bool"),
        (["agent.max_neighbors=2.5"], "agent.max_neighbors: Value '2.5'"),
        (["plugins=abc"], "plugins: Invalid value assigned: str is not a ListConfig"),
        (["+scenario.robots=3"], "'+scenario.robots=3' is not a setting"),
        (
            ["agent.shield.horizn=1"],
            "horizn is not known; did you mean agent.shield.horizon?",
        ),
        (["agent.shild=false"], "agent.shild is not known; did you mean agent.shield?"),
        (["robots=3"], "robots is not known; did you mean scenario.robots?"),
        (
            ["scenario.robots_visible=true"],
            "scenario.robots_visible is not known; it is now scenario.crowd_reaction=reciprocal",
        ),
        (["robots_visible=true"], "it is now scenario.crowd_reaction=reciprocal"),
        (["scenario.human=5"], "scenario.human is not known; did you mean scenario.humans?"),
        (["scenario.dt=0.1"], "scenario.dt is not known; did you mean scenario.time_step?"),
        (["agent=samarl", "checkpoint=nobody"], "checkpoint is 'nobody', which does not exist"),
        (["agent=samarl", "checkpoint=nobody"], "results/checkpoints, such as samarl\n"),
        (["agent=samarl", "checkpoint=samarl_fla"], "; did you mean samarl_flat, "),
        (["scenario.robotz=3"], "scenario.robotz is not known; did you mean scenario.robots?"),
        (["scenario.fov=90"], "scenario.fov is not known; did you mean scenario.fov_degrees?"),
        (["scenario.reward.progres=1"], "did you mean scenario.reward.progress?"),
        (["agent.max_neighbours=3"], "did you mean agent.max_neighbors?"),
        (["evaluation.case=1"], "evaluation.case is not known; did you mean evaluation.cases?"),
        (["agnt=orca"], "agnt is not known; did you mean agent?"),
        (
            ["scenario.crowd=orcas"],
            "scenario.crowd is 'orcas'; it must be one of orca, social_force, still, recorded",
        ),
        (["scenario.reward.progress=inf"], "scenario.reward.progress is inf; it must lie in"),
    ],
)
def test_the_message_names_the_field_the_value_and_the_range(
    arguments: list[str],
    message: str,
    bare: None,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert run(arguments, monkeypatch) == 2
    assert message in capsys.readouterr().err


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("agent/a.yaml", "# Zürich\n".encode("latin-1"), "agent/a.yaml is not UTF-8 text"),
        ("agent/a.yaml", "_target_: x".encode("utf-16"), "agent/a.yaml is not UTF-8 text"),
        ("agent/a.yaml", b"a: [1", "agent/a.yaml is not YAML: line 1: expected ',' or ']'"),
        (
            "scenario/a.yaml",
            b"defaults: [samarl]\nrobots: [1, 2]",
            "scenario/a.yaml: scenario.robots: Value '[1, 2]'",
        ),
        (
            "scenario/a.yaml",
            b"defaults: [samarl]\nrobotz: 3",
            "scenario/a.yaml: scenario.robotz is not known; did you mean scenario.robots?",
        ),
        (
            "agent/a.yaml",
            b"_target_: samarl.agents.planners.perimeter.Perimeter\nradius: [1]\n",
            "agent.radius: Value '[1]'",
        ),
    ],
)
def test_the_message_names_the_file_of_the_user(
    name: str,
    content: bytes,
    message: str,
    bare: None,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    path = Path("my conf (1)", name)
    path.parent.mkdir(parents=True)
    path.write_bytes(content)
    other = Path("my conf (1)/agent/unused.yaml")  # malformed as well, but not read
    other.parent.mkdir(exist_ok=True)
    other.write_bytes(b"\xff")
    group = path.parent.name
    assert run(["--config-dir", "my conf (1)", f"{group}=a"], monkeypatch) == 2
    said = capsys.readouterr().err
    assert message in said
    assert said.count("\n") == 1


@pytest.mark.parametrize(
    ("swept", "message"),
    [
        (["scenario.robots=1,99"], "scenario.robots is 99; it must be a whole number in [1, 16]"),
        (["agent=straight,nobody"], "agent is 'nobody', which does not exist"),
        (["agent=orca", "agent.max_neighbors=3,0"], "agent.max_neighbors is 0; it must be"),
        (["scenario=recorded", "scenario.recording=null,no (1).txt"], "no (1).txt"),
        (["scenario.time_limit=10,0.1"], "time_step is 0.25; it must not exceed"),
        (["evaluation.cases=1,0"], "evaluation.cases is 0; it must be a whole number in"),
        (["agent=samarl", "checkpoint=samarl_ppo,cadrl"], "checkpoint is 'cadrl', a lookahead"),
    ],
)
def test_every_cell_of_a_sweep_is_checked_before_the_first_is_run(
    swept: list[str],
    message: str,
    bare: None,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setattr(api, "run_cases", lambda *_: pytest.fail("played", pytrace=False))
    assert run(["-m", "agent=straight", *swept], monkeypatch) == 2
    said = capsys.readouterr().err.splitlines()
    assert message in said[-1]
    assert not [line for line in said[:-1] if not line.startswith("Compiling")]
    assert list(Path().iterdir()) == []


def test_a_checkpoint_of_another_kind_of_policy_is_refused(
    bare: None, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    for setting in ("checkpoint=samarl_flat", "agent.checkpoint=samarl_flat"):
        assert run(["agent=cadrl", setting], monkeypatch) == 2
        said = capsys.readouterr().err
        assert "checkpoint is 'samarl_flat', a flat policy; it must be a lookahead policy" in said
        assert "agent=samarl_flat" in said


@pytest.mark.parametrize("bomb", ["billion laughs", "recursive"])
def test_files_whose_aliases_would_fill_the_memory_are_rejected(
    bomb: str, bare: None, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Ten lines that expand to 10^9 values would exhaust the memory."""
    lines = ["a: &a [x, x, x, x, x, x, x, x, x, x]"]
    for above, below in zip("abcdefgh", "bcdefghi", strict=True):
        lines.append(f"{below}: &{below} [{', '.join([f'*{above}'] * 10)}]")
    Path("mine/agent").mkdir(parents=True)
    Path("mine/agent/bomb.yaml").write_text(
        "&a [*a]" if bomb == "recursive" else "\n".join(lines), encoding="utf-8"
    )
    for extra in ([], ["--help"]):
        assert run(["--config-dir=mine", "agent=bomb", *extra], monkeypatch) == 2
        assert "agent/bomb.yaml has more than 100000 values" in capsys.readouterr().err


def test_common_uses_of_aliases_are_accepted(tmp_path: Path) -> None:
    (tmp_path / "few.yaml").write_text("a: &a {x: 1}\nb: [*a, *a]\nc: {<<: *a}\n")
    for file in (tmp_path / "few.yaml", *find_folder("conf").rglob("*.yaml")):
        reject_alias_bomb(file)
