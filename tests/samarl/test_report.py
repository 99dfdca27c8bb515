"""The report: complete pages of whatever a results folder contains."""

import html
import json
import re
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest
from matplotlib.axes import Axes

from mrsan import CrowdReaction, Groups, Layout, Reactions, Scenario, TeamPerception
from samarl.agents import build_agent
from samarl.commands.report import _methods
from samarl.configuration import available_agents, load_agent_config
from samarl.evaluation.metrics import METRICS, Metric, Tables
from samarl.evaluation.summary import Column, Row, column_of
from samarl.evaluation.trajectory import record_episode
from samarl.files import find_folder
from samarl.report.build import build_site, read_runs, read_tables, slug
from samarl.report.curves import chart_data, group_runs
from samarl.report.figures import (
    baselines,
    draw_curves,
    draw_table,
    read_curve,
    settings_labels,
    sweep_figures,
)
from samarl.report.leaderboard import GROUPS, is_best, ranked
from samarl.report.replays import as_replay
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
    assert pages == ["curves", "index", "replays", "sweeps", "transfer"]
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


def test_all_results_are_shown(site: Path) -> None:
    index = (site / "index.html").read_text()
    assert "Table 1" in index
    assert "Not rows" not in index
    rows = json.loads((site.parent / "results/table1.json").read_text())
    for row in rows:
        interval = f"[{row['success_low']:.1f}, {row['success_high']:.1f}]"
        cell = f'<b>{row["success_rate"]:.1f} %</b> <span class="interval">{interval}'
        assert cell in index
    panels = draw_table(rows).axes
    assert len(panels) == len({row["fov_degrees"] * 100 + row["robots"] for row in rows})
    drawn = sorted(bar.get_width() for bar in panels[0].patches)
    assert drawn == sorted(
        row["success_rate"] for row in rows if column_of(row) == Column(90.0, 10, 3)
    )
    assert "paper: SAMARL-PPO" in index
    figures = {figure.stem for figure in (site / "figures").glob("*.svg")}
    assert figures == {figure.stem for figure in (site / "figures").glob("*.png")}
    assert figures == {
        "curve-other-runs-charts-success",
        "curve-other-runs-validation-success-90-10h-3r",
        "noise-90-10h-3r",
        "table-1",
        "places-other-layouts",
        "places-recorded-people",
        *(slug(f"views {row['method']}") for row in rows),
    }
    assert len(list((site / "replays").glob("mine-*.js"))) == 5 * 2
    assert "position noise" in (site / "figures/noise-90-10h-3r.svg").read_text()


def test_tables_of_several_kinds_of_columns_are_on_the_transfer_page(site: Path) -> None:
    page, index = ((site / name).read_text() for name in ("transfer.html", "index.html"))
    assert "Places: other layouts" in page
    assert "Places: recorded people" in page
    assert "Places:" not in index
    assert page.count("90° view, 10 people, 3 robots, square</button>") == 1
    assert page.count("90° view, 3 robots, zara</button>") == 1
    assert 'aria-current="page">Transfer</a>' in page
    assert "Transfer to" not in index


def test_methods_are_in_groups_best_first_with_a_description(site: Path) -> None:
    index = (site / "index.html").read_text()
    rows = json.loads((find_folder("results") / "table1.json").read_text())
    ranking = ranked(rows)
    shown = re.findall(r'<tr data-name="([^"]+)"><th scope="row">(?!paper)', index)
    assert shown == [line.name for line in ranking]
    groups = {line.name: line.group for line in ranking}
    assert [*dict.fromkeys(groups.values())] == ["learned", "planner"]
    assert groups["orca"] == "planner"
    for name in ("samarl", "samarl_unshielded", "samarl_flat", "samarl_flat_unshielded"):
        assert groups[name] == "learned", name
    (ablation,) = ranked([rows[0] | {"method": "samarl_first_waypoint"}])
    assert ablation.group == "ablation"
    for group in GROUPS:
        order = [(-line.rows.count(None), line.success) for line in ranking if line.group == group]
        assert order == sorted(order, reverse=True)
    best = {(column_of(row), row["success_rate"]) for row in rows if is_best(row, rows)}
    assert len(best) == 4
    assert index.count('class="best"') >= 4
    named = {line.name: line for line in ranking}
    assert named["samarl_unshielded"].checkpoint == "samarl"
    assert all(named[name].rows.count(None) == 0 for name in ("samarl", "samarl_ppo", "cadrl"))
    assert [table.name for table in read_tables(find_folder("results"))][:2] == [
        "Table 1",
        "Table 2",
    ]
    assert '<td data-value="-1" class="absent">not played</td>' in index
    assert html.escape(named["perimeter"].description, quote=False) in index
    assert rows[0]["command"] in index
    assert f"{rows[0]['episodes']} cases" in index


def test_every_metric_of_the_report_has_a_column(site: Path) -> None:
    index = (site / "index.html").read_text()
    for metric in METRICS.values():
        if Tables.report in metric.tables:
            assert f'<th scope="col">{metric.heading}</th>' in index


def test_driving_behaviour_has_its_own_table_if_measured(tmp_path: Path) -> None:
    rows = json.loads((find_folder("results") / "table1.json").read_text())[:3]
    driving = [metric for metric in METRICS.values() if metric.tables is Tables.driving]
    for metric in driving:
        for row in rows:
            row.pop(metric.fields[0], None)
    (tmp_path / "results").mkdir()
    table = tmp_path / "results/table1.json"
    table.write_text(json.dumps(rows))
    before = index_of(tmp_path / "results", tmp_path / "site")
    assert "Driving behaviour" not in before
    table.write_text(json.dumps([rows[0] | {"standing_share": 12.34}, *rows[1:]]))
    index = index_of(tmp_path / "results", tmp_path / "site")
    first, summary, second = html.unescape(index).partition("<summary>Driving behaviour</summary>")
    assert summary
    for metric in driving:
        heading = f'<th scope="col">{metric.heading}</th>'
        assert heading not in first
        assert heading in second
    assert second.count("<td>12.3</td>") == 1
    assert "<td></td>" in second
    Reader().feed(index)


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


def test_a_validation_curve_has_the_planners_of_its_column(site: Path) -> None:
    rows = json.loads((find_folder("results") / "table1.json").read_text())
    levels = baselines(rows, "validation/social_score_360_10h_5r")
    of_column = {r["method"]: r for r in rows if column_of(r) == Column(360.0, 10, 5)}
    names = ("model_predictive", "perimeter")
    assert levels == {name: of_column[name]["social_score"] for name in names}
    assert baselines(rows, "charts/success") == {}
    axes = draw_curves({}, "validation/social_score_360_10h_5r", levels).axes[0]
    assert [line.get_ydata()[0] for line in axes.lines] == list(levels.values())
    assert (axes.get_xlabel(), axes.get_ylabel()) == ("world steps", "social score, 0 to 100")
    page = (site / "curves.html").read_text()
    assert "samarl-report --config-dir conf results=results" in html.unescape(page)


def test_curves_are_grouped_by_the_task_of_the_training() -> None:
    results = find_folder("results")
    runs = read_runs(results / "curves")
    groups = group_runs(runs, results / "checkpoints")
    task = {name: task for task, names in groups.items() for name in names}
    assert task.keys() == runs.keys()
    assert task["samarl_transformer"] == task["samarl_flat"] == "SAMARL's circle, 360° view"
    assert task["msa3c"] == task["sarl"] == "MSA3C's circle, holonomic robots"
    assert task["samarl_places"] == "Places with walls"
    assert task["samarl_recorded"] == "Recorded people"
    assert task["samarl_general"] == "Any layout"
    (flat,) = [
        run for group in chart_data(groups) for run in group["runs"] if run["name"] == "samarl_flat"
    ]
    steps, mean, low, high = flat["lines"]["charts/success"]
    assert len(steps) == 60
    assert all(0 <= a <= b <= c <= 100 for a, b, c in zip(low, mean, high, strict=True))


def test_settings_labels_distinguish_rows() -> None:
    shared = "samarl-evaluate agent=orca scenario.humans=5 evaluation.cases=9"
    rows = [{"command": shared}, {"command": f"{shared} scenario.occlusion=true"}]
    assert settings_labels(rows) == ["default", "occlusion=true"]  # type: ignore[arg-type]


def drawn(rows: list[Row]) -> dict[str, Axes]:
    return {title: figure.axes[0] for title, figure in sweep_figures(rows)}


def test_the_figure_of_a_sweep_depends_on_what_it_varies() -> None:
    table = json.loads((find_folder("results") / "table1.json").read_text())
    one = next(row for row in table if row["method"] == "orca")

    def with_setting(word: str) -> Row:
        return one | {"command": f"{one['command']} scenario.{word}"}

    numbers = drawn([with_setting("position_noise=0.1"), with_setting("position_noise=0")])
    (axes,) = numbers.values()
    assert axes.get_xlabel() == "position noise, m"
    np.testing.assert_allclose(axes.lines[0].get_xdata(), [0.0, 0.1])
    (axes,) = drawn([with_setting("team_delay=0.5"), one]).values()  # 0 by default
    np.testing.assert_allclose(axes.lines[0].get_xdata(), [0.0, 0.5])
    pairs = [
        other | {"fov_degrees": view}
        for view in (60.0, 90.0)
        for other in (one, with_setting("occlusion=true"))
    ]
    (axes,) = drawn(pairs).values()
    assert [line.get_label() for line in axes.lines] == ["orca, default", "orca, occlusion=true"]
    np.testing.assert_allclose(axes.lines[1].get_xdata(), [60.0, 90.0])
    (axes,) = drawn([with_setting("occlusion=true"), one]).values()
    assert axes.get_xlabel().startswith("success %")  # bars
    (axes,) = drawn([one | {"humans": 5}, one]).values()
    assert axes.get_xlabel() == "humans"
    (axes,) = drawn([one | {"humans": 5}, one | {"robots": 8}]).values()
    assert axes.get_xlabel() == "field of view, degrees"  # a map


def index_of(results: Path, output: Path) -> str:
    build_site(output, results, [], "test")
    return (output / "index.html").read_text()


def test_rows_of_another_version_are_shown(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Rows that lack a metric or have an unknown one."""
    rows = json.loads((find_folder("results") / "table1.json").read_text())[:3]
    (tmp_path / "results").mkdir()
    table = tmp_path / "results/table1.json"
    table.write_text(json.dumps(rows))
    shown = index_of(tmp_path / "results", tmp_path / "site")
    for method in (row["method"] for row in rows):
        assert f'<tr data-name="{method}">' in shown
    table.write_text(json.dumps([row | {"unheard_of": 1.0} for row in rows]))
    assert index_of(tmp_path / "results", tmp_path / "site") == shown
    table.write_text(json.dumps(rows))
    new = Metric(("new_one",), "new one", "{:.1f}", 2, lambda episodes: 1.0)
    monkeypatch.setitem(METRICS, "new_one", new)
    after = index_of(tmp_path / "results", tmp_path / "site")
    column = '<th scope="col">new one</th>'
    assert column in after
    assert after.replace(column, "").replace("<td></td>", "") == shown.replace("<td></td>", "")


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


def test_a_replay_has_the_ranges_of_the_lidar() -> None:
    scenario = Scenario(layout=Layout.rooms, humans=2, robots=2, time_limit=1.0, lidar_rays=9)
    trajectory = record_episode(build_agent(STRAIGHT, scenario), scenario, 3)
    assert trajectory.lidar is not None
    lidar = as_replay(trajectory)["lidar"]
    assert lidar["angles"] == pytest.approx(np.radians(np.arange(9) * 40.0 - 180.0), abs=1e-4)
    metres = np.transpose(lidar["ranges"], (1, 0, 2)) / 100.0
    np.testing.assert_allclose(metres, trajectory.lidar, atol=0.0051)
    assert as_replay(straight_trajectory())["lidar"] is None


def test_a_replay_records_groups_and_reactions() -> None:
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
    alone = as_replay(straight_trajectory())
    assert alone["humanGroups"] is alone["humanReactions"] is None


def test_a_replay_marks_the_steps_with_a_replaced_action() -> None:
    scenario = Scenario()
    trajectory = record_episode(
        build_agent({**STRAIGHT, "shield": True}, scenario), scenario, 2**41
    )
    assert trajectory.shielded is not None
    assert trajectory.shielded.any()
    assert not trajectory.shielded.all()
    steps = as_replay(trajectory)["shielded"]
    assert [(i, t) for i, at in enumerate(steps) for t in at] == [
        (i, t)
        for t, i in sorted(zip(*trajectory.shielded.nonzero(), strict=True), key=lambda p: p[1])
    ]


def test_only_the_named_agents_play_each_by_its_own_configuration() -> None:
    results = find_folder("results")
    assert list(_methods(["orca", "cadrl"], results)) == ["orca", "cadrl"]
    methods = _methods(None, results)
    assert list(methods) == available_agents()
    assert not methods["cadrl"].get("shield")
    for name, method in methods.items():
        config = load_agent_config(name)
        shown = {**method, "checkpoint": Path(method.get("checkpoint", "")).stem}
        assert shown == {**config, "checkpoint": config.get("checkpoint", "")}


def test_an_agent_without_its_checkpoint_is_skipped(tmp_path: Path) -> None:
    (tmp_path / "results").mkdir()
    (tmp_path / "conf/agent").mkdir(parents=True)
    (tmp_path / "conf/agent/mine.yaml").write_text("defaults:\n  - samarl\ncheckpoint: nowhere\n")
    done = report(
        "--config-dir",
        "conf",
        "results=results",
        "agents=[mine]",
        "cases=[0]",
        "output=site",
        "columns=[{robots: 2}]",
        cwd=tmp_path,
    )
    assert done.stdout.startswith("skipped: mine in 1 of 1 scenarios: checkpoint is 'nowhere'")
    assert [page.name for page in (tmp_path / "site").glob("*.html")] == ["index.html"]
    assert "The results folder contains no table." in (tmp_path / "site/index.html").read_text()


@pytest.mark.parametrize(
    ("argument", "message"),
    [
        ("output=full", "output is 'full'; it must be a new folder or contain an earlier report"),
        ("results=none", "results is 'none'; it must be a folder"),
        ("results=broken", "broken/table.json is not JSON"),
        ("results=partial", "partial/table.json has no success_low in row 1; every row must have"),
        ("cases=[-1]", "cases has -1; each must be a whole number in [0, 1e+09)"),
        ("agents=[nobody]", "agents: there is no agent 'nobody'; "),
    ],
)
def test_user_errors_are_one_line(tmp_path: Path, argument: str, message: str) -> None:
    for name in ("full", "broken", "partial"):
        (tmp_path / name).mkdir()
    (tmp_path / "full/mine.txt").write_text("mine")
    (tmp_path / "broken/table.json").write_text("[")
    rows = json.loads((find_folder("results") / "table1.json").read_text())[:2]
    del rows[1]["success_low"]
    (tmp_path / "partial/table.json").write_text(json.dumps(rows))
    done = report("agents=[]", "output=site", argument, cwd=tmp_path, code=2)
    assert done.stderr.startswith(f"error: {message}")
    assert len(done.stderr.splitlines()) == 1
    assert (tmp_path / "full/mine.txt").exists()
    assert not (tmp_path / "site").exists()
