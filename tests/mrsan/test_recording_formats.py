"""One recording in the formats and with the faults of public files: read rightly, or refused."""

import contextlib
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mrsan.recording import (
    People,
    Recording,
    RecordingError,
    load_recording,
    read_people,
    summarize,
)

CASES = Path(__file__).parents[1] / "data/recordings"
TRUTH = CASES / "plain.txt"  # 40 people at 1.2 m/s on 14 x 14 m, 25 frames/s, every tenth

# What is refused: what the error must name, and settings that make it right.
REFUSED: dict[str, tuple[str, dict[str, float]]] = {
    "centimetres.txt": ("scenario.recording_scale to about 0.01", {"scale": 0.01}),
    "pixels_four_columns.txt": ("scenario.recording_scale to about 0.04", {"scale": 0.037}),
    "sdd_annotations.txt": ("pixels; set scenario.recording_scale", {"scale": 0.037}),
    "renumbered_2_5_fps.txt": ("scenario.frame_seconds to about 0.4", {"frame_seconds": 0.4}),
    "seconds.txt": ("scenario.frame_seconds to 1 s", {"frame_seconds": 1.0}),
    "only_once_each.txt": ("must have the same id in every frame", {}),
    "five_seconds.txt": ("lasts 4.4 s; it must last at least 6 s", {}),
}


def load(path: Path, scale: float | None = None, frame_seconds: float | None = None) -> People:
    """Read a file as an environment does, with the check."""
    load_recording(path, frame_seconds, 0.25, scale)
    return read_people(path, frame_seconds, scale)


def assert_is_the_truth(people: People) -> None:
    summary = summarize(people)
    assert summary.people == 40
    assert summary.speed_median == pytest.approx(1.2, abs=0.02)
    assert summary.floor == pytest.approx((14.4, 14.4), abs=0.25)


@pytest.mark.parametrize("path", sorted(CASES.iterdir()), ids=lambda path: path.name)
def test_a_recording_is_the_same_people_or_is_refused(path: Path) -> None:
    if path.name not in REFUSED:
        assert_is_the_truth(load(path))
    else:
        words, remedy = REFUSED[path.name]
        with pytest.raises(RecordingError) as error:
            load(path)
        assert words in str(error.value)
        assert path.name in str(error.value)
        if remedy:
            assert_is_the_truth(load(path, **remedy))


def test_what_is_only_written_differently_is_the_same_to_the_last_bit() -> None:
    names = "bom.txt crlf.txt decimal_comma.csv exact_duplicates.txt header.csv unsorted.txt"
    names += " indented_comment.txt pedpy_id_first.txt semicolon_comment.txt utf16.txt"
    truth = load_recording(TRUTH, None, 0.25)
    for name in names.split():
        other = load_recording(CASES / name, None, 0.25)
        for one, two in zip(truth, other, strict=True):
            np.testing.assert_array_equal(one, two, err_msg=name)


ROWS = np.array(
    [
        (10 * k, person, person + 0.48 * k, 2.5 * person - 0.1 * k)
        for k in range(20)
        for person in (1, 2, 30)
    ]
)


def written(tmp_path: Path, text: str | bytes, name: str = "people") -> Path:
    path = tmp_path / name
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return path


def lines(*columns: np.ndarray, separator: str = " ") -> str:
    rows = np.column_stack(columns)
    return "".join(separator.join(f"{value:.15g}" for value in row) + "\n" for row in rows)


def in_formats(frame: np.ndarray, person: np.ndarray, x: np.ndarray, y: np.ndarray) -> dict:
    """`ROWS` in the formats that state their clock, their unit, or both."""
    zero = np.zeros_like(frame)
    tracks = zip(frame, person, x.tolist(), y.tolist(), strict=True)
    return {
        # Time in s since 1970, id, x, y and z in mm, velocity, two angles.
        "ATC": lines(
            1351037270 + 0.04 * frame,
            person,
            1e3 * x,
            1e3 * y,
            1.7e3 + zero,
            zero,
            zero,
            zero,
            separator=",",
        ),
        "PedPy": f"# framerate: 16 fps\n# id frame x/cm y/cm z/cm\n"
        f"{lines(person, frame, 1e2 * x, 1e2 * y, zero)}",
        "PedPy without names": f"#framerate: 16\n{lines(person, frame, x, y, zero)}",
        "named": "time[ms];id;x[mm];y[mm]\n"
        f"{lines(40 * frame, person, 1e3 * x, 1e3 * y, separator=';')}",
        # 10 frames in 0.667 s at 0.72 and -0.15 m/s.
        "obsmat": lines(frame, person, x, zero, y, zero + 0.72, zero, zero - 0.15),
        "TrajNet++": '{"scene": {"fps": 2.0}}\n'
        + "".join(
            f'{{"track": {{"f": {f:g}, "p": {p:g}, "x": {a!r}, "y": {b!r}}}}}\n'
            for f, p, a, b in tracks
        ),
    }


def test_the_clock_and_the_unit_that_a_file_states_are_used_and_checked(tmp_path: Path) -> None:
    files = in_formats(*ROWS.T)
    clocks = {
        "ATC": 0.04,
        "PedPy": 1 / 16,
        "PedPy without names": 1 / 16,
        "named": 0.04,
        "obsmat": 0.0667,
        "TrajNet++": 0.05,
    }
    for name, text in files.items():
        path = written(tmp_path, text)
        people = load(path)
        assert people.seconds.max() == pytest.approx(190 * clocks[name], rel=1e-4), name
        np.testing.assert_allclose(people.position, ROWS[:, 2:], atol=1e-6)
        with pytest.raises(RecordingError, match=r"frame_seconds is 0\.03, but the file states"):
            load(path, frame_seconds=0.03)
    with pytest.raises(RecordingError, match=r"recording_scale is 1, but the file states 0\.001"):
        load(written(tmp_path, files["ATC"]), scale=1.0)


def test_recordings_far_from_the_origin_give_the_same_people(tmp_path: Path) -> None:
    """In site coordinates, up to 10^7 m from their origin."""
    frame, person, x, y = ROWS.T

    def recordings(dx: float, dy: float) -> dict[str, Recording]:
        columns = frame, person, x + dx, y + dy
        files = in_formats(*columns) | {
            "plain": lines(*columns),
            "decimal commas": lines(*columns, separator=";").replace(".", ","),
            "transposed": lines(*np.array(columns)[[0, 1, 3, 2]].T, separator=","),
            "SDD": "".join(
                f"{p:g} {a:.15g} {b:.15g} {a:.15g} {b:.15g} {f:g} 0 0 0 Pedestrian\n"
                for f, p, a, b in zip(frame, person, *(10 * np.array(columns[2:])), strict=True)
            ),
        }
        return {
            name: load_recording(
                written(tmp_path, text, f"{name} {dx}"), None, 0.25, 0.1 if name == "SDD" else None
            )
            for name, text in files.items()
        }

    near = recordings(0.0, 0.0)
    for offset in ((1e5, -2e5), (691000.37, 5334000.81), (-1e7, 1e7)):
        for name, far in recordings(*offset).items():
            np.testing.assert_allclose(far.position, near[name].position, atol=1e-5, err_msg=name)
            np.testing.assert_allclose(far.half_size, near[name].half_size, atol=1e-5)
            np.testing.assert_allclose(far.centre - near[name].centre, offset, atol=1e-5)
            for one, two in zip(far[:3], near[name][:3], strict=True):
                np.testing.assert_array_equal(one, two, err_msg=name)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("0 1 2 3 4\n", "rows have 5 values and no header names them; it must have 4"),
        ("frame,id,x\n0,1,2\n", "'frame,id,x' has no column named y"),
        ("id,frame,ped_id,x,y\n0,1,2,5,3\n", "columns 'id' and 'ped_id' may both be id"),
        ("x/m y/cm id frame\n0 1 2 3\n", "x is in m and y in cm; both must be in the same unit"),
        ('{"track": {"f": 0, "p": 1.5, "x": 0, "y": 0}}\n', "p is 1.5; it must be a whole number"),
        (
            "0,0,0,0,0\n1,1,1,1,1\n0,.1,.2,.3,.4\n0,.1,.2,.3,.4\n",
            "relative to the width and height of the image",
        ),
        (b"\x1f\x8b\x08", "compressed; unpack it first"),
        (bytes(range(256)), "cannot be read as text"),
    ],
)
def test_a_refusal_says_what_is_wrong_with_this_file(
    tmp_path: Path, text: str | bytes, words: str
) -> None:
    path = written(tmp_path, text)
    with pytest.raises(RecordingError) as error:
        load(path)
    assert words in str(error.value)
    assert (
        "must" in str(error.value) or "unpack" in str(error.value) or "export" in str(error.value)
    )


@given(st.lists(st.text(st.sampled_from("0123456789.-,;?# \t\"'{}[]:efx\u00fc"), max_size=30)))
@settings(max_examples=200, deadline=None)
def test_any_text_is_read_or_refused(
    tmp_path_factory: pytest.TempPathFactory, content: list[str]
) -> None:
    path = written(tmp_path_factory.mktemp("text"), "\n".join(content))
    with contextlib.suppress(RecordingError):  # and no other error
        load_recording(path, None, 0.25, check=False)
