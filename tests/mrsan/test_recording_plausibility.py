"""What cannot be people who walk is refused, with what it looks like."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mrsan.recording import RecordingError, find_problem, load_recording, read_people, summarize

TRUTH = Path(__file__).parents[1] / "data/recordings/plain.txt"
ROWS = np.loadtxt(TRUTH)  # 40 people at 1.2 m/s, 0.04 s from frame to frame


def written(tmp_path: Path, rows: np.ndarray, columns: str = "fixy") -> Path:
    """A file of rows (frame, id, x, y) in another order of columns."""
    path = tmp_path / "people.txt"
    order = ["fixy".index(column) for column in columns]
    path.write_text("".join(" ".join(map(repr, row)) + "\n" for row in rows[:, order].tolist()))
    return path


def scaled(frame: float = 1.0, position: float = 1.0) -> np.ndarray:
    return ROWS * [frame, 1.0, position, position]


def of(person: int) -> np.ndarray:
    return ROWS[ROWS[:, 1] == person]


def moved(rows: np.ndarray, index: int, x: float) -> np.ndarray:
    """The rows with one of them moved along x."""
    return rows + x * (np.arange(len(rows)) == index)[:, None] * [0, 0, 1, 0]


LINE = np.array([(10 * k, person, 0.4 * k, 5.0) for k in range(30) for person in (1, 2)])
CROWD = np.array([(10 * k, i, 0.4 * k + 0.01 * i, 1e-4 * i) for k in range(30) for i in range(800)])
IMPLAUSIBLE = {
    "seconds": (scaled(frame=0.04), "fixy", r"30 m/s.*frame_seconds to 1 s"),
    "frames renumbered": (scaled(frame=0.1), "fixy", r"12 m/s.*frame_seconds to about 0\.4 s"),
    "centimetres": (scaled(position=100), "fixy", r"recording_scale to about 0\.01 m"),
    "pixels": (scaled(position=27), "fixy", r"recording_scale to about 0\.04 m"),
    "id before frame": (ROWS, "ifxy", "columns in a first line such as 'id frame x y'"),
    "a constant column": (LINE, "fixy", "y is the same in all rows"),
    "nobody walks": (scaled(position=0.0), "fixy", "nobody moves"),
    "a jump": (
        moved(of(6), 10, 9.0),
        "fixy",
        r"person 6 moves at [12]\d\.?\d? m/s from frame \d+ \(line 1[01]\) to \d+ \(line 1[12]\)",
    ),
    "somebody far away": (
        np.concatenate([ROWS, np.add(of(6), [0, 100, 5000, 0])]),
        "fixy",
        "floor is 50.* longer side",
    ),
    "all at one place": (CROWD, "fixy", "800 people .* at most 10 per square metre"),
    "too short": (ROWS[ROWS[:, 0] < 140], "fixy", r"lasts 5\.2 s; it must last at least 6 s"),
    "rows far apart": (
        ROWS[ROWS[:, 0] % 80 == 0],
        "fixy",
        "3.2 s apart.*annotate people more often",
    ),
}


@pytest.mark.parametrize("name", IMPLAUSIBLE)
def test_what_is_implausible_is_refused_unless_the_check_is_off(name: str, tmp_path: Path) -> None:
    rows, columns, pattern = IMPLAUSIBLE[name]
    path = written(tmp_path, rows, columns)
    with pytest.raises(RecordingError, match=pattern):
        load_recording(path, None, 0.25)
    if name not in ("id last", "two scenes one after the other"):
        assert len(load_recording(path, None, 0.25, check=False).position) >= 1


@pytest.mark.parametrize(
    "rows",
    [
        ROWS * [1, 1, 1, -1],  # the y axis of a picture
        ROWS - [1e4, 0, 0, 0],  # negative frames
        np.add(ROWS, [0, 2**52, 5e6, 5e5]),  # huge ids, UTM coordinates
        ROWS * [1, -1, 1, 1],  # negative ids
        of(6)[:20],  # one person
        LINE[LINE[:, 1] == 1],  # one person along an axis
        np.concatenate([ROWS, [[100, 999, 3.0, 3.0]]]),  # somebody in one frame alone
    ],
)
def test_what_is_plausible_is_accepted(rows: np.ndarray, tmp_path: Path) -> None:
    path = written(tmp_path, rows)
    load_recording(path, None, 0.25)
    summary = summarize(read_people(path))
    assert summary.people == len(np.unique(rows[:, 1]))
    assert summary.speed_median == pytest.approx(1.2 if rows[0, 3] != 5.0 else 1.0, abs=0.01)


def test_a_summary_by_hand(tmp_path: Path) -> None:
    """Two people for 8 s: one walks 1 m/s, the other 0.5 m/s, comes after 4 s and pauses once."""
    one = [(10 * k, 1, 0.4 * k, 0.0) for k in range(21)]
    two = [(100 + 10 * k, 2, 2.0, 3.0 - 0.2 * k) for k in range(11) if k not in (4, 5)]
    summary = summarize(read_people(written(tmp_path, np.array([*one, *two]))))
    assert (summary.people, summary.tracks, summary.rows) == (2, 2, 30)
    assert summary.people_at_once == 2
    assert summary.seconds == pytest.approx(8.0)
    assert summary.floor == pytest.approx((8.0, 3.0))
    assert summary.speed_median == pytest.approx(1.0)  # 20 steps of 1 m/s and 8 of 0.5 m/s
    assert summary.speed_largest == pytest.approx(1.0)
    assert summary.longest_gap == pytest.approx(1.2)
    assert summary.pause_median == pytest.approx(0.4)


@given(
    frame=st.floats(0.01, 100.0),
    position=st.floats(1e-3, 1e3),
    shift=st.integers(-(10**6), 10**6),
    angle=st.floats(0.0, 6.28),
)
@settings(max_examples=25, deadline=None)
def test_what_is_measured_does_not_depend_on_units_places_and_directions(
    tmp_path_factory: pytest.TempPathFactory,
    frame: float,
    position: float,
    shift: int,
    angle: float,
) -> None:
    turn = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
    rows = np.column_stack(
        [(ROWS[:, 0] + shift) * frame, ROWS[:, 1], ROWS[:, 2:] @ turn * position]
    )
    path = written(tmp_path_factory.mktemp("people"), rows)
    summary = summarize(read_people(path, 0.04 / frame, 1 / position))
    truth = summarize(read_people(TRUTH))
    for name in ("people", "tracks", "rows", "people_at_once"):
        assert getattr(summary, name) == getattr(truth, name)
    for name in ("seconds", "speed_median", "speed_95", "speed_largest", "longest_gap"):
        assert getattr(summary, name) == pytest.approx(getattr(truth, name), rel=1e-3)


@given(st.one_of(st.floats(1e-4, 0.022), st.floats(0.17, 100.0)))
@settings(max_examples=25, deadline=None)
def test_no_clock_that_is_wrong_by_four_times_is_believed(frame_seconds: float) -> None:
    """At 0.04 s people walk 1.2 m/s; what is refused is 2.2 m/s and more, or under 0.3 m/s."""
    assert find_problem(read_people(TRUTH)) is None
    with pytest.raises(RecordingError, match=r"frame_seconds|apart|lasts"):
        load_recording(TRUTH, frame_seconds, 0.25)
