"""Measure when a macro level pays: `python -m benchmarks.hierarchy`.

Policies of one level and of two levels are trained with several seeds, all starting from the same
policy, which drives well among walls, in doorways and corridors where robots must decide who goes
first. They are evaluated on test cases without the shield: in a narrow doorway and a narrow
corridor, and in doorways of many widths with different numbers of robots, with people and without.
In the first two, the macro actions of the policies with modes are also replaced by random ones and
by those of team-mates. Runs are kept in a folder: interrupted ones are resumed, and finished ones
are not trained again. Use another folder for trials with `--steps`.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from benchmarks.workload import add_output, interruptible, positive_whole_number, provenance
from mrsan import Layout, Scenario, Split, TeamPerception
from mrsan.place import Place
from samarl.agents.learned import DeployedPolicy
from samarl.evaluation.metrics import wilson_interval
from samarl.evaluation.runner import run_cases
from samarl.evaluation.table import markdown_table
from samarl.files import machine, write_json, write_text
from samarl.policies.checkpoint import load_policy
from samarl.policies.macro_actions import Waypoints
from samarl.progress import progress_bar

COMMON = ["experiment=passages", "trainer.threads=1"]
TEAM = [f"curriculum.stages.{stage}.scenario.team_perception=tracks" for stage in range(4)]
TWO_LEVELS = [
    "algorithm.local_discount=0.95",
    "algorithm.discount=0.998",  # waiting for 6 s would cost a fifth of the return with 0.99
]
MODES = [*TWO_LEVELS, "policy.modes=true", "algorithm.macro_entropy_coefficient=0.05"]
LONG_HORIZON = ["policy=flat", "algorithm.local_discount=0.998"]
STANDSTILL = [
    f"curriculum.stages.{stage}.standstill_{name}"
    for stage in range(4)
    for name in ("limit=10", "penalty=20")
]
RECIPES = {  # settings, in addition to `COMMON`
    "two levels, modes": MODES,
    "two levels, modes, events": [*MODES, "policy.macro_steps=24", "policy.ends_when_blocked=true"],
    "two levels": TWO_LEVELS,
    "flat": ["policy=flat"],
    "flat, long horizon": LONG_HORIZON,
    "two levels, modes, intent": [*MODES, "policy.observes_intent=true", *TEAM],
    "flat, team tracks": ["policy=flat", *TEAM],
    "two levels, modes, standstill": [*MODES, *STANDSTILL],
    "two levels, modes, standstill, macro reward": [
        *MODES,
        *STANDSTILL,
        "algorithm.macro_advantage_reward=0.1",
    ],
    "flat, long horizon, standstill": [*LONG_HORIZON, *STANDSTILL],
}
ABLATIONS = {
    "random macro actions": Waypoints.random,
    "macro actions of team-mates": Waypoints.shuffled,
}
NARROW = (1.0, 1.3)  # m, the doorway and the corridor of the first table
WIDTHS = (0.9, 1.2, 1.6, 2.0, 2.5)  # m, of doorways
ROBOTS = (2, 4, 6)
PEOPLE = (0, 4)

Row = dict[str, Any]


class Cell(NamedTuple):
    """A scenario of the evaluation."""

    layout: Layout
    width_min: float  # m, of the doorway or corridor
    width_max: float
    robots: int
    people: int

    def scenario(self, team_perception: bool) -> Scenario:
        """Return the scenario, with or without team perception."""
        return Scenario(
            layout=self.layout,
            place=Place(
                door_width_min=self.width_min,
                door_width_max=self.width_max,
                corridor_width_min=self.width_min,
                corridor_width_max=self.width_max,
            ),
            robots=self.robots,
            humans=self.people,
            robots_visible=True,
            nearest_walls=12,
            team_perception=TeamPerception.tracks if team_perception else TeamPerception.none,
        )


PASSAGES = [Cell(layout, *NARROW, 4, 4) for layout in (Layout.doorway, Layout.corridor)]
DOORWAYS = [
    Cell(Layout.doorway, width, width, robots, people)
    for people in PEOPLE
    for robots in ROBOTS
    for width in WIDTHS
]


def main() -> None:
    """Train what is missing, evaluate, and write the JSON file, the tables and the figure."""
    arguments = _parse()
    rows: list[Row] = []
    with interruptible():
        for recipe in arguments.recipes:
            for seed in range(arguments.seeds):
                path = train(recipe, seed, arguments.steps, arguments.folder)
                rows += evaluate(recipe, seed, path, arguments.cases)
    result = {"cases": arguments.cases, "rows": rows, **provenance("hierarchy")}
    write_json(arguments.output, result)
    text = f"{narrow_table(rows, arguments.cases)}\n\n{width_table(rows)}\n\n{caption(result)}\n"
    write_text(arguments.output.with_suffix(".md"), text)
    draw(rows, arguments.output.with_suffix(".png"))
    print(f"{text}written to {arguments.output}")


def train(recipe: str, seed: int, steps: int | None, folder: Path) -> Path:
    """Train a recipe, or resume it; return its policy at the end of the training."""
    run = folder / f"{recipe.replace(', ', '_').replace(' ', '_')}_seed{seed}"
    settings = [*COMMON, *RECIPES[recipe], f"trainer.seed={seed}"]
    if steps is not None:
        settings.append(f"trainer.steps={steps}")
    command = [sys.executable, "-m", "samarl.commands.train", *settings, f"run_dir={run}"]
    print(f"{recipe}, seed {seed}", flush=True)
    subprocess.run(command, check=True)
    return run / "last.safetensors"


def evaluate(recipe: str, seed: int, path: Path, cases: int) -> list[Row]:
    """Return the rows of a policy in all scenarios."""
    policy, _ = load_policy(path)
    team_perception = TEAM[0] in RECIPES[recipe]
    numbers = Split.test.case(0) + np.arange(cases)
    rows = []
    for method, waypoints, cell in progress_bar(
        list(_evaluations(recipe)), desc=recipe, unit="cell"
    ):
        scenario = cell.scenario(team_perception)
        agent = DeployedPolicy(policy, scenario, waypoints)
        episodes = run_cases(agent, scenario, numbers, 128)
        finished = episodes.success
        makespan = episodes.time.max(1)[finished]
        rows.append(
            {
                "method": method,
                "seed": seed,
                "layout": cell.layout.name,
                "width_min": cell.width_min,
                "width_max": cell.width_max,
                "robots": cell.robots,
                "people": cell.people,
                "success": round(100 * float(finished.mean()), 2),
                "deadlock": round(100 * float(episodes.deadlock.mean()), 2),
                "timeout": round(100 * float(episodes.timeout.mean()), 2),
                "makespan": round(float(makespan.mean()), 2) if finished.any() else None,
            }
        )
    return rows


def _evaluations(recipe: str) -> Iterator[tuple[str, Waypoints, Cell]]:
    for cell in (*PASSAGES, *DOORWAYS):
        yield recipe, Waypoints.learned, cell
    if recipe == "two levels, modes":
        for method, waypoints in ABLATIONS.items():
            for cell in PASSAGES:
                yield method, waypoints, cell


def methods_of(rows: list[Row]) -> list[str]:
    """Return the methods, in the order in which they were evaluated."""
    return list(dict.fromkeys(row["method"] for row in rows))


def of_cell(rows: list[Row], method: str, cell: Cell) -> list[Row]:
    """Return the rows of a method in a scenario, one for each seed."""
    expected = (method, cell.layout.name, *cell[1:])
    keys = ("method", "layout", "width_min", "width_max", "robots", "people")
    return [row for row in rows if tuple(row[key] for key in keys) == expected]


def narrow_table(rows: list[Row], cases: int) -> str:
    """Return the table of the narrow doorway and corridor, with 95 % intervals over all seeds."""
    header = ["method"]
    for cell in PASSAGES:
        header += [f"{cell.layout.name}: success %", "each seed", "deadlock %", "makespan s"]
    lines = []
    for method in methods_of(rows):
        line = [method]
        for cell in PASSAGES:
            of_method = of_cell(rows, method, cell)
            success = [row["success"] for row in of_method]
            number = cases * len(success)
            low, high = wilson_interval(round(np.mean(success) / 100 * number), number)
            line += [
                f"{np.mean(success):.1f} [{100 * low:.1f}, {100 * high:.1f}]",
                ", ".join(f"{value:.1f}" for value in success),
                f"{np.mean([row['deadlock'] for row in of_method]):.1f}",
                _mean([row["makespan"] for row in of_method]),
            ]
        lines.append(line)
    return markdown_table(header, lines)


def width_table(rows: list[Row]) -> str:
    """Return the table of doorways: success and deadlocks by width, robots and people."""
    header = ["method", "robots", "people", *(f"{width} m" for width in WIDTHS)]
    lines = []
    for method in methods_of(rows):
        for people in PEOPLE:
            for robots in ROBOTS:
                of_widths = [
                    of_cell(rows, method, Cell(Layout.doorway, width, width, robots, people))
                    for width in WIDTHS
                ]
                if all(of_widths):
                    cells = [
                        " / ".join(
                            _mean([row[key] for row in of_width]) for key in ("success", "deadlock")
                        )
                        for of_width in of_widths
                    ]
                    lines.append([method, str(robots), str(people), *cells])
    return markdown_table(header, lines)


def caption(result: dict[str, Any]) -> str:
    """Return the lines below the tables."""
    seeds = len({row["seed"] for row in result["rows"]})
    low, high = NARROW
    return (
        f"First table: a doorway and a corridor {low} to {high} m wide, 4 robots and 4 people; "
        "success is joint, with a 95 % Wilson interval that pools the cases of all seeds and "
        "ignores the variance between them; the makespan is that of successful cases. Second "
        "table: success % / deadlock % in doorways by their width; bands in the figure span the "
        "seeds. "
        f"{result['cases']} test cases of each scenario, "
        f"{seeds} training seeds, without the shield, on {machine()}, commit {result['commit']}: "
        f"`{result['command']}`"
    )


def draw(rows: list[Row], path: Path) -> None:
    """Draw success over the width of the doorway: one panel per number of robots and people."""
    import matplotlib.pyplot as plt

    figure, panels = plt.subplots(
        len(PEOPLE), len(ROBOTS), figsize=(7.6, 4.6), sharex=True, sharey=True, layout="constrained"
    )
    for line, people in enumerate(PEOPLE):
        for column, robots in enumerate(ROBOTS):
            axes = panels[line, column]
            for index, method in enumerate(methods_of(rows)):
                seeds = [
                    [row["success"] for row in of_cell(rows, method, cell)]
                    for cell in DOORWAYS
                    if (cell.robots, cell.people) == (robots, people)
                ]
                if not all(seeds):
                    continue
                success = np.array(seeds)  # [W, seeds]
                label = method if (line, column) == (0, 0) else None
                axes.plot(WIDTHS, success.mean(1), "o-", ms=3, color=f"C{index}", label=label)
                axes.fill_between(
                    WIDTHS, success.min(1), success.max(1), color=f"C{index}", alpha=0.15, lw=0
                )
            axes.set_title(f"{robots} robots, {people or 'no'} people", fontsize=9)
            axes.set(ylim=(0, 100), xlim=(WIDTHS[0], WIDTHS[-1]))
            axes.grid(color="0.9", linewidth=0.6)
            for side in ("top", "right"):
                axes.spines[side].set_visible(False)
    figure.supxlabel("width of the doorway (m)", fontsize=9)
    figure.supylabel("joint success (%)", fontsize=9)
    figure.legend(loc="outside upper center", ncols=3, frameon=False, fontsize=8)
    figure.savefig(path, dpi=160)
    plt.close(figure)


def _mean(values: list[float | None]) -> str:
    """Return the mean of the values that are there."""
    present = [value for value in values if value is not None]
    return f"{np.mean(present):.1f}" if present else "-"


def _parse() -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.hierarchy", description=(__doc__ or "").partition("\n")[0]
    )
    parser.add_argument(
        "--recipes", nargs="+", choices=list(RECIPES), default=list(RECIPES), help="to compare"
    )
    parser.add_argument("--seeds", type=positive_whole_number, default=3, help="of each (3)")
    parser.add_argument("--steps", type=positive_whole_number, help="of training, for a trial")
    parser.add_argument(
        "--cases", type=positive_whole_number, default=200, help="test cases per scenario (200)"
    )
    folder = Path("outputs/hierarchy")
    parser.add_argument("--folder", type=Path, default=folder, help=f"of the runs ({folder})")
    add_output(parser, "hierarchy")
    return parser.parse_args()


if __name__ == "__main__":
    main()
