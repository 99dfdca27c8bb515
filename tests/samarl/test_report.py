"""The report: whole pages from whatever there is, and a viewer that plays in a real browser."""

import html
import json
import re
import shutil
import subprocess
import sys
import time
from collections.abc import Iterator
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest
from playwright.sync_api import Browser, ConsoleMessage, Page, sync_playwright

from mrsan import Scenario
from samarl.agents import build_agent
from samarl.commands.report import _methods
from samarl.configuration import available_agents, load_agent
from samarl.evaluation.metrics import METRICS, Metric
from samarl.evaluation.recording import Recording, record_episode
from samarl.evaluation.table import column_of
from samarl.files import find_folder
from samarl.policies.checkpoint import save_policy
from samarl.report.build import build_site, slug
from samarl.report.figures import baselines, draw_curves, draw_table, read_curve, settings_labels
from samarl.report.leaderboard import GROUPS, is_best, ranked
from samarl.report.replays import as_replay
from tests.small import small_policy

VOID = {"meta", "link", "input", "img", "br", "wbr", "circle", "path", "rect"}
FLAGS = [
    "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run",
    "--disable-background-networking", "--disable-component-update", "--disable-sync",
]  # fmt: skip
STRAIGHT = {"_target_": "samarl.agents.planners.straight.Straight"}


def report(*arguments: str, cwd: Path, code: int = 0) -> subprocess.CompletedProcess[str]:
    done = subprocess.run(
        [sys.executable, "-m", "samarl.commands.report", *arguments],
        cwd=cwd,
        capture_output=True,
        text=True,
    )
    assert done.returncode == code, done.stderr
    return done


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A report of a table, a run of two seeds and one of one, two sweeps and a policy."""
    folder = tmp_path_factory.mktemp("report")
    results = folder / "results"
    for name in ("curves", "sweeps", "checkpoints"):
        (results / name).mkdir(parents=True)
    table = json.loads((find_folder("results") / "table1.json").read_text())
    (results / "table1.json").write_text(json.dumps(table))
    (results / "not_rows.json").write_text('{"worlds": 512}')
    (results / "sweeps/views.json").write_text(json.dumps(table))
    noisy = [
        row | {"command": f"{row['command']} scenario.position_noise={noise}"}
        for row in table[:2]
        for noise in (0.1, 0.2)
    ]
    (results / "sweeps/noise.json").write_text(json.dumps(noisy))
    for name, value in (("fast_seed0", 0.5), ("fast_seed1", 0.7), ("slow", 0.2)):
        lines = [f"{1000 * k},{k},{value},{value if k % 2 else ''},{value}" for k in range(1, 6)]
        header = "steps,seconds,charts/success,validation/success_90_10h_3r,losses/macro_critic"
        (results / f"curves/{name}.csv").write_text("\n".join([header, *lines]))
    save_policy(results / "checkpoints/mine.safetensors", small_policy(), "hierarchical", {})
    done = report("results=results", "agents=[straight,perimeter,samarl]", "cases=[0,3]",
                  "output=site", cwd=folder)  # fmt: skip
    assert "written to site/index.html" in done.stdout
    return folder / "site"


class Reader(HTMLParser):
    """Collects addresses and ids and demands that every element is closed in order."""

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


def test_the_pages_are_whole_light_and_need_no_network(site: Path) -> None:
    pages = sorted(page.stem for page in site.glob("*.html"))
    assert pages == ["curves", "index", "replays", "sweeps"]
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


def test_whatever_is_in_the_results_is_shown(site: Path) -> None:
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
    assert drawn == sorted(row["success_rate"] for row in rows if column_of(row) == (90.0, 10, 3))
    assert "paper: SAMARL-PPO" in index
    figures = {figure.stem for figure in (site / "figures").glob("*.svg")}
    assert figures == {figure.stem for figure in (site / "figures").glob("*.png")}
    assert figures == {
        "curve-charts-success", "curve-validation-success-90-10h-3r", "curve-losses-macro-critic",
        "noise-90-10h-3r", "table-1", *(slug(f"views {row['method']}") for row in rows),
    }  # fmt: skip
    assert len(list((site / "replays").glob("mine-*.js"))) == 2 * 2
    assert "position_noise=0.2" in (site / "figures/noise-90-10h-3r.svg").read_text()


def test_methods_stand_in_groups_best_first_and_say_what_they_are(site: Path) -> None:
    index = (site / "index.html").read_text()
    rows = json.loads((find_folder("results") / "table1.json").read_text())
    entries = ranked(rows)
    shown = re.findall(r'<tr data-name="([^"]+)"><th scope="row">(?!paper)', index)
    assert shown == [entry.name for entry in entries]
    groups = {entry.name: entry.group for entry in entries}
    assert [*dict.fromkeys(groups.values())] == ["learned", "ablation", "planner"]
    assert (groups["samarl"], groups["orca"], groups["samarl_flat"]) == (
        "learned", "planner", "ablation",
    )  # fmt: skip
    for group in GROUPS:
        means = [entry.success for entry in entries if entry.group == group]
        assert means == sorted(means, reverse=True)
    best = {(column_of(row), row["success_rate"]) for row in rows if is_best(row, rows)}
    assert len(best) == 4
    assert index.count('class="best"') >= 4
    named = {entry.name: entry for entry in entries}
    assert named["samarl_unshielded"].checkpoint == "samarl"
    assert named["samarl_narrow"].checkpoint == "samarl_narrow"
    assert html.escape(named["perimeter"].about, quote=False) in index
    assert rows[0]["command"] in index
    assert f"{rows[0]['episodes']} cases" in index


def test_all_that_is_measured_has_a_column(site: Path) -> None:
    index = (site / "index.html").read_text()
    for known in METRICS.values():
        assert f'<th scope="col">{known.heading}</th>' in index


def test_a_curve_is_the_mean_of_its_seeds_and_their_range(site: Path) -> None:
    curves = [read_curve(site.parent / f"results/curves/fast_seed{k}.csv") for k in range(2)]
    steps, values = curves[0]["validation/success_90_10h_3r"]  # with gaps
    assert steps.tolist() == [1000, 3000, 5000]
    assert values.tolist() == [0.5] * 3
    axes = draw_curves({"fast": curves}, "charts/success").axes[0]
    np.testing.assert_allclose(axes.lines[0].get_ydata(), 60.0)
    low, high = axes.collections[0].get_paths()[0].get_extents().get_points()[:, 1]
    assert (low, high) == (pytest.approx(50.0), pytest.approx(70.0))


def test_a_validation_curve_has_the_planners_of_its_column(site: Path) -> None:
    rows = json.loads((find_folder("results") / "table1.json").read_text())
    levels = baselines(rows, "validation/social_score_360_10h_5r")
    of_column = {r["method"]: r for r in rows if column_of(r) == (360.0, 10, 5)}
    names = ("model_predictive", "perimeter")
    assert levels == {name: of_column[name]["social_score"] for name in names}
    assert baselines(rows, "charts/success") == {}
    axes = draw_curves({}, "validation/social_score_360_10h_5r", levels).axes[0]
    assert [line.get_ydata()[0] for line in axes.lines] == list(levels.values())
    assert (axes.get_xlabel(), axes.get_ylabel()) == ("world steps", "social score")
    page = (site / "curves.html").read_text()
    assert "samarl-report results=results" in html.unescape(page)
    assert page.index("curve-charts-success") < page.index("<summary>Losses</summary>")


def test_settings_tell_rows_apart() -> None:
    shared = "samarl-evaluate agent=orca scenario.humans=5 evaluation.cases=9"
    rows = [{"command": shared}, {"command": f"{shared} scenario.occlusion=true"}]
    assert settings_labels(rows) == ["default", "occlusion=true"]  # type: ignore[arg-type]


def index_of(results: Path, output: Path) -> str:
    build_site(output, results, [], "test")
    return (output / "index.html").read_text()


def test_rows_of_another_version_are_shown(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Older than a metric, or with one that is not known here."""
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


def recorded() -> Recording:
    scenario = Scenario(fov_degrees=90.0)
    return record_episode(build_agent(STRAIGHT, scenario), scenario, 2**41)


def test_a_replay_says_what_the_recording_says() -> None:
    recording = recorded()
    replay = as_replay(recording)
    position = np.cumsum(replay["robots"], axis=-1).transpose(2, 0, 1) / 100
    np.testing.assert_allclose(position, recording.robot_position, atol=0.0051)
    heading = np.radians(np.cumsum(replay["headings"], axis=-1)).T
    np.testing.assert_allclose(np.cos(heading), np.cos(recording.robot_heading), atol=0.01)
    for t in range(len(position)):
        for i, of_robot in enumerate(replay["humansSeen"]):
            seen = [sum(step <= t for step in switches) % 2 == 1 for switches in of_robot]
            assert seen == recording.humans_seen[t, i].tolist()
    assert replay["waypoints"] is replay["humanAttention"] is replay["shielded"] is None


def test_a_replay_says_when_the_shield_stepped_in() -> None:
    scenario = Scenario()
    guarded = record_episode(build_agent({**STRAIGHT, "shield": True}, scenario), scenario, 2**41)
    assert guarded.shielded is not None
    assert guarded.shielded.any()
    assert not guarded.shielded.all()
    steps = as_replay(guarded)["shielded"]
    assert [(i, t) for i, at in enumerate(steps) for t in at] == [
        (i, t) for t, i in sorted(zip(*guarded.shielded.nonzero(), strict=True), key=lambda p: p[1])
    ]


def test_a_policy_is_shown_as_its_own_agent_drives_it() -> None:
    methods = _methods(None, find_folder("results"))
    assert set(available_agents()) <= set(methods)
    for name in available_agents():
        config = load_agent(name)
        shown = {**methods[name], "checkpoint": Path(methods[name].get("checkpoint", "")).stem}
        assert shown == {**config, "checkpoint": config.get("checkpoint", "")}


def test_an_agent_without_its_checkpoint_is_left_out(tmp_path: Path) -> None:
    (tmp_path / "results").mkdir()
    (tmp_path / "conf/agent").mkdir(parents=True)
    (tmp_path / "conf/agent/mine.yaml").write_text("defaults:\n  - samarl\ncheckpoint: nowhere\n")
    done = report("--config-dir", "conf", "results=results", "agents=[mine]", "cases=[0]",
                  "output=site", "columns=[{robots: 2}]", cwd=tmp_path)  # fmt: skip
    assert done.stdout.startswith("left out: mine, 360° view: checkpoint is 'nowhere'")
    assert [page.name for page in (tmp_path / "site").glob("*.html")] == ["index.html"]
    assert "There is no table in the results yet." in (tmp_path / "site/index.html").read_text()


@pytest.mark.parametrize(
    ("argument", "message"),
    [
        ("output=full", "output is 'full'; it must be a new folder or that of an earlier report"),
        ("results=none", "results is 'none'; it must be a folder"),
        ("results=broken", "broken/table.json is not JSON"),
        ("results=partial", "partial/table.json has no success_low in row 1; every row must have"),
        ("cases=[-1]", "cases has -1; each must lie in [0, 1e+09]"),
        ("agents=[nobody]", "'nobody' is not an agent; it must be among"),
    ],
)
def test_a_mistake_is_one_line(tmp_path: Path, argument: str, message: str) -> None:
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


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    with sync_playwright() as playwright:
        names = ("chromium", "chromium-browser", "google-chrome")
        path = next(filter(None, map(shutil.which, names)), playwright.chromium.executable_path)
        if not Path(path).exists():
            pytest.fail(
                "there is no Chromium to test the report with; install one: "
                "apt-get install chromium, or playwright install chromium"
            )
        chromium = playwright.chromium.launch(executable_path=path, args=FLAGS)
        yield chromium
        chromium.close()


@pytest.fixture
def page(browser: Browser) -> Iterator[Page]:
    """A page that may not complain and may not ask for anything but files."""
    complaints: list[str] = []

    def hear(message: ConsoleMessage) -> None:
        if message.type in ("error", "warning"):
            complaints.append(message.text)

    page = browser.new_page(viewport={"width": 1200, "height": 900})
    page.on("console", hear)
    page.on("pageerror", lambda error: complaints.append(str(error)))
    page.on("requestfailed", lambda request: complaints.append(request.url))
    page.on(
        "request",
        lambda request: (
            None if request.url.startswith(("file:", "data:")) else complaints.append(request.url)
        ),
    )
    yield page
    page.close()
    assert complaints == []


def show(page: Page, site: Path, choice: str) -> None:
    page.goto(f"{(site / 'replays.html').as_uri()}#{choice}")
    page.wait_for_selector("canvas[data-step]")


def steps(page: Page) -> list[str]:
    """The clocks of the canvases that are shown."""
    return page.eval_on_selector_all(
        ".side:not([hidden]) canvas", "canvases => canvases.map(c => c.dataset.time)"
    )


BOTH = "column=90°+view,+10+humans,+3+robots&case=test+case+0&left=perimeter&right=mine"


@pytest.mark.parametrize("scheme", ["light", "dark"])
@pytest.mark.parametrize("size", [(1200, 900), (375, 740)])
def test_every_page_opens_and_fits(
    page: Page, site: Path, tmp_path: Path, scheme: str, size: tuple[int, int]
) -> None:
    page.emulate_media(color_scheme=scheme)  # type: ignore[arg-type]
    page.set_viewport_size({"width": size[0], "height": size[1]})
    for path in site.glob("*.html"):
        page.goto(path.as_uri())
        page.wait_for_function("[...document.images].every(i => i.complete || i.loading == 'lazy')")
        width = page.evaluate("document.documentElement.scrollWidth")
        assert width <= size[0]
        background = page.evaluate("getComputedStyle(document.body).backgroundColor")
        assert background == ("rgb(22, 22, 22)" if scheme == "dark" else "rgb(255, 255, 255)")
        picture = page.screenshot(path=tmp_path / f"{path.stem}.png", full_page=True)
        assert len(picture) > 10_000


def test_a_heading_sorts_its_column_in_every_group(page: Page, site: Path) -> None:
    page.goto((site / "index.html").as_uri())
    names = "rows => rows.map(row => row.dataset.name)"
    before = page.eval_on_selector_all("tr[data-name]", names)
    heading = page.get_by_role("button", name="360° view, 10 people, 3 robots")
    values = "cells => cells.map(cell => Number(cell.dataset.value))"
    cells = "tbody:nth-of-type(3) tr[data-name] td:nth-of-type(4)"
    for click, reverse in enumerate((True, False)):
        heading.click()
        found = page.eval_on_selector_all(cells, values)
        assert found == sorted(found, reverse=reverse), click
    assert page.get_attribute("thead th:last-of-type", "aria-sort") == "ascending"
    assert sorted(page.eval_on_selector_all("tr[data-name]", names)) == sorted(before)


def test_a_replay_plays_pauses_scrubs_and_ends(page: Page, site: Path) -> None:
    show(page, site, BOTH)
    assert steps(page) == ["0.000", "0.000"]
    page.keyboard.press("Space")
    seen = []
    for _ in range(10):
        time.sleep(0.05)
        left, right = steps(page)
        assert left == right  # one clock for both
        seen.append(float(left))
    assert seen == sorted(seen)
    assert seen[-1] > seen[0]
    page.keyboard.press("Space")
    paused = steps(page)
    time.sleep(0.2)
    assert steps(page) == paused
    assert page.inner_text("#play") == "Play"

    page.fill("#time", "20")  # scrub
    assert steps(page) == ["20.000"] * 2
    assert page.inner_text("#clock") == "5.00 s"
    page.keyboard.press("Home")
    for _ in range(3):
        page.keyboard.press("ArrowRight")
    page.keyboard.press("ArrowLeft")
    assert steps(page) == ["2.000"] * 2
    page.keyboard.press("Shift+ArrowRight")
    assert steps(page) == ["6.000"] * 2
    page.keyboard.press("+")
    assert page.input_value("#speed") == "2"
    page.keyboard.press("-")
    page.keyboard.press("-")
    assert page.input_value("#speed") == "0.5"

    page.keyboard.press("End")
    last = int(page.get_attribute("#time", "max") or 0)
    assert steps(page) == [f"{last}.000"] * 2
    for outcome in page.locator(".outcome").all_inner_texts():
        assert outcome.startswith("Ended at ")
    page.locator("#speed").select_option("8")
    page.click("#play")  # from the end it begins again, and stops at the end by itself
    page.wait_for_function("document.getElementById('play').textContent == 'Play'", timeout=30_000)
    assert steps(page) == [f"{last}.000"] * 2


def test_the_chosen_robot_sees_what_was_recorded(page: Page, site: Path) -> None:
    recording = recorded()
    show(page, site, "column=90°+view,+10+humans,+3+robots&case=test+case+0&left=straight&right=")
    assert len(steps(page)) == 1
    for t in range(len(recording.robot_position)):
        for robot in range(3):
            page.keyboard.press(str(robot))
            humans = recording.humans_seen[t, robot].sum()
            others = recording.robots_seen[t, robot].sum()
            said = page.inner_text(".sight >> nth=0")
            assert said == f"Robot {robot} sees {humans} of 10 humans, {others} of 2 robots."
        page.keyboard.press("ArrowRight")
    ended = page.inner_text(".outcome >> nth=0")
    assert "hit a human" in ended
    assert page.get_attribute("canvas >> nth=0", "aria-label").startswith("straight at")  # type: ignore[union-attr]

    before = page.locator("canvas").first.screenshot()
    page.keyboard.press("Home")
    assert page.locator("canvas").first.screenshot() != before
    # Another method on the same case, and what it attends to.
    page.locator("#left").select_option("mine")
    page.wait_for_selector("h2:text('mine')")
    assert "Attends to" in page.inner_text(".sight >> nth=0")
    assert "left=mine" in page.evaluate("location.hash")


def test_the_page_works_by_keyboard_alone(page: Page, site: Path) -> None:
    show(page, site, BOTH)
    order = []
    for _ in range(30):
        page.keyboard.press("Tab")
        order.append(page.evaluate("document.activeElement.id || document.activeElement.className"))
        if order[-1] == "play":
            break
    assert order[0] == "skip"
    controls = [name for name in order if name]
    assert controls == ["skip", "column", "case", "left", "right", "back", "play"]
    assert page.locator("#robots button").count() == 3
    assert page.evaluate("getComputedStyle(document.activeElement).outlineStyle") == "solid"
    page.keyboard.press("Space")  # presses the button once, not twice
    assert page.inner_text("#play") == "Pause"
    page.keyboard.press("Space")
    assert page.inner_text("#play") == "Play"
