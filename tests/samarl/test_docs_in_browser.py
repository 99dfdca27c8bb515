"""The built documentation in a browser: nothing is cut off, and commands can be copied."""

from pathlib import Path

import pytest
from playwright.sync_api import Browser, Page

DOCS = Path(__file__).parents[2] / "outputs/docs"
pytestmark = pytest.mark.skipif(not DOCS.is_dir(), reason="make docs builds it")
CUT_COMMANDS = """blocks => blocks.filter(block => block.scrollWidth > block.clientWidth + 1)
    .map(block => block.innerText)"""


@pytest.mark.parametrize("width", [1400, 390])
def test_every_page_fits(page: Page, width: int) -> None:
    page.set_viewport_size({"width": width, "height": 900})
    for path in DOCS.rglob("*.html"):
        if path.parent.name == "play":  # a page of the report, which has tests of its own
            continue
        page.goto(path.as_uri(), wait_until="domcontentloaded")
        assert page.evaluate("document.documentElement.scrollWidth") <= width, path
        assert page.eval_on_selector_all(".language-console code", CUT_COMMANDS) == [], path
        assert page.evaluate("getComputedStyle(document.body).margin") == "0px", path  # has style


def test_commands_are_copied_without_prompt_and_output(browser: Browser) -> None:
    context = browser.new_context(permissions=["clipboard-read", "clipboard-write"])
    page = context.new_page()
    page.goto((DOCS / "quickstart.html").as_uri())
    block = page.locator(".language-console", has_text="error:")
    shown = block.inner_text().strip().splitlines()
    assert shown[-1].startswith("error:")
    block.hover()
    block.locator("[data-clipboard-target]").click()
    copied = page.evaluate("navigator.clipboard.readText()")
    context.close()
    assert copied.splitlines() == [
        line.removeprefix("$ ") for line in shown if line.startswith("$ ")
    ]
