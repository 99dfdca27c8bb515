"""Measure how fast recipes learn: `python -m benchmarks.learning_speed`.

Every recipe is trained with several seeds, one after another, in two processes of one thread each,
and validated without the shield on 500 cases among ten people at a view of 360 degrees. Reported
are the time and the steps to the first validation at which 80, 90 and 95 % of the cases with three
robots succeed, and the success of the last validation. Time is that of training alone, without
validating and saving. Interrupted runs are resumed: the folder keeps them.
"""

from __future__ import annotations

import argparse
import csv
import statistics
import subprocess
import sys
from pathlib import Path
from typing import Any

from benchmarks.workload import add_output, interruptible, positive_whole_number, provenance
from samarl.evaluation.table import markdown_table
from samarl.files import machine, write_json, write_text

RECIPES = {  # settings and world-steps
    "flat": (["policy=flat"], 1_000_000),
    "two levels": ([], 1_000_000),
    "two levels, goal hidden": (["policy=goal_hidden", "algorithm.macro_std=0.4"], 1_000_000),
    "flat, transformer": (["experiment=transformer", "policy=flat"], 1_000_000),
    "two levels, transformer": (["experiment=transformer"], 1_000_000),
}
DEFAULT = ["flat", "two levels"]  # recipes to train unless others are named
COMMON = [
    "trainer.processes=2",
    "trainer.threads=1",
    "trainer.validation_cases=500",
    "trainer.validate_every=50000",
]
THRESHOLDS = (0.8, 0.9, 0.95)
SUCCESS = "validation/success_360_10h_3r"
SUCCESS_OF_FIVE = "validation/success_360_10h_5r"

Curve = list[dict[str, float]]


def main() -> None:
    """Train what is missing, print the table, and write the JSON file, the table and the figure."""
    arguments = _parse()
    curves: dict[str, list[Curve]] = {}
    with interruptible():
        for recipe in arguments.recipes:
            curves[recipe] = [
                train(recipe, seed, arguments.steps, arguments.folder)
                for seed in range(arguments.seeds)
            ]
    recipes = {recipe: summary(of_recipe) for recipe, of_recipe in curves.items()}
    result = {"recipes": recipes, **provenance("learning_speed")}
    write_json(arguments.output, result)
    table = table_of(recipes)
    write_text(arguments.output.with_suffix(".md"), f"{table}\n\n{caption(result)}\n")
    draw(curves, arguments.output.with_suffix(".png"))
    print(table)
    print(f"\n{caption(result)}\nwritten to {arguments.output}")


def train(recipe: str, seed: int, steps: int | None, folder: Path) -> Curve:
    """Train a recipe, or resume it; return the validations of its learning curve."""
    run = folder / f"{recipe.replace(', ', '_').replace(' ', '_')}_{seed}"
    settings, usual_steps = RECIPES[recipe]
    command = [sys.executable, "-m", "samarl.commands.train", *settings, *COMMON]
    command += [f"trainer.seed={seed}", f"trainer.steps={steps or usual_steps}", f"run_dir={run}"]
    print(f"{recipe}, seed {seed}", flush=True)
    subprocess.run(command, check=True)
    with (run / "progress.csv").open(encoding="utf-8") as file:
        rows = [row for row in csv.DictReader(file) if row.get(SUCCESS)]
    keys = ("steps", "seconds", SUCCESS, SUCCESS_OF_FIVE)
    return [{key: float(row[key]) for key in keys} for row in rows]


def summary(curves: list[Curve]) -> dict[str, Any]:
    """Return what the table says of one recipe; null where a seed never reaches a threshold."""
    result: dict[str, Any] = {}
    for threshold in THRESHOLDS:
        first = [
            next((row for row in curve if row[SUCCESS] >= threshold), None) for curve in curves
        ]
        for key in ("seconds", "steps"):
            values = [None if row is None else row[key] for row in first]
            result[f"{key}_to_{round(100 * threshold)}"] = values
    result["final_success_3_robots"] = [curve[-1][SUCCESS] for curve in curves]
    result["final_success_5_robots"] = [curve[-1][SUCCESS_OF_FIVE] for curve in curves]
    result["seconds"] = [curve[-1]["seconds"] for curve in curves]
    result["steps"] = [curve[-1]["steps"] for curve in curves]
    return result


def table_of(recipes: dict[str, dict[str, Any]]) -> str:
    """Return the Markdown table: means over the seeds, and the smallest and largest value."""
    header = ["recipe", *(f"s to {round(100 * t)} %" for t in THRESHOLDS)]
    header += ["steps to 90 %", "steps in all", "s in all", "success 3 / 5 robots at the end"]
    lines = []
    for recipe, of_recipe in recipes.items():
        line = [recipe]
        for threshold in THRESHOLDS:
            line.append(_cell(of_recipe[f"seconds_to_{round(100 * threshold)}"]))
        line.append(_cell(of_recipe["steps_to_90"]))
        line += [f"{max(of_recipe['steps']):,.0f}", _cell(of_recipe["seconds"])]
        final = (of_recipe[f"final_success_{n}_robots"] for n in (3, 5))
        line.append(" / ".join(f"{100 * statistics.mean(values):.1f}" for values in final))
        lines.append(line)
    return markdown_table(header, lines)


def caption(result: dict[str, Any]) -> str:
    """Return the line below the table."""
    seeds = len(next(iter(result["recipes"].values()))["seconds"])
    return (
        f"Means of {seeds} seeds [smallest, largest]; {machine()}, "
        f"commit {result['commit']}: `{result['command']}`"
    )


def draw(curves: dict[str, list[Curve]], path: Path) -> None:
    """Draw the success of every run over the time of training."""
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(figsize=(7.6, 3.6), layout="constrained")
    for index, (recipe, of_recipe) in enumerate(curves.items()):
        for number, curve in enumerate(of_recipe):
            axes.plot(
                [row["seconds"] / 60.0 for row in curve],
                [100 * row[SUCCESS] for row in curve],
                color=f"C{index}",
                linewidth=1.2,
                label=recipe if number == 0 else None,
            )
    axes.axhline(90, color="0.6", linewidth=0.8, linestyle=":")
    axes.set(
        xlabel="minutes of training", ylabel="success, 3 robots (%)", ylim=(0, 100), xlim=(0, None)
    )
    figure.legend(loc="outside right upper", frameon=False, fontsize=8)
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)
    figure.savefig(path, dpi=160)
    plt.close(figure)


def _cell(values: list[float | None]) -> str:
    """Return the mean, the smallest and the largest value."""
    present = [value for value in values if value is not None]
    if len(present) < len(values):
        return f"{len(present)} of {len(values)} seeds"
    mean, low, high = statistics.mean(present), min(present), max(present)
    return f"{mean:,.0f} [{low:,.0f}, {high:,.0f}]"


def _parse() -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.learning_speed", description=(__doc__ or "").partition("\n")[0]
    )
    parser.add_argument(
        "recipes",
        nargs="*",
        default=DEFAULT,
        help=f"which of {'; '.join(RECIPES)} (default: {'; '.join(DEFAULT)})",
    )
    parser.add_argument("--seeds", type=positive_whole_number, default=3, help="per recipe (3)")
    parser.add_argument(
        "--steps", type=positive_whole_number, help="world-steps (each recipe's own)"
    )
    folder = Path("outputs/learning_speed")
    parser.add_argument("--folder", type=Path, default=folder, help=f"of the runs ({folder})")
    add_output(parser, "learning_speed")
    arguments = parser.parse_intermixed_args()
    for recipe in arguments.recipes:
        if recipe not in RECIPES:
            parser.error(f"recipe is {recipe!r}; it must be one of {'; '.join(RECIPES)}")
    return arguments


if __name__ == "__main__":
    main()
