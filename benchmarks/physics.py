"""How policies drive bodies with mass, motors and wheels: `python -m benchmarks.physics`.

The same cases are played in `mrsan` and in MuJoCo (docs/physics.md): those of SAMARL and MSA3C's
20p3r, which that paper played in PyBullet. Then SAMARL's robots get worse one setting at a time.
An interrupted run resumes: rows in the output are not evaluated again; delete it to start over.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import samarl
from benchmarks.workload import add_output, interruptible, positive_whole_number, provenance
from mrsan import Scenario
from samarl.configuration import load_scenario
from samarl.evaluation.methods import label_of
from samarl.evaluation.summary import Row
from samarl.evaluation.table import markdown_table
from samarl.files import read_json, write_json, write_text
from samarl.physics.engine import MujocoEngine
from samarl.progress import progress_bar

LATENCY = 0.05  # s, of the column that policies must withstand
AGENTS = {
    "samarl": (
        "orca",
        "social_force",
        "model_predictive",
        "perimeter",
        "cadrl",
        "samarl_waypoints",
        "samarl_general",
    ),
    "20p3r": ("orca", "msa3c", "msa3cpred"),
}
FIRST = ("samarl_waypoints", "msa3c", "msa3cpred")  # are evaluated first
# Share of the robots' time in people's comfort zones, % (MSA3C, in PyBullet: 20 people, 3 robots).
PAPER_INTRUSIONS = {"msa3cpred": 2.66, "msa3c": 6.77}
HARDER: tuple[dict[str, Any], ...] = (  # one setting at a time
    {"engine.latency": 0.1},
    {"engine.latency": 0.2},
    {"engine.motor_torque": 1.0},
    {"engine.motor_torque": 0.5},
    {"engine.friction": 0.1},
    {"engine.friction": 0.05},
    {"engine.odometry_drift": 0.005},
    {"engine.odometry_drift": 0.02},
    {"scenario.position_noise": 0.1},
    {"scenario.velocity_noise": 0.2},
    {"scenario.missed_detection": 0.3},
)


@dataclass
class Run:
    """One row: an agent in a scenario and an engine, with some settings changed."""

    scenario: str
    agent: str
    engine: str = "mujoco"
    changes: dict[str, Any] = field(default_factory=dict)  # overrides of `samarl-evaluate`

    def command(self, cases: int) -> str:
        """Return the command that evaluates the row."""
        words = ["samarl-evaluate", f"agent={self.agent}"]
        words += [f"scenario={self.scenario}"] if self.scenario != Scenario.name else []
        words += [f"engine={self.engine}"] if self.engine != "mrsan" else []
        words += [f"{name}={value}" for name, value in self.changes.items()]
        return " ".join([*words, f"evaluation.cases={cases}"])

    def row(self, cases: int) -> Row:
        """Evaluate the row."""
        scenario = replace(load_scenario(self.scenario), **self._of("scenario"))
        engine = MujocoEngine(**self._of("engine")) if self.engine == "mujoco" else None
        command = self.command(cases)
        return samarl.evaluate(self.agent, scenario, cases, engine=engine, command=command).row

    def _of(self, group: str) -> dict[str, Any]:
        prefix = f"{group}."
        return {
            name.removeprefix(prefix): value
            for name, value in self.changes.items()
            if name.startswith(prefix)
        }


def engines_of(scenario: str, agent: str) -> list[Run]:
    """Return the rows of an agent: in `mrsan`, in MuJoCo, and there with latency."""
    return [
        Run(scenario, agent, "mrsan"),
        Run(scenario, agent),
        Run(scenario, agent, changes={"engine.latency": LATENCY}),
    ]


def harder_runs() -> list[Run]:
    """Return the rows of SAMARL-Waypoints in harder physics."""
    return [Run("samarl", "samarl_waypoints", changes=changes) for changes in HARDER]


def all_runs() -> list[Run]:
    """Return all rows, the most important first."""
    compared = [run for s, agents in AGENTS.items() for a in agents for run in engines_of(s, a)]
    return sorted([*compared, *harder_runs()], key=lambda run: run.agent not in FIRST)


def main() -> None:
    """Evaluate the rows that are missing, write the JSON and the Markdown file."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.physics", description=(__doc__ or "").partition("\n")[0]
    )
    parser.add_argument("--cases", type=positive_whole_number, default=100, help="per row (100)")
    add_output(parser, "physics")
    arguments = parser.parse_args()
    output: Path = arguments.output
    rows: list[Row] = read_json(output)["rows"] if output.exists() else []
    with interruptible():
        for run in progress_bar(all_runs(), desc="physics", unit="row"):
            command = run.command(arguments.cases)
            if any(row["command"] == command for row in rows):
                continue
            rows.append(run.row(arguments.cases))
            write_json(output, {"rows": rows, **provenance("physics")})
            write_text(output.with_suffix(".md"), page(rows, arguments.cases))
    text = page(rows, arguments.cases)
    write_text(output.with_suffix(".md"), text)
    print(text)
    print(f"written to {output} and {output.with_suffix('.md').name}")


def page(rows: list[Row], cases: int) -> str:
    """Return the tables as Markdown."""
    by_command = {row["command"]: row for row in rows}

    def row_of(run: Run) -> Row | None:
        return by_command.get(run.command(cases))

    text = "# Robots in MuJoCo\n\n"
    for scenario, agents in AGENTS.items():
        lines = []
        for agent in agents:
            for name, run in zip(_ENGINES, engines_of(scenario, agent), strict=True):
                if (row := row_of(run)) is not None:
                    lines.append([label_of(agent), name, *_cells(row)])
            if scenario == "20p3r" and agent in PAPER_INTRUSIONS:
                figures = ["", "", "", "", f"{PAPER_INTRUSIONS[agent]:.2f}", "", "", ""]
                lines.append([label_of(agent), "paper: PyBullet", *figures])
        text += f"## {_TITLES[scenario]}\n\n{markdown_table(_HEADER, lines)}\n\n"
    ideal, *in_physics = engines_of("samarl", "samarl_waypoints")
    baseline = row_of(ideal)
    lines = []
    for run in [*in_physics, *harder_runs()]:
        row = row_of(run)
        if row is not None and baseline is not None:
            setting = " ".join(f"{name}={value}" for name, value in run.changes.items())
            share = 100 * row["success_rate"] / baseline["success_rate"]
            lines.append([setting or "defaults", *_cells(row), f"{share:.0f}"])
    header = ["setting", *_HEADER[2:], "share of success in mrsan %"]
    text += f"## What SAMARL-Waypoints withstands\n\n{markdown_table(header, lines)}\n\n"
    commits = ", ".join(sorted({row["commit"] for row in rows}))
    return (
        f"{text}The first {cases} test cases per row. Created by `python -m benchmarks.physics` at "
        f"commit {commits}; `physics.json` has the command that reproduces each row.\n"
    )


_ENGINES = ("mrsan", "MuJoCo", f"MuJoCo, {1000 * LATENCY:g} ms")
_TITLES = {
    "samarl": "SAMARL's task: 10 people, 3 robots with a differential drive",
    "20p3r": "MSA3C's 20p3r: 20 people, 3 robots with mecanum wheels",
}
_HEADER = [
    "method",
    "engine",
    "success % [95 %]",
    "hit human %",
    "hit robot %",
    "timeout %",
    "intrusions %",
    "path m",
    "time s",
    "command error cm",
]


def _cells(row: Row) -> list[str]:
    error = row.get("tracking_error")
    lengths = [row["path_length"], row["time_to_goal"]]
    return [
        f"{row['success_rate']:.0f} [{row['success_low']:.0f}, {row['success_high']:.0f}]",
        *(f"{row[f'{name}_rate']:.0f}" for name in ("human_collision", "robot_collision")),
        f"{row['timeout_rate']:.0f}",
        f"{row['cir']:.2f}",
        *("-" if length is None else f"{length:.1f}" for length in lengths),
        "" if error is None else f"{100 * error:.1f}",
    ]


if __name__ == "__main__":
    main()
