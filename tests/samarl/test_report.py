"""The report: complete pages of whatever a results folder contains."""

import json
import re
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest
from matplotlib.axes import Axes

from mrsan import CrowdReaction, Groups, Layout, Reactions, Scenario, TeamPerception
from samarl.agents import build_agent
from samarl.evaluation.methods import label_of
from samarl.evaluation.metrics import metric_fields
from samarl.evaluation.summary import HEADLINE, Row, column_of
from samarl.evaluation.trajectory import record_episode
from samarl.files import find_folder
from samarl.report.build import build_site, read_runs, read_tables, slug
from samarl.report.curves import chart_data, group_runs
from samarl.report.figures import (
    draw_curves,
    draw_table,
    sweep_figures,
)
from samarl.report.leaderboard import GROUPS, is_best, ranked
from samarl.report.replays import ReplayFolder, as_replay
from samarl.training.learning_curve import read_curve
from tests.reporting import STRAIGHT, report, straight_trajectory

VOID = {"meta", "link", "input", "img", "br", "wbr", "circle", "path", "rect"}


class Reader(HTMLParser):
    """Collects addresses and ids and checks that every element is closed in order."""

    def __init__(self) -> None:
        super().__init__()
        self.open: list[str] = []
        self.addresses: list[str] = []
        self.ids: list[str] = []

    def handle_starttag(self, tag: str, attributes: list[tuple[str, str | None]]) -> None:
        if tag not in VOID:
            self.open.append(tag)
        for name, value in attributes:
            if name in ("href", "src"):
                self.addresses.append(value or "")
            if name == "id":
                self.ids.append(value or "")

    def handle_endtag(self, tag: str) -> None:
        if tag not in VOID:
            assert self.open.pop() == tag


def test_pages_are_valid_small_and_need_no_network(site: Path) -> None:
    pages = sorted(page.stem for page in site.glob("*.html"))
    tables = ["table-1", "table-places-other-layouts", "table-places-recorded-people"]
    assert pages == ["curves", "index", "replays", "sweeps", *tables]
    for page in site.glob("*.html"):
        reader = Reader()
        reader.feed(page.read_text())
        assert reader.open == []
        assert len(set(reader.ids)) == len(reader.ids)
        for address in reader.addresses:
            if address.startswith("#"):
                assert address[1:] in reader.ids
            elif address != "data:,":
                assert not address.startswith(("/", "."))
                assert (site / address).is_file(), address
    for file in site.rglob("*"):
        if file.suffix in (".html", ".css", ".js"):
            assert not re.search(r"https?:|url\(|file:|/tmp/|/home/", file.read_text()), file
        if file.suffix == ".svg":
            assert not re.search(r'(href|src)="(?!#|data:)', file.read_text()), file
    assert sum(file.stat().st_size for file in site.rglob("*") if file.is_file()) < 3e6
    assert not list(site.parent.glob("*.part"))


def test_every_row_is_drawn(site: Path) -> None:
    rows = json.loads((site.parent / "results/table1.json").read_text())
    panels = draw_table(rows).axes
    columns = list(dict.fromkeys(column_of(row) for row in rows))
    for axes, column in zip(panels, columns, strict=True):
        drawn = sorted(bar.get_width() for bar in axes.patches)
        assert drawn == sorted(row["success_rate"] for row in rows if column_of(row) == column)
    figures = {figure.stem for figure in (site / "figures").glob("*.svg")}
    assert figures == {figure.stem for figure in (site / "figures").glob("*.png")}
    assert figures == {
        "noise-90-10h-3r",
        "table-1",
        "places-other-layouts",
        "places-recorded-people",
        *(slug(f"views {label_of(row['method'])}") for row in rows),
    }
    assert "position noise" in (site / "figures/noise-90-10h-3r.svg").read_text()


def test_a_table_of_many_columns_is_drawn_as_heat_maps() -> None:
    rows = json.loads((find_folder("results") / "passages.json").read_text())
    lines = ranked(rows)
    axes = [panel for panel in draw_table(rows).axes if panel.get_visible()]
    for panel, line in zip(axes[:-1], lines, strict=True):  # the last is the colour bar
        drawn = sorted(int(text.get_text()) for text in panel.texts)
        assert drawn == sorted(round(row["success_rate"]) for row in line.rows if row)
    labels = [label.get_text() for label in axes[0].get_yticklabels()]
    assert labels[:2] == ["doorway door width max 0.9", "doorway door width 1.2"]
    assert len(set(labels)) == 8


def test_methods_are_in_groups_best_first() -> None:
    rows = json.loads((find_folder("results") / "table1.json").read_text())
    ranking = ranked(rows)
    groups = {line.name: line.group for line in ranking}
    assert [*dict.fromkeys(groups.values())] == ["learned", "planner"]
    assert (groups["orca"], groups["samarl shield=false"]) == ("planner", "learned")
    (ablation,) = ranked([rows[0] | {"method": "samarl waypoints=first"}])
    assert ablation.group == "ablation"
    for group in GROUPS:
        order = [(-line.rows.count(None), line.success) for line in ranking if line.group == group]
        assert order == sorted(order, reverse=True)
    assert len({column_of(row) for row in rows if is_best(row, rows)}) == 4
    best = read_tables(find_folder("results"))[0].best("planner")
    assert best is not None
    assert best.name == "perimeter shield=true"


def test_replays_are_kept_unless_what_they_depend_on_changes(tmp_path: Path) -> None:
    folder = ReplayFolder(tmp_path, ["a-1", "b-1"])
    folder.add("a-1", "straight", "test case 0", straight_trajectory())
    before = (tmp_path / "a-1.js").stat().st_mtime_ns
    again = ReplayFolder(tmp_path, ["a-1", "b-1"])
    assert "a-1" in again
    assert "b-1" not in again
    assert (tmp_path / "a-1.js").stat().st_mtime_ns == before
    assert "a-1" not in ReplayFolder(tmp_path, ["a-2", "b-1"])
    assert [path.name for path in tmp_path.iterdir()] == ["index.js"]


def test_a_curve_is_the_mean_of_its_seeds_and_their_range(site: Path) -> None:
    curves = [read_curve(site.parent / f"results/curves/fast_seed{k}.csv") for k in range(2)]
    steps, values = curves[0]["validation/success_90_10h_3r"]  # with gaps
    assert steps.tolist() == [1000, 3000, 5000]
    assert values.tolist() == [0.5] * 3
    axes = draw_curves({"fast": curves}, "charts/success").axes[0]
    np.testing.assert_allclose(axes.lines[0].get_ydata(), 60.0)
    assert axes.lines[0].get_marker() == "None"
    point = draw_curves({"short": [{"charts/success": ([5.0], [0.4])}]}, "charts/success").axes[0]
    assert point.lines[0].get_marker() == "o"  # a line of one point would be invisible
    low, high = axes.collections[0].get_paths()[0].get_extents().get_points()[:, 1]
    assert (low, high) == (pytest.approx(50.0), pytest.approx(70.0))


def test_curves_are_grouped_by_the_task_of_the_training() -> None:
    results = find_folder("results")
    runs = read_runs(results / "curves")
    groups = group_runs(runs, results / "checkpoints")
    task = {name: task for task, names in groups.items() for name in names}
    assert task.keys() == runs.keys()
    assert task["samarl_transformer"] == task["samarl_circle"] == "SAMARL's circle, 360° view"
    assert task["msa3c"] == "MSA3C's circle, holonomic robots"
    for group in chart_data(groups):
        for run in group["runs"]:
            _, mean, low, high = run["lines"]["charts/success"]
            assert all(0 <= a <= b <= c <= 100 for a, b, c in zip(low, mean, high, strict=True))


def drawn(rows: list[Row]) -> dict[str, Axes]:
    return {title: figure.axes[0] for title, figure in sweep_figures(rows)}


def test_the_figure_of_a_sweep_depends_on_what_it_varies() -> None:
    table = json.loads((find_folder("results") / "table1.json").read_text())
    one = next(row for row in table if row["method"] == "orca")

    def with_setting(word: str) -> Row:
        changes = word.replace("=", " ")
        return one | {"command": f"{one['command']} scenario.{word}", "changes": changes}

    numbers = drawn([with_setting("position_noise=0.1"), with_setting("position_noise=0")])
    (axes,) = numbers.values()
    assert axes.get_xlabel() == "position noise, m"
    np.testing.assert_allclose(axes.lines[0].get_xdata(), [0.0, 0.1])
    (axes,) = drawn([with_setting("occlusion=true"), one]).values()
    assert len(axes.patches) == 1  # a bar of each method
    (axes,) = drawn([one | {"humans": 5}, one | {"robots": 8}]).values()
    assert axes.get_xlabel() == "field of view, degrees"  # a map


def test_a_replay_reproduces_the_trajectory() -> None:
    trajectory = straight_trajectory()
    replay = as_replay(trajectory)
    position = np.cumsum(replay["robots"], axis=-1).transpose(2, 0, 1) / 100
    np.testing.assert_allclose(position, trajectory.robot_position, atol=0.0051)
    heading = np.radians(np.cumsum(replay["headings"], axis=-1)).T
    np.testing.assert_allclose(np.cos(heading), np.cos(trajectory.robot_heading), atol=0.01)
    for t in range(len(position)):
        for i, of_robot in enumerate(replay["humansVisible"]):
            visible = [sum(step <= t for step in switches) % 2 == 1 for switches in of_robot]
            assert visible == trajectory.humans_visible[t, i].tolist()
    assert replay["waypoints"] is replay["humanAttention"] is replay["shielded"] is None


def test_a_replay_marks_agents_shared_by_team_mates() -> None:
    scenario = Scenario(fov_degrees=90.0, team_perception=TeamPerception.tracks)
    trajectory = record_episode(build_agent(STRAIGHT, scenario), scenario, 3)
    assert trajectory.humans_reported.any()
    assert not (trajectory.humans_reported & ~trajectory.humans_visible).any()
    replay = as_replay(trajectory)
    for t in range(len(trajectory.robot_position)):
        for name, reported in (
            ("humans", trajectory.humans_reported),
            ("robots", trajectory.robots_reported),
        ):
            for i, of_robot in enumerate(replay[f"{name}Reported"]):
                now = [sum(step <= t for step in switches) % 2 == 1 for switches in of_robot]
                assert now == reported[t, i].tolist()
    alone = as_replay(straight_trajectory())
    assert alone["humansReported"] is alone["robotsReported"] is None


def test_user_errors_are_one_line(tmp_path: Path) -> None:
    for name in ("full", "partial"):
        (tmp_path / name).mkdir()
    (tmp_path / "full/mine.txt").write_text("mine")
    rows = json.loads((find_folder("results") / "table1.json").read_text())[:2]
    del rows[1]["success_low"]
    (tmp_path / "partial/table.json").write_text(json.dumps(rows))
    for argument, message in (
        ("output=full", "output is 'full'; it must be a new folder or contain an earlier report"),
        ("results=partial", "partial/table.json has no success_low in row 1; every row must have"),
        ("cases=[-1]", "cases has -1; each must be a whole number in [0, 1e+09)"),
        ("agents=[nobody]", "agents: agent is 'nobody', which does not exist; "),
    ):
        done = report("agents=[]", "output=site", argument, cwd=tmp_path, code=2)
        assert done.stderr.startswith(f"error: {message}")
        assert len(done.stderr.splitlines()) == 1
    assert (tmp_path / "full/mine.txt").exists()
    assert not (tmp_path / "site").exists()


def test_rows_of_another_version_are_shown(tmp_path: Path) -> None:
    """Rows that lack a metric or have an unknown one."""
    first, *others = json.loads((find_folder("results") / "table1.json").read_text())[:3]
    optional = [field for field in metric_fields() if field not in HEADLINE]
    rows = [{key: first[key] for key in first if key not in optional} | {"unknown": 1.0}, *others]
    (tmp_path / "results").mkdir()
    (tmp_path / "results/table1.json").write_text(json.dumps(rows))
    build_site(tmp_path / "site", tmp_path / "results")
    assert first["command"] in (tmp_path / "site/table-1.html").read_text()


def test_a_replay_has_the_lidar_the_groups_and_the_reactions() -> None:
    scenario = Scenario(
        humans=4,
        time_limit=1.0,
        crowd_reaction=CrowdReaction.mixed,
        reactions=Reactions(0.0, 0.0, 0.0, curious=1.0, scared=0.0, threatening=0.0),
        groups=Groups(share=1.0, size_max=2),
    )
    replay = as_replay(record_episode(build_agent(STRAIGHT, scenario), scenario, 3))
    assert replay["humanGroups"] == [0, 0, 2, 2]
    assert replay["humanReactions"] == ["curious"] * 4
    walled = Scenario(layout=Layout.rooms, humans=2, robots=2, time_limit=1.0, lidar_rays=9)
    trajectory = record_episode(build_agent(STRAIGHT, walled), walled, 3)
    lidar = as_replay(trajectory)["lidar"]
    assert lidar["angles"] == pytest.approx(np.radians(np.arange(9) * 40.0 - 180.0), abs=1e-4)
    metres = np.transpose(lidar["ranges"], (1, 0, 2)) / 100.0
    np.testing.assert_allclose(metres, trajectory.lidar, atol=0.0051)
    alone = as_replay(straight_trajectory())
    assert alone["lidar"] is alone["humanGroups"] is alone["humanReactions"] is None
