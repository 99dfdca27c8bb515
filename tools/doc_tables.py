"""Tables of the documentation, built from `results/`; `TABLES` has their names."""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from statistics import fmean
from typing import Any

from mrsan import TASKS
from samarl.evaluation.methods import label_of
from samarl.evaluation.papers import PAPER_SUCCESS
from samarl.evaluation.summary import Column, Row, column_of
from samarl.evaluation.table import markdown_table, setting_name
from samarl.report.leaderboard import ranked, task_of, task_rows
from tools.figures import RESULTS, find_row, find_value, print_row, result_rows

NONE = "-"  # in cells without a value
TABLES: dict[str, Callable[[], str]] = {}
COLUMNS = [Column(90.0, 10, 3), Column(90.0, 10, 5), Column(360.0, 10, 5), Column(360.0, 10, 3)]
# Rows of the README.
METHODS = (
    "orca",
    "model_predictive",
    "perimeter",
    "perimeter shield=true",
    "cadrl",
    "cadrl shield=true",
    "samarl_ppo shield=false",
    "samarl_ppo",
    "samarl_waypoints shield=false",
    "samarl_waypoints",
    "samarl_flat shield=false",
    "samarl_flat",
    "samarl shield=false",
    "samarl",
)
# What the settings of table `robustness` change, in words.
CHANGES = {
    "position noise 0.1": "positions with noise of 0.1 m",
    "missed detection 0.2": "a fifth of the detections missing",
    "occlusion": "people hide behind each other",
    "crowd social force": "people walk by social forces",
    "hurry probability 0.2": "a fifth of the people hurry",
    "crowd reaction reciprocal": "people avoid robots",
    "crowd reaction mixed": "people react in six ways",
    "groups.share 0.6": "60 % walk in groups",
    "groups.share 0.6 groups.standing share 1.0": "60 % stand in groups",
    "human radius max 0.5": "people with radii up to 0.5 m",
    "human speed min 0.5 human speed max 1.5": "people with speeds of 0.5 to 1.5 m/s",
    "arena radius 7.0": "a round wall, 7 m from the centre",
}


def table(build: Callable[[], str]) -> Callable[[], str]:
    """Register a table under the name of its function."""
    TABLES[build.__name__] = build
    return build


def _key(column: Column) -> str:
    """Return a column as `find_row` takes it."""
    return f"{column.fov_degrees:g}/{column.humans}/{column.robots}"


def _method_line(method: str) -> list[str]:
    """Return the line of a method in Table I."""
    rows = (find_row("table1", method, _key(column)) for column in COLUMNS)
    return [label_of(method), *(print_row(row, "both") for row in rows)]


def _table1_header() -> list[str]:
    names = [f"{c.fov_degrees:g}°, {c.robots} robots" for c in COLUMNS]
    return ["success % / social score", *names]


@table
def headline() -> str:
    """Return Table I with a row for each method of the README."""
    return markdown_table(_table1_header(), [_method_line(method) for method in METHODS])


@table
def beside_the_paper() -> str:
    """Return success in Table I without the shield, and the paper's in brackets."""
    lines = []
    for method in ("orca", "cadrl", "samarl_ppo shield=false", "samarl_srnn shield=false",
                   "samarl_waypoints shield=false"):  # fmt: skip
        label = label_of(method)
        name = label.partition(",")[0].removesuffix("-Waypoints")
        paper = [PAPER_SUCCESS.get(c, {}).get(name, NONE) for c in COLUMNS]
        ours = [print_row(find_row("table1", method, _key(c)), "success") for c in COLUMNS]
        lines.append([label, *(f"{o} ({p})" for o, p in zip(ours, paper, strict=True))])
    return markdown_table(["success %", *_table1_header()[1:]], lines)


@table
def seeds() -> str:
    """Return success over training seeds in the columns of Table I."""
    lines = []
    policies = ["samarl", "samarl_waypoints", "samarl_ppo", "samarl_transformer", "samarl_circle"]
    for method in [
        *(name for policy in policies for name in (f"{policy} shield=false", policy)),
        *("samarl_general", "samarl_planned"),
    ]:
        rows = [row for row in result_rows("table1") if row["method"] == method]
        cells = {column_of(row)[:3]: print_row(row, "seeds") for row in rows}
        lines.append([label_of(method), *(cells.get(column[:3], NONE) for column in COLUMNS)])
    return markdown_table(["success %, mean [range]", *_table1_header()[1:]], lines)


def _grid(rows: Iterable[Row], heading: Callable[[Row], str], methods: Sequence[str]) -> str:
    """Return success and social score of methods by columns, in order of appearance."""
    cells: dict[str, dict[str, str]] = {method: {} for method in methods}
    heads: dict[str, None] = {}
    for row in rows:
        heads[heading(row)] = None
        if row["method"] in cells:
            cells[row["method"]][heading(row)] = print_row(row, "both")
    lines = [[label_of(m), *(line.get(head, NONE) for head in heads)] for m, line in cells.items()]
    return markdown_table(["success % / social score", *heads], lines)


@table
def recorded() -> str:
    """Return success and social score among recorded people, of the main methods."""
    methods = (
        "model_predictive shield=true",
        "perimeter shield=true",
        "cadrl",
        "samarl",
        "samarl_flat",
        "samarl_waypoints",
        "samarl_transformer",
        "samarl_general",
        "samarl_planned",
    )
    rows = [row for row in result_rows("transfer") if row.get("recording")]
    return _grid(rows, lambda row: Path(row["recording"]).stem.replace("_", " "), methods)


@table
def places() -> str:
    """Return success and social score in walled environments, of the main methods."""
    methods = (
        "orca",
        "social_force_places shield=true",
        "model_predictive shield=true",
        "cadrl shield=true",
        "samarl_places",
        "samarl_flat",
        "samarl right_of_way=null",
        "right_of_way central=true",
    )
    return _grid(result_rows("places"), lambda row: row["layout"], methods)


@table
def right_of_way() -> str:
    """Return success and social score of robots that tell each other who goes first."""
    methods = (
        "samarl_places",
        "samarl_places right_of_way=rule",
        "samarl_places right_of_way=right_of_way_macro",
        "samarl_flat",
        "samarl right_of_way=null",
        "samarl",
        "samarl right_of_way=rule",
        "right_of_way",
        "right_of_way macro_level=right_of_way_macro",
        "right_of_way macro_level=ablation_priorities",
        "right_of_way macro_level=ablation_intents",
        "right_of_way central=true",
    )

    def heading(row: Row) -> str:
        late = ", late messages" if "delay" in row["changes"] else ""
        return f"{'narrow ' if row['robots'] == 4 else ''}{row['layout']}{late}"

    return _grid(result_rows("right_of_way"), heading, methods)


@table
def passages() -> str:
    """Return success in passages by width, as means over the numbers of robots and people."""
    first_half = "samarl checkpoint=samarl_first_half"
    methods = (
        *("samarl", "samarl right_of_way=rule", "samarl right_of_way=null"),
        *(first_half, f"{first_half} right_of_way=rule"),
        *("samarl_flat", "samarl_flat checkpoint=samarl_flat_first_half"),
        "right_of_way",
        *(f"right_of_way macro_level={name}" for name in ("right_of_way_macro", "random", "enter")),
    )
    rates: dict[str, dict[str, list[float]]] = {method: {} for method in methods}
    for row in result_rows("passages"):
        width = re.findall(r"width_max=([\d.]+)", row["changes"])
        heading = f"{row['layout']} {width[0] if width else '2.0'} m"
        if row["method"] in rates:
            rates[row["method"]].setdefault(heading, []).append(row["success_rate"])
    headings = list(dict.fromkeys(heading for cells in rates.values() for heading in cells))
    lines = []
    for method, cells in rates.items():
        means = [fmean(cells[heading]) for heading in headings]
        every = fmean(rate for heading in headings for rate in cells[heading])
        lines.append([label_of(method), *(f"{mean:.1f}" for mean in (*means, every))])
    return markdown_table(["success %", *headings, "all"], lines)


@table
def ablations() -> str:
    """Return success and social score of the ablations."""
    rows = result_rows("ablations")
    methods = list(dict.fromkeys(row["method"] for row in rows))
    return _grid(rows, lambda row: f"{row['robots']} robots", methods)


@table
def robustness() -> str:
    """Return the success rate by changed setting and method."""
    methods = (
        "samarl",
        "samarl_waypoints",
        "samarl_general",
        "samarl_planned",
        "cadrl",
        "model_predictive",
        "perimeter shield=true",
        "orca",
    )
    settings: dict[str, dict[str, str]] = {}
    for row in result_rows("robustness"):
        name = setting_name(column_of(row)) or "as in Table I, 200 cases"
        setting = CHANGES.get(name, name)
        settings.setdefault(setting, {})[row["method"]] = print_row(row, "success")
    lines = [
        [setting, *(cells.get(m, NONE) for m in methods)] for setting, cells in settings.items()
    ]
    return markdown_table(["success %", *map(label_of, methods)], lines)


@table
def tasks() -> str:
    """Return the named tasks with the best learned and the best planned method."""
    rows: dict[str | None, list[Row]] = {}
    for row in task_rows():
        rows.setdefault(task_of(row), []).append(row)
    lines = []
    for name, task in TASKS.items():
        most = max(row["episodes"] for row in rows[name])
        full = [row for row in rows[name] if row["episodes"] == most]
        best: dict[str, str] = {}
        for line in ranked(full):
            if not line.is_privileged:
                messages = " (messages)" if line.communicates else ""
                best.setdefault(line.group, f"{line.label}{messages} {line.success:.1f}")
        cells = [best.get(group, NONE) for group in ("learned", "planner")]
        lines.append([f"`{task.id}`", f"`{name}`", task.about, *cells])
    return markdown_table(["id", "`scenario=`", "what", "learned", "planned"], lines)


@table
def co_planning() -> str:
    """Return CSR and CR of all methods in MSA3C's scenarios at the full sensing range."""
    scenarios = ("5p3r", "10p3r", "20p3r")
    cells: dict[str, dict[str, str]] = {}
    for row in result_rows("table2"):
        column = column_of(row)
        if not column.changes:
            text = f"{row['csr']:.1f} / {row['cr']:.1f}"
            cells.setdefault(row["method"], {})[column.scenario] = text
    lines = [[label_of(m), *(line.get(s, NONE) for s in scenarios)] for m, line in cells.items()]
    return markdown_table(["CSR % / CR", *scenarios], lines)


@table
def team() -> str:
    """Return success with and without shared perception by the size of the team."""
    lines = []
    for robots in sorted({row["robots"] for row in result_rows("sweeps/team_size")}):
        column = f"90/10/{robots}"
        rates = [
            print_row(
                find_row("sweeps/team_size", "samarl_planned", column, [f"team_perception={mode}"]),
                "success",
            )
            for mode in ("none", "tracks")
        ]
        lines.append([str(robots), *rates])
    return markdown_table(["robots", "alone, success %", "sharing, success %"], lines)


@table
def throughput_places() -> str:
    """Return the speed and the memory of the simulator by the place."""
    lines = [
        [
            row["place"],
            str(row["rays"]),
            f"{row['world_steps_per_second']:,}",
            f"{row['bytes_per_world'] * 4096 / 2**20:,.0f}",
        ]
        for row in find_value("throughput", "by_place")
    ]
    header = ["place", "lidar rays", "world-steps per second", "4,096 worlds, MiB"]
    return markdown_table(header, lines)


@table
def learning_speed() -> str:
    """Return minutes and steps to success rates, as means over training seeds [range]."""
    lines = []
    for recipe, runs in find_value("learning_speed", "recipes").items():
        minutes = [_mean_and_range(runs[f"seconds_to_{rate}"], 60, ".1f") for rate in (80, 90, 95)]
        steps = _mean_and_range(runs["steps_to_90"], 1000, ",.0f")
        success = [100 * fmean(runs[f"final_success_{n}_robots"]) for n in (3, 5)]
        total = f"{fmean(runs['seconds']) / 60:.1f}"
        lines.append([recipe, *minutes, steps, total, "{:.1f} / {:.1f}".format(*success)])
    return markdown_table(
        [
            "recipe",
            "80 %, min",
            "90 %, min",
            "95 %, min",
            "90 %, 1000 steps",
            "end, min",
            "success at the end, 3 / 5 robots",
        ],
        lines,
    )


def _mean_and_range(values: Sequence[float | None], unit: float, form: str) -> str:
    """Return `mean [smallest, largest]` in a unit, or `not reached` if a value is missing."""
    numbers = [value / unit for value in values if value is not None]
    if len(numbers) < len(values):
        return "not reached"
    return f"{fmean(numbers):{form}} [{min(numbers):{form}}, {max(numbers):{form}}]"


@table
def policies() -> str:
    """Return how long and where the policies were trained that were not all trained alike."""
    groups: dict[str, list[dict[str, Any]]] = {}
    for path in sorted((RESULTS / "checkpoints").glob("*.json")):
        name, _, seed = path.stem.rpartition("_seed")
        card = json.loads(path.read_text(encoding="utf-8"))
        groups.setdefault(name if seed.isdigit() else path.stem, []).append(card["provenance"])
    lines = []
    for name, runs in groups.items():
        if name.startswith(("ablation_", "ma", "ml", "msa3c", "sarl")):
            continue  # all trained alike
        scenarios = [
            stage["scenario"] for stage in runs[0]["configuration"]["curriculum"]["stages"]
        ]
        people = [s["humans"] for s in scenarios]
        people += [s["humans"] if (few := s.get("humans_min")) is None else few for s in scenarios]
        layouts = [str(s.get("layout", "circle")).rpartition(".")[2] for s in scenarios]
        lines.append(
            [
                f"`{name}`",
                str(len(runs)),
                f"{runs[0]['steps'] / 1e6:.1f}",
                _range([round(run["seconds"] / 60) for run in runs]),
                ", ".join(f"`{layout}`" for layout in dict.fromkeys(layouts)),
                _range([s["robots"] for s in scenarios]),
                _range(people),
                ", ".join(f"{view:g}" for view in sorted({s["fov_degrees"] for s in scenarios})),
            ]
        )
    header = ["policy", "seeds", "million steps", "minutes", "layouts", "robots", "people"]
    return markdown_table([*header, "views, degrees"], lines)


def _range(numbers: Sequence[int]) -> str:
    low, high = min(numbers), max(numbers)
    return str(low) if low == high else f"{low} to {high}"


@table
def latency() -> str:
    """Return the duration of a decision of the main agents."""
    lines = []
    for agent in ("orca", "perimeter shield=true", "model_predictive", "samarl", "samarl_flat",
                  "samarl_waypoints", "cadrl", "samarl_planned"):  # fmt: skip
        entry = find_value("latency", f"agents.{agent}")
        exported = entry["exported_ms"]
        lines.append(
            [
                f"`{agent}`",
                f"{entry['one_robot_ms']['median']:.2f}",
                f"{exported['median']:.2f}" if exported else NONE,
                f"{entry['batch_of_512_ms']['median']:.1f}",
            ]
        )
    return markdown_table(["agent", "one robot, ms", "exported, ms", "512 robots, ms"], lines)
