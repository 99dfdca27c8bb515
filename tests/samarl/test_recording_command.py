"""`samarl-recording` summarises, draws and converts a file."""

import re
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from mrsan.recording import load_recording
from samarl.commands import recording as command

CASES = Path(__file__).parents[1] / "data/recordings"
NAMES = [
    "my data (1)/p.txt",
    "Zürich.txt",
    "a=b.txt",
    "it's.txt",
    "x,y.txt",
    "$x^2$ 人.txt",
    "[1]{2}",
]


@pytest.fixture
def run(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]):
    """Run the command; returns its exit code, and what it printed and said of errors."""

    def call(*words: object) -> tuple[int, str, str]:
        monkeypatch.setattr("sys.argv", ["samarl-recording", *map(str, words)])
        code = 0
        try:
            command.main()
        except SystemExit as stop:
            code = int(stop.code or 0)
        printed = capsys.readouterr()
        return code, printed.out, printed.err

    return call


@pytest.fixture(autouse=True)
def _here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


def test_a_summary(run) -> None:
    code, printed, error = run(CASES / "pedpy_id_first.txt")
    assert (code, error) == (0, "")
    summary = dict(re.split("  +", line, maxsplit=1) for line in printed.splitlines())
    assert summary["format"].startswith("PedPy")
    assert summary["people"] == "40, at most 9 at once"
    assert summary["duration"] == "89.2 s"  # 2230 frames of 0.04 s
    assert summary["clock"].endswith("(as stated in the file)")
    assert summary["floor"] == "14.4 x 14.4 m"
    assert summary["speeds"].startswith("median 1.20")
    assert summary["verdict"] == "plausible"


def test_any_path_is_a_path(run) -> None:
    for name in NAMES:
        path = Path(name)
        path.parent.mkdir(exist_ok=True)
        path.write_bytes((CASES / "plain.txt").read_bytes())
        picture, new = (path.with_name(f"{path.name}{end}") for end in (".png", " new"))
        code, _, error = run(path, "--figure", picture, "--output", new)
        assert (code, error) == (0, "")
        with Image.open(picture) as image:
            assert len(image.getcolors(1000) or []) > 40  # tracks have the colours of their times


def test_converted_files_need_no_settings(run) -> None:
    for name, frame_seconds, scale in (
        ("pedpy_id_first.txt", None, None),
        ("trajnet_predictions.ndjson", None, None),
        ("epoch_seconds.txt", None, None),
        ("obsmat8.txt", None, None),
        ("centimetres.txt", None, 0.01),
        ("renumbered_2_5_fps.txt", 0.4, None),
    ):
        options = [f"--frame-seconds={frame_seconds}"] * (frame_seconds is not None)
        options += [f"--scale={scale}"] * (scale is not None)
        for ending in ("txt", "csv"):
            code, _, error = run(CASES / name, *options, "--output", f"new.{ending}")
            assert (code, error) == (0, "")
            truth = load_recording(CASES / name, frame_seconds, 0.25, scale)
            again = load_recording(f"new.{ending}", None, 0.25)
            np.testing.assert_array_equal(again.first, truth.first)
            np.testing.assert_array_equal(again.last, truth.last)
            np.testing.assert_allclose(again.position, truth.position, atol=2e-5)


def test_implausible_recordings_are_drawn_but_not_converted(run) -> None:
    words = [CASES / "renumbered_2_5_fps.txt", "--figure", "new.png", "--output", "new.txt"]
    code, printed, error = run(*words)
    assert code == 2
    assert re.search(r"verdict +implausible", printed)
    assert error.startswith("error: ")
    assert "--frame-seconds to about 0.4" in error
    assert error.count("\n") == 1
    assert sorted(path.name for path in Path().iterdir()) == ["new.png"]
    assert run(*words, "--no-check")[0] == 0
    assert Path("new.txt").exists()


def test_user_errors_end_in_one_line(run) -> None:
    plain = CASES / "plain.txt"
    for words, message in (
        ([], "FILE"),
        (["nowhere.txt"], "'nowhere.txt'"),
        ([plain, "--scale", "0"], r"--scale is 0\.0; it must lie in \[1e-06, "),
        ([plain, "--figure", "a.bmp"], r"--figure is 'a\.bmp'; it must end in \.png"),
        ([plain, "--output", "/dev/null/a"], "--output is '/dev/null/a'"),
        ([plain, "--output", plain], "it must be another"),
        ([CASES / "sdd_annotations.txt"], "--scale to the metres per pixel"),
        ([plain, "--nothing"], "--nothing"),
    ):
        code, _, error = run(*words)
        assert code == 2
        assert re.fullmatch(f"error: .*{message}.*\n", error)
