"""The report in a browser: layout, playback and keyboard control."""

import shutil
import time
from pathlib import Path

import pytest
from playwright.sync_api import Page

from mrsan import Split
from samarl import load_agent
from samarl.evaluation.trajectory import record_episode
from samarl.policies.explanation import ACTIVITIES
from samarl.report.build import build_curves, read_runs
from samarl.report.replays import ReplayFolder
from tests.reporting import straight_trajectory
from tests.samarl.test_right_of_way import NARROW


def show(page: Page, site: Path, choice: str) -> None:
    page.goto(f"{(site / 'replays.html').as_uri()}#{choice}")
    page.wait_for_selector("canvas[data-step]")


def steps(page: Page) -> list[str]:
    """The clocks of the canvases that are shown."""
    return page.eval_on_selector_all(
        ".side:not([hidden]) canvas", "canvases => canvases.map(c => c.dataset.time)"
    )


BOTH = "column=90°+view,+10+people,+3+robots&case=test+case+0&left=Around+the+crowd&right=mine"


def test_every_page_opens_and_fits(page: Page, site: Path) -> None:
    for path in site.glob("*.html"):
        page.goto(path.as_uri())
        page.wait_for_function("[...document.images].every(i => i.complete || i.loading == 'lazy')")
        for scheme, width, colour in (("light", 1200, 255), ("dark", 375, 22)):
            page.emulate_media(color_scheme=scheme)  # type: ignore[arg-type]
            page.set_viewport_size({"width": width, "height": 900})
            assert page.evaluate("document.documentElement.scrollWidth") <= width
            background = page.evaluate("getComputedStyle(document.body).backgroundColor")
            assert background == f"rgb({colour}, {colour}, {colour})"


def test_a_heading_sorts_its_column_in_every_group(page: Page, site: Path) -> None:
    page.goto((site / "table-1.html").as_uri())
    names = "rows => rows.map(row => row.dataset.name)"
    before = page.eval_on_selector_all("tr[data-name]", names)
    heading = page.get_by_role("button", name="360° view, 10 people, 3 robots")
    values = "cells => cells.map(cell => Number(cell.dataset.value))"
    cells = "tbody:nth-of-type(2) tr[data-name] td:nth-of-type(4)"
    for click, reverse in enumerate((True, False)):
        heading.click()
        numbers = page.eval_on_selector_all(cells, values)
        assert numbers == sorted(numbers, reverse=reverse), click
    assert page.get_attribute("thead th:last-of-type", "aria-sort") == "ascending"
    assert sorted(page.eval_on_selector_all("tr[data-name]", names)) == sorted(before)


def test_the_reader_chooses_the_runs_of_the_chart(page: Page, site: Path) -> None:
    page.goto((site / "curves.html").as_uri())
    runs = "shapes => shapes.map(shape => shape.dataset.run)"
    assert page.eval_on_selector_all("#chart [data-run]", runs) == ["fast", "slow"]
    box = page.locator("#chart").bounding_box()
    assert box
    page.mouse.move(box["x"] + box["width"] - 16, box["y"] + 100)  # at the last step
    values = ["5k steps, success %:", "fast 60", "slow 20"]  # the mean of 50 and 70
    assert page.inner_text("#readout").split("\n") == values
    page.mouse.move(box["x"], box["y"] - 20)
    assert page.inner_text("#readout") == "Point at the chart to read its values."
    ablation = page.get_by_label("SAMARL-Transformer without graph convolution")
    ablation.check()
    assert page.locator("#chart [data-run]").count() == 3
    ablation.uncheck()
    page.get_by_label("fast (2 seeds)").uncheck()
    assert page.eval_on_selector_all("#chart [data-run]", runs) == ["slow"]
    page.locator("#quantity").select_option("losses: macro critic")
    assert "macro critic" in page.locator("#chart text").all_text_contents()
    page.click("#none")
    assert page.locator("#chart [data-run]").count() == 0
    page.click("#all")
    assert page.locator("#chart .band").count() == 1  # the range of the two seeds


def test_the_page_of_training_runs(page: Page, site: Path, tmp_path: Path) -> None:
    build_curves(tmp_path / "page", read_runs(site.parent / "results/curves"), "samarl-curves")
    page.set_viewport_size({"width": 390, "height": 900})
    page.goto((tmp_path / "page/index.html").as_uri())
    assert page.evaluate("document.documentElement.scrollWidth") <= 390
    assert page.locator("#chart [data-run]").count() == 2
    assert page.locator("#task").is_hidden()  # there is only one


@pytest.mark.parametrize("size", [(1366, 768), (1200, 900)])
def test_the_player_does_not_cover_the_strip(page: Page, site: Path, size: tuple[int, int]) -> None:
    page.set_viewport_size({"width": size[0], "height": size[1]})
    show(page, site, BOTH)
    strip, controls = (page.locator(name).bounding_box() for name in ("#strip", ".controls"))
    assert strip
    assert controls
    assert strip["y"] + strip["height"] <= controls["y"] + 1
    assert controls["y"] + controls["height"] <= size[1]


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


def test_the_viewer_shows_what_the_selected_robot_sees(page: Page, site: Path) -> None:
    trajectory = straight_trajectory()
    show(page, site, "column=90°+view,+10+people,+3+robots&case=test+case+0&left=Straight&right=")
    assert len(steps(page)) == 1
    for t in range(len(trajectory.robot_position)):
        for robot in range(3):
            page.keyboard.press(str(robot))
            humans = trajectory.humans_visible[t, robot].sum()
            others = trajectory.robots_visible[t, robot].sum()
            said = page.inner_text(".sight >> nth=0")
            assert said == f"Robot {robot} sees {humans} of 10 humans, {others} of 2 robots."
        page.keyboard.press("ArrowRight")
    ended = page.inner_text(".outcome >> nth=0")
    assert "hit a human" in ended
    assert page.get_attribute("canvas >> nth=0", "aria-label").startswith("Straight at")  # type: ignore[union-attr]

    before = page.locator("canvas").first.screenshot()
    page.keyboard.press("Home")
    assert page.locator("canvas").first.screenshot() != before
    # Another method on the same case, and what it attends to.
    page.locator("#left").select_option("mine")
    page.wait_for_selector("h2:text('mine')")
    assert "Attends to" in page.inner_text(".sight >> nth=0")
    assert "left=mine" in page.evaluate("location.hash")


def test_the_rays_of_the_lidar_can_be_hidden(page: Page, site: Path) -> None:
    column = "360°+view,+8+people,+3+robots,+rooms+lidar+rays+72+crowd+reaction+reciprocal"
    show(page, site, f"column={column}&case=test+case+0&left=Straight&right=")
    canvas, rays = page.locator("canvas").first, page.locator("#rays")
    assert rays.is_checked()
    with_rays = canvas.screenshot()
    rays.uncheck()
    without = canvas.screenshot()
    assert without != with_rays
    page.keyboard.press("1")  # the rays are those of the selected robot
    assert canvas.screenshot() != without
    page.keyboard.press("0")
    assert canvas.screenshot() == without
    rays.check()
    assert canvas.screenshot() == with_rays
    page.locator("#column").select_option("90° view, 10 people, 3 robots")
    page.wait_for_function("document.getElementById('raysLabel').hidden")  # there is no lidar


def test_a_report_shows_the_replays_so_far(page: Page, site: Path, tmp_path: Path) -> None:
    shutil.copytree(site, tmp_path / "site")
    page.goto((tmp_path / "site/replays.html").as_uri())
    assert page.inner_text("#progress") == ""
    scripts = sorted(path.stem for path in (site / "replays").glob("mine-*.js"))
    ReplayFolder(tmp_path / "site/replays", [*scripts, "another"])
    page.reload()
    page.wait_for_selector("canvas[data-step]")
    assert page.inner_text("#progress").startswith(f"{len(scripts)} of {len(scripts) + 1} ")
    ReplayFolder(tmp_path / "site/replays", ["another"])
    page.reload()
    assert page.inner_text("#progress").startswith("0 of 1 ")


def test_the_viewer_says_who_waits_at_a_door(page: Page, site: Path, tmp_path: Path) -> None:
    shutil.copytree(site, tmp_path / "site")
    case = Split.test.case(22)
    trajectory = record_episode(load_agent("right_of_way", NARROW), NARROW, case)
    folder = ReplayFolder(tmp_path / "site/replays", ["door"])
    folder.add("door", "right_of_way", "test case 22", trajectory)
    show(page, tmp_path / "site", "step=20")
    words = {"drives": "driving"}
    assert trajectory.activity is not None
    names = [words.get(ACTIVITIES[k], ACTIVITIES[k]) for k in trajectory.activity[20]]
    assert "waits" in names
    expected = ", ".join(f"{i} {name}" for i, name in enumerate(names))
    assert page.inner_text(".outcome >> nth=0") == f"Robots: {expected}."


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
