"""`make` lists every target that has a description."""

import re
from pathlib import Path

from tools.list_targets import described_targets

MAKEFILE = Path(__file__).parents[2] / "Makefile"


def test_targets_are_listed_in_order_with_their_descriptions() -> None:
    text = "VALUE := 1\ntest-all: setup ## Run all: fast and slow\n\t@true\nhidden:\nb: ## Build\n"
    assert list(described_targets(text).items()) == [
        ("test-all", "Run all: fast and slow"),
        ("b", "Build"),
    ]


def test_every_target_that_sets_up_the_environment_is_described() -> None:
    text = MAKEFILE.read_text()
    assert set(re.findall(r"^([a-z-]+): setup", text, re.MULTILINE)) <= set(described_targets(text))
