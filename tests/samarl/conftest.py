"""The report used by the tests of its files and by those in a browser, and the browser."""

from __future__ import annotations

import json
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from samarl.files import find_folder
from samarl.policies.checkpoint import save_policy
from tests.learning import policy
from tests.reporting import report

if TYPE_CHECKING:  # importing it takes time that other tests do not need
    from playwright.sync_api import Browser, ConsoleMessage, Page, Request


@pytest.fixture(scope="session")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A report of a table, a run of two seeds and two of one, two sweeps and a policy."""
    folder = tmp_path_factory.mktemp("report")
    results = folder / "results"
    for name in ("curves", "sweeps", "checkpoints"):
        (results / name).mkdir(parents=True)
    table = json.loads((find_folder("results") / "table1.json").read_text())
    (results / "table1.json").write_text(json.dumps(table))
    settings = ({"layout": "square"}, {"goal_turn_degrees": -30.0}, {"recording": "zara.txt"})
    transfer = [row | setting for row in table[:2] for setting in settings]
    (results / "places.json").write_text(json.dumps(transfer))
    (results / "not_rows.json").write_text('{"worlds": 512}')
    (results / "sweeps/views.json").write_text(json.dumps(table))
    noisy = [
        row | {"command": f"{row['command']} scenario.position_noise={noise}"}
        for row in table[:2]
        for noise in (0.1, 0.2)
    ]
    (results / "sweeps/noise.json").write_text(json.dumps(noisy))
    curves = {"fast_seed0": 0.5, "fast_seed1": 0.7, "slow": 0.2, "ablation_graph": 0.1}
    for name, value in curves.items():
        lines = [f"{1000 * k},{k},{value},{value if k % 2 else ''},{value}" for k in range(1, 6)]
        header = "steps,seconds,charts/success,validation/success_90_10h_3r,losses/macro_critic"
        (results / f"curves/{name}.csv").write_text("\n".join([header, *lines]))
    save_policy(results / "checkpoints/mine.safetensors", policy(), "hierarchical", {})
    (folder / "conf/agent").mkdir(parents=True)
    (folder / "conf/agent/mine.yaml").write_text("defaults:\n  - samarl\ncheckpoint: mine\n")
    done = report(
        "--config-dir=conf",
        "results=results",
        "agents=[straight,perimeter,mine]",
        "cases=[0]",
        "output=site",
        cwd=folder,
    )
    assert "written to site/index.html" in done.stdout
    return folder / "site"


FLAGS = [  # of Chromium
    "--no-sandbox",
    "--disable-gpu",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
]


@pytest.fixture(scope="session")
def browser() -> Iterator[Browser]:
    from playwright.sync_api import sync_playwright

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

    def fail(request: Request) -> None:
        if request.failure != "net::ERR_ABORTED":  # the page was left before its icon was loaded
            complaints.append(request.url)

    page = browser.new_page(viewport={"width": 1200, "height": 900})
    page.on("console", hear)
    page.on("pageerror", lambda error: complaints.append(str(error)))
    page.on("requestfailed", fail)
    page.on(
        "request",
        lambda request: (
            None if request.url.startswith(("file:", "data:")) else complaints.append(request.url)
        ),
    )
    yield page
    page.close()
    assert complaints == []
