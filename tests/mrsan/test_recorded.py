"""Recorded people: files in, ways out, and nobody reacts to a robot."""

import itertools
from pathlib import Path

import numpy as np
import pytest

from benchmarks.synthetic_recording import recording_text as synthetic
from mrsan import Crowd, Scenario, World
from mrsan.recording import (
    SAMPLE,
    load_recording,
)

CASES = np.arange(20)
# Two people for 8 s on a floor of 12 m by 8 m: one walks 1 m/s along x, one stands.
TWO = "".join(f"{10 * k} 1 {0.4 * k:.2f} 0\n{10 * k} 2 12 8\n" for k in range(21))


def written(tmp_path: Path, text: str, name: str = "people.txt") -> str:
    path = tmp_path / name
    path.write_text(text)
    return str(path)


def recorded(recording: str | None = None, **fields) -> Scenario:
    fields = {"humans": 64, "robots": 2, **fields}
    return Scenario(crowd=Crowd.recorded, recording=recording, **fields)


def rest(world: World) -> np.ndarray:
    return np.zeros((world.worlds, world.scenario.robots, 3), np.float32)


def test_the_sample_is_what_its_script_makes() -> None:
    assert synthetic() == SAMPLE.read_text()


def test_people_are_where_they_were_between_frames_too(tmp_path: Path) -> None:
    way = load_recording(written(tmp_path, TWO), 0.04, 0.25)
    assert (way.steps, way.half_size.tolist()) == (32, [6.0, 4.0])
    walker, stander = (way.position[r : r + 33] for r in way.row)  # both coast to the end of it
    assert way.first.tolist() == [0, 0]
    assert way.last.tolist() == [32, 32]
    steps = np.arange(33) * 0.25
    np.testing.assert_allclose(walker[:, 0], steps - 6, atol=1e-5)  # 1 m/s, from the middle
    np.testing.assert_allclose(walker[:, 1], -4, atol=1e-6)
    np.testing.assert_allclose(stander, np.broadcast_to([6.0, 4.0], (33, 2)), atol=1e-6)


def test_people_go_on_for_three_seconds_before_and_after(tmp_path: Path) -> None:
    """Person 3 is annotated from 4.0 to 4.8 s, at 2 m/s along y, of 20 s."""
    text = "".join(f"{10 * k} 1 {0.2 * k} 10\n" for k in range(51))
    text += "".join(f"{100 + 10 * k} 3 5 {0.8 * k}\n" for k in range(3))
    way = load_recording(written(tmp_path, text), 0.04, 0.25)
    assert (way.first[1], way.last[1]) == (4, 31)  # 1.0 and 7.75 s
    y = way.position[way.row[1] : way.row[1] + 28, 1]
    np.testing.assert_allclose(y, 2.0 * (np.arange(4, 32) * 0.25 - 4.0) - 5.0, atol=1e-5)


@pytest.mark.parametrize(("pause", "tracks"), [(2.8, 1), (3.2, 2), (5.0, 2), (20.0, 2)])
def test_a_long_gap_begins_another_track(tmp_path: Path, pause: float, tracks: int) -> None:
    """Person 1 walks at 1 m/s for 8 s, is not seen for a while, and walks on from there."""
    times = [0.4 * k for k in range(21)]
    times += [8.0 + pause + 0.4 * k for k in range(21)]
    text = "".join(
        f"{t / 0.04:.0f} 1 {t:.2f} 0\n{t / 0.04:.0f} 2 9 {7 - t / 9:.3f}\n" for t in times
    )
    way = load_recording(written(tmp_path, text), 0.04, 0.2)
    paths = [
        (first, last, way.position[row : row + last - first + 1])
        for first, last, row in zip(way.first, way.last, way.row, strict=True)
    ]
    walker = [path for path in paths if np.ptp(path[2][:, 1]) < 1e-4]
    assert len(walker) == tracks
    for (_, last, _), (first, _, _) in itertools.pairwise(walker):
        seconds = (first - last) * 0.2
        assert seconds > 0  # the person is never there twice
        assert seconds == pytest.approx(max(pause - 6.0, 0.2), abs=0.2)
    for first, last, path in walker:  # and coasts as it walks
        np.testing.assert_allclose(
            path[:, 0] - walker[0][2][0, 0], np.arange(first, last + 1) * 0.2, atol=1e-4
        )


def test_people_in_the_world_walk_as_recorded() -> None:
    world = World(recorded(), len(CASES))
    world.reset(CASES)
    state, ways = world.state, load_recording(None, 0.04, 0.25)
    came = 0
    for _ in range(60):
        before, had = state.human_position.copy(), state.human_present.copy()
        world.step(rest(world))
        going = ~state.done
        now = state.record_step + state.clock
        for e in np.flatnonzero(going):
            there = np.flatnonzero(state.human_present[e])
            q = state.human_track[e, there]
            assert len(set(q.tolist())) == len(q)
            expected = ways.position[ways.row[q] + now[e] - ways.first[q]]
            np.testing.assert_allclose(state.human_position[e, there], expected, atol=1e-4)
            stayed = there[had[e, there]]
            moved = (state.human_position - before)[e, stayed] / 0.25
            np.testing.assert_allclose(state.human_velocity[e, stayed], moved, atol=1e-4)
            came += len(there) - len(stayed)
    assert came > 50


def test_nobody_appears_next_to_a_driving_robot() -> None:
    """Who would appear within 3 m of one enters later; who is there from the start, at once."""
    world = World(recorded(terminate_on_collision=False), len(CASES))
    world.reset(CASES)
    ways, state = load_recording(None, 0.04, 0.25), world.state
    is_there = (ways.first <= state.record_step[:, None]) & (ways.last > state.record_step[:, None])
    np.testing.assert_array_equal(state.human_present.sum(1), is_there.sum(1))
    held_back, came_later = 0, 0
    for _ in range(150):
        had, tracks = state.human_present.copy(), state.human_track.copy()
        robots = state.robot_position.copy()
        world.step(rest(world))
        for e in range(len(CASES)):
            now = state.record_step[e] + state.clock[e]
            for q in np.flatnonzero((ways.first < now) & (ways.last > now)):
                place = ways.position[ways.row[q] + now - 1 - ways.first[q]]  # before the step
                distance = np.linalg.norm(robots[e] - place, axis=-1).min()
                is_there = q in state.human_track[e][state.human_present[e]]
                was_there = q in tracks[e][had[e]]
                assert is_there or distance < 3.0
                assert was_there or not is_there or distance >= 3.0
                held_back += not is_there
                came_later += is_there and not was_there and ways.first[q] < now - 1
    assert held_back > 20
    assert came_later > 5


def test_with_few_slots_the_nearest_are_kept() -> None:
    many, few = World(recorded(), len(CASES)), World(recorded(humans=3), len(CASES))
    for world in (many, few):
        world.reset(CASES)
    np.testing.assert_array_equal(many.state.robot_position, few.state.robot_position)
    for e in range(len(CASES)):
        there = many.state.human_position[e, many.state.human_present[e]]
        away = np.linalg.norm(there[:, None] - many.state.robot_position[e], axis=-1).min(1)
        places = few.state.human_position[e, few.state.human_present[e]]
        distances = np.linalg.norm(places[:, None] - many.state.robot_position[e], axis=-1).min(1)
        np.testing.assert_allclose(distances, np.sort(away)[:3])


def test_a_slot_is_not_another_person_before_it_is_forgotten() -> None:
    """Robots remember for 6 s whom they saw."""
    world = World(recorded(humans=4), len(CASES))
    world.reset(CASES)
    state = world.state
    state.robot_position[:] += 1000.0
    last_seen = np.full(state.human_track.shape, -1000)
    last_track = state.human_track.copy()
    changes = 0
    for clock in range(150):
        world.step(rest(world))
        changed = state.human_present & (state.human_track != last_track) & (last_track >= 0)
        assert (clock - last_seen[changed] >= 24).all()
        changes += int(changed.sum())
        last_track = np.where(state.human_present, state.human_track, last_track)
        last_seen[state.human_present] = clock
    assert changes > 20


def test_robots_start_where_nobody_is() -> None:
    world = World(recorded(robots=4), 200)
    world.reset(np.arange(200))
    s = world.state
    gap = np.linalg.norm(s.robot_position[:, :, None] - s.human_position[:, None], axis=-1)
    assert gap[np.broadcast_to(s.human_present[:, None], gap.shape)].min() >= 1.0 - 1e-4
    for _ in range(8):  # nor does anybody come there in the first two seconds
        world.step(rest(world))
        assert not s.terminated.any()
    half = load_recording(None, 0.04, 0.25).half_size
    assert (np.abs(s.robot_position) <= half).all()
    assert (np.abs(s.robot_goal) <= half).all()
    way = np.linalg.norm(s.robot_goal - s.robot_position, axis=-1)
    assert 4.0 <= way.min() <= way.max() <= 14.0
    assert len(np.unique(s.record_step)) > 100  # moments differ
