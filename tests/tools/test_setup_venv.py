"""`make setup` installs only what is missing and explains which Python it needs."""

import os
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pytest

from tools import process, setup_venv

VERSION = "{}.{}".format(*sys.version_info[:2])


@pytest.fixture
def commands(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """The commands that a setup would run, instead of running them."""
    recorded: list[str] = []

    def record(command: Sequence[str], **_: Any) -> None:
        recorded.append(" ".join(command))

    monkeypatch.setattr(setup_venv, "run", record)
    monkeypatch.setattr(process, "run", record)
    return recorded


@pytest.fixture
def root(tmp_path: Path) -> Path:
    """A project whose `.venv` is this Python, without a stamp."""
    (tmp_path / "pyproject.toml").write_text("[project]\n")
    (tmp_path / "constraints.txt").write_text("# torch==1\ntorch-geometric==2.0\ntorch==3.4.5\n")
    (tmp_path / ".venv/bin").mkdir(parents=True)
    (tmp_path / ".venv/bin/python").symlink_to(sys.executable)
    return tmp_path


@pytest.mark.parametrize(
    ("version", "usable"),
    [((3, 10), False), ((3, 11), True), ((3, 12), True), ((3, 13), True), ((3, 14), False)],
)
def test_only_supported_python_versions_are_accepted(
    version: tuple[int, int], usable: bool
) -> None:
    error = setup_venv.version_error(version, "pythonX")
    assert (error is None) == usable
    for part in () if error is None else ("pythonX", "{}.{}".format(*version), "3.11", "3.13"):
        assert part in str(error)


def test_a_second_setup_installs_nothing(root: Path, commands: list[str]) -> None:
    assert setup_venv.set_up(root, VERSION)
    assert [command.split(" --no-compile ")[1] for command in commands] == [
        "torch==3.4.5",
        "-c constraints.txt -e .[dev]",
    ]
    commands.clear()
    os.utime(root / "constraints.txt")  # the content decides, not the date
    assert not setup_venv.set_up(root, VERSION)
    assert commands == []


def test_changed_constraints_are_installed_into_the_same_environment(
    root: Path, commands: list[str]
) -> None:
    setup_venv.set_up(root, VERSION)
    commands.clear()
    (root / "constraints.txt").write_text("torch==3.4.6\n")
    assert setup_venv.set_up(root, VERSION)
    assert len(commands) == 2
    assert "torch==3.4.6" in commands[0]
