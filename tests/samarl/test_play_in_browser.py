"""The playground in a browser, on a screen and on a phone."""

from __future__ import annotations

import http.client
import socket
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mrsan import Scenario, Split
from samarl.api import evaluate, load_agent, load_scenario
from samarl.evaluation.trajectory import record_episode
from samarl.play.session import Session

SCREEN, PHONE = (1400, 1000), (390, 844)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("play")


@pytest.fixture(scope="module")
def sessions() -> list[Session]:
    """The sessions of all pages that were opened."""
    return []


@pytest.fixture(scope="module")
def address(folder: Path, sessions: list[Session]) -> Iterator[str]:
    import uvicorn

    from samarl.play.server import HOST, create_app, write_page

    def create_session(scenes: Path) -> Session:
        task = Scenario(robots=1, humans=1)
        sessions.append(Session(scenes, task, ["samarl"], Split.test.case(0), folder))
        return sessions[-1]

    write_page(folder / "pages", "samarl-play", ["samarl"])
    server = uvicorn.Server(
        uvicorn.Config(create_app(folder / "pages", create_session), log_level="warning")
    )
    with socket.create_server((HOST, 0)) as port:
        thread = threading.Thread(target=server.run, kwargs={"sockets": [port]})
        thread.start()
        yield f"{HOST}:{port.getsockname()[1]}"
        server.should_exit = True
        thread.join()


@pytest.fixture(params=[SCREEN, PHONE], ids=["screen", "phone"])
def page(browser: Any, address: str, request: pytest.FixtureRequest) -> Iterator[Any]:
    """The page after its first frame; it may not complain."""
    width, height = request.param
    context = browser.new_context(
        viewport={"width": width, "height": height}, has_touch=request.param is PHONE
    )
    page = context.new_page()
    complaints: list[str] = []
    page.on("console", lambda m: complaints.append(m.text) if m.type == "error" else None)
    page.on("pageerror", lambda error: complaints.append(str(error)))
    page.goto(f"http://{address}/")
    page.wait_for_selector("body[data-ready]")
    yield page
    context.close()
    assert complaints == []


def pixels(page: Any, point: Any) -> tuple[float, float]:
    """Where a point of the floor is on the page."""
    script = """([x, y]) => {
        const { middle, half } = state.bounds, canvas = document.querySelector("canvas");
        canvas.scrollIntoView({ block: "center" });
        const box = canvas.getBoundingClientRect(), scale = box.width / (2 * half);
        return [box.left + (x - middle[0] + half) * scale,
            box.top + (half - y + middle[1]) * scale];
    }"""
    x, y = page.evaluate(script, [float(value) for value in point])
    return x, y


def ready(page: Any, count: int) -> None:
    page.wait_for_function(f"Number(document.body.dataset.ready) >= {count} && !waiting")


def test_a_person_dragged_into_the_way_stops_the_robot(
    page: Any, folder: Path, sessions: list[Session]
) -> None:
    session = sessions[-1]
    assert page.evaluate("document.documentElement.scrollWidth") <= page.viewport_size["width"]
    for k in range(1, 13):
        page.evaluate("step()")
        ready(page, k)
    state = session.sides[0].world.state
    speed = float(np.hypot(*state.robot_velocity[0, 0]))
    assert speed > 0.8
    ahead = state.robot_velocity[0, 0] / speed
    place = state.robot_position[0, 0] + 1.1 * ahead
    x, y = pixels(page, state.human_position[0, 0])
    to_x, to_y = pixels(page, place)
    if page.viewport_size["width"] == PHONE[0]:
        touch = page.context.new_cdp_session(page)

        def finger(kind: str, *points: tuple[float, float]) -> None:
            touch.send(
                "Input.dispatchTouchEvent",
                {"type": kind, "touchPoints": [{"x": px, "y": py} for px, py in points]},
            )

        finger("touchStart", (x, y))
        for share in (0.3, 0.7, 1.0):
            finger("touchMove", (x + share * (to_x - x), y + share * (to_y - y)))
    else:
        page.mouse.move(x, y)
        page.mouse.down()
        page.mouse.move(to_x, to_y, steps=4)
    for _ in range(100):  # the page handles moves of the finger once per frame
        if np.abs(state.human_position[0, 0] - place).max() < 0.1:
            break
        page.wait_for_timeout(50)
    np.testing.assert_allclose(state.human_position[0, 0], place, atol=0.1)
    page.evaluate("play(true)")  # the person is held there
    page.wait_for_function("Number(document.body.dataset.ready) >= 18", timeout=60_000)
    page.evaluate("play(false)")
    page.wait_for_function("!waiting && !queue.length")
    assert np.hypot(*state.robot_velocity[0, 0]) < 0.5
    assert state.collision[0, 0] == 0
    if page.viewport_size["width"] == PHONE[0]:
        finger("touchEnd")
    else:
        page.mouse.up()
    name = f"stop_{page.viewport_size['width']}"
    page.fill("#name", name)
    page.click("#keep button")
    page.wait_for_function("document.getElementById('message').textContent.startsWith('Saved')")
    while not session.sides[0].is_over:
        session.handle({"type": "step"})
    case = load_scenario(case_file=str(folder / f"{name}.yaml"))
    again = record_episode(load_agent("samarl", case), case, session.scene.case)
    played = session.sides[0].trajectory()
    np.testing.assert_array_equal(again.robot_position, played.robot_position)
    result = evaluate("samarl", case)
    np.testing.assert_array_equal(result.episodes.outcome, played.episodes.outcome)


def test_every_tool_works_while_it_runs(page: Any, sessions: list[Session]) -> None:
    session = sessions[-1]
    page.click("#play")
    page.wait_for_function("Number(document.body.dataset.frames) > 5")
    page.click("[data-tool=wall]")
    page.mouse.move(*pixels(page, (-1.0, 2.0)))
    page.mouse.down()
    page.mouse.move(*pixels(page, (1.0, 2.0)), steps=3)
    page.mouse.up()
    page.wait_for_function("view.layout === 'map'", timeout=120_000)
    page.click("[data-tool=person]")
    page.mouse.click(*pixels(page, (0.0, -1.0)))
    page.wait_for_function("view.humans === 2 && view.walker === 1")
    page.mouse.click(*pixels(page, (-2.0, -1.0)))
    page.wait_for_function("view.sides[0].episode.humans[1][0].reduce((a, b) => a + b) < -30")
    page.click("[data-tool=drive]")
    page.keyboard.down("ArrowDown")
    page.wait_for_function("view.driven === 0 && view.changes > 2")
    page.keyboard.up("ArrowDown")
    page.click("[data-tool=erase]")
    page.mouse.click(*pixels(page, (0.0, 2.0)))
    page.wait_for_function("view.layout === 'circle'")
    for _ in range(4):
        page.click("#undo")
    page.wait_for_function("view.humans === 1 && view.undo === 0 && view.layout === 'circle'")
    assert session.scene.edits == []
    page.click("#next")
    page.wait_for_function("view.case === 1")
    if page.locator("#setup").get_attribute("open") is None:
        page.click("#setup summary")
    page.select_option("#right", "orca")
    page.wait_for_function("view.sides.length === 2")
    page.fill("#humans", "4")
    page.press("#humans", "Enter")
    page.wait_for_function("view.humans === 4")
    page.fill("#humans", "99")
    page.press("#humans", "Enter")
    page.wait_for_function("document.getElementById('message').textContent.includes('99')")
    if page.inner_text("#play") == "Play":
        page.click("#play")
    frames = page.evaluate("Number(document.body.dataset.frames)")
    page.wait_for_function(f"Number(document.body.dataset.frames) > {frames} + 10")


def test_foreign_pages_and_hosts_are_refused(address: str, browser: Any) -> None:
    host, port = address.split(":")
    upgrade = {
        "Connection": "Upgrade",
        "Upgrade": "websocket",
        "Sec-WebSocket-Version": "13",
        "Sec-WebSocket-Key": "AAAAAAAAAAAAAAAAAAAAAA==",
    }
    for headers, status in (
        ({"Host": address}, 200),
        ({"Host": "evil.example"}, 400),
        ({"Host": address, "Origin": "http://evil.example", **upgrade}, 403),
        ({"Host": address, **upgrade}, 403),
        ({"Host": "evil.example", "Origin": "http://evil.example", **upgrade}, 400),
    ):
        connection = http.client.HTTPConnection(host, int(port), timeout=20)
        path = "/socket" if "Upgrade" in headers else "/"
        connection.putrequest("GET", path, skip_host=True)
        for name, value in headers.items():
            connection.putheader(name, value)
        connection.endheaders()
        assert connection.getresponse().status == status, headers
        connection.close()
