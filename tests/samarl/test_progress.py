"""Progress bars, on terminals and in log files."""

import time
from pathlib import Path

import pytest

from samarl import progress
from samarl.progress import SharedCount, progress_bar, shared_progress


@pytest.fixture(autouse=True)
def every_tenth_of_a_second(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(progress, "LOG_SECONDS", 0.1)


def test_a_log_file_gets_a_plain_line_now_and_then(capsys: pytest.CaptureFixture[str]) -> None:
    for _ in progress_bar(range(50), desc="cases", unit="case"):
        time.sleep(0.02)
    text = capsys.readouterr().err
    lines = text.splitlines()
    assert 3 <= len(lines) <= 11
    assert all(line.startswith("cases: ") and "of 50 cases" in line for line in lines)
    assert "\r" not in text


def test_work_that_is_done_soon_leaves_no_line(capsys: pytest.CaptureFixture[str]) -> None:
    list(progress_bar(range(50), desc="cases", unit="case"))
    assert capsys.readouterr().err == ""


def test_workers_advance_one_bar(capsys: pytest.CaptureFixture[str]) -> None:
    with progress_bar(total=9, desc="rows", unit="case") as bar:
        with shared_progress(bar, 2) as path:
            SharedCount(path, 0)(4)
            SharedCount(path, 1)(3)
            time.sleep(0.35)
        assert not Path(path).exists()
    assert "rows: 7 of 9 cases" in capsys.readouterr().err
