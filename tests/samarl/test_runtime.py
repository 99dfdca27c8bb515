"""The runtime on a robot: clocks that jitter, people who are missed, and no torch."""

import json
import math
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mrsan import Observation, Scenario, World
from samarl.agents.learned import Learned
from samarl.agents.shielded import Shielded
from samarl.export import export_agent
from samarl.planning.shield import Shield
from samarl.policies.checkpoint import save_policy
from samarl.runtime import Command, Detection, Driver, InputError, OwnState
from samarl.runtime.simulation import as_seen
from samarl.runtime.slots import Slots
from tests import learning

OWN = OwnState(1.0, 2.0, 0.0, 0.5, 0.0, 6.0, 2.0)
PERSON = Detection(4.0, 3.0, -1.0, 0.2, id="anna")


@pytest.fixture(scope="module")
def path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A small policy for a robot that knows of three people and one other robot."""
    folder = tmp_path_factory.mktemp("exported")
    policy = learning.policy("flat", gain=100.0)
    save_policy(folder / "policy.safetensors", policy, "flat", {})
    scenario = Scenario(humans=3, robots=2)
    agent = Learned(scenario, str(folder / "policy.safetensors"))
    shielded = Shielded(scenario, agent, Shield(track_time=2.0))
    export_agent(folder / "policy.onnx", shielded, "mine")
    return folder / "policy.onnx"


@pytest.fixture
def driver(path: Path) -> Driver:
    return Driver.load(path)


@pytest.fixture(scope="module")
def loaded(path: Path) -> Driver:
    """A driver for many short drives, each after a reset."""
    return Driver.load(path)


@pytest.fixture
def tracks(driver: Driver, monkeypatch: pytest.MonkeyPatch) -> list[Observation]:
    """What the policy is told, step by step."""
    network_inputs: list[Observation] = []
    original_action = driver._network.action

    def spy(known: Observation, aim: np.ndarray) -> np.ndarray:
        network_inputs.append(
            Observation.from_arrays({name: a.copy() for name, a in known.arrays("known").items()})
        )
        return original_action(known, aim)

    monkeypatch.setattr(driver._network, "action", spy)
    return network_inputs


def test_who_is_missed_goes_on_for_the_time_that_has_passed(
    driver: Driver, tracks: list[Observation]
) -> None:
    driver.step(OWN, [PERSON], 100.0)
    for time in (100.15, 100.55, 100.8):  # early, late, on time
        driver.step(OWN, [], time)
    first, early, late, usual = (t.humans[0, 0, 0] for t in tracks)
    # From the robot at (1, 2), which heads along x at 0.5 m/s.
    assert first == pytest.approx([3.0, 1.0, -1.5, 0.2, 0.3, 0.0], abs=1e-5)
    assert early == pytest.approx([2.85, 1.03, -1.5, 0.2, 0.3, 0.6 / 8], abs=1e-5)
    assert late == pytest.approx([2.45, 1.11, -1.5, 0.2, 0.3, 2.2 / 8], abs=1e-5)
    assert usual == pytest.approx([2.2, 1.16, -1.5, 0.2, 0.3, 3.2 / 8], abs=1e-5)
    driver.step(OWN, [], 102.05)  # 8 steps of 0.25 s are over
    assert not tracks[-1].humans_known.any()


def test_the_first_step_needs_no_past_and_reset_is_one(path: Path, driver: Driver) -> None:
    def drive(times: list[float]) -> list[Command]:
        seen = [PERSON._replace(x=PERSON.x - 0.2 * k) for k in range(len(times))]
        return [driver.step(OWN, [person], t) for person, t in zip(seen, times, strict=True)]

    def actions(commands: list[Command]) -> np.ndarray:
        return np.stack([command.action for command in commands])

    first = actions(drive([3.0, 3.25, 3.5]))
    later = actions(drive([3.75, 4.0, 4.25]))
    driver.reset()
    again = actions(drive([0.0, 0.25, 0.5]))  # the clock may begin anew as well
    np.testing.assert_array_equal(again, first)
    assert np.abs(later - first).max() > 1e-5
    other = Driver.load(path)
    assert np.array_equal(other.step(OWN, [PERSON], 0.0).action, first[0])


def test_any_clock_drives(driver: Driver) -> None:
    for gap in (0.15, 0.4, 30.0):
        driver.reset()
        for k in range(40):
            command = driver.step(OWN, [PERSON] if k % 3 else [], 5.0 + gap * k)
            assert np.isfinite(command.action).all()
            assert abs(command.heading) <= math.pi
            assert 0.0 <= command.speed <= 1.0 + 1e-6


NAN = float("nan")


def test_an_invalid_input_is_named_and_changes_nothing(path: Path, driver: Driver) -> None:
    undisturbed = Driver.load(path)
    for one in (driver, undisturbed):
        one.step(OWN, [PERSON], 0.5)
    cases: list[tuple[Any, Any, Any, str]] = [
        (OWN._replace(velocity_x=NAN), [], 1.0, "own.velocity_x"),
        (OWN._replace(x=np.array([1.0])), [], 1.0, "own.x"),
        (OWN._asdict(), [], 1.0, "own"),
        (OWN, None, 1.0, "detections"),
        (OWN, PERSON, 1.0, "detections[0]"),  # one detection that is not in a list
        (OWN, [PERSON._asdict()], 1.0, "detections[0]"),
        (OWN, [PERSON, PERSON._replace(y=NAN, id=2)], 1.0, "detections[1].y"),
        (OWN, [PERSON._replace(velocity_x=-1200.0)], 1.0, "detections[0]"),  # mm/s
        (OWN, [PERSON._replace(id=[1])], 1.0, "detections[0].id"),
        (OWN, [PERSON, PERSON], 1.0, "detections[1].id"),
        (OWN, [], NAN, "time"),
        (OWN, [], 0.5, "time"),  # not later than the step before
    ]
    for own, detections, time, field in cases:
        with pytest.raises(InputError) as error:
            driver.step(own, detections, time)
        assert str(error.value).startswith(f"{field} ")
        assert "\n" not in str(error.value)
    expected = undisturbed.step(OWN, [PERSON], 0.75)
    np.testing.assert_array_equal(driver.step(OWN, [PERSON], 0.75).action, expected.action)


ANYTHING = st.one_of(
    st.none(),
    st.booleans(),
    st.integers(),
    st.floats(),
    st.complex_numbers(),
    st.text(max_size=3),
    st.binary(max_size=3),
    st.fractions(),
    st.decimals(),
    st.lists(st.floats(), max_size=2),
    st.dictionaries(st.integers(), st.none(), max_size=1),
    st.sampled_from(
        [np.float32(2.0), np.int64(3), np.array(1.0), np.array([1.0]), np.zeros((2, 2)), object()]
    ),
)
OFTEN_VALID = st.floats(-5.0, 5.0) | ANYTHING
OWN_STATES = st.builds(OwnState, *[OFTEN_VALID] * 7) | ANYTHING
DETECTIONS = st.builds(
    Detection, *[OFTEN_VALID] * 4, radius=OFTEN_VALID, robot=st.booleans() | ANYTHING, id=ANYTHING
)
SEVERAL = st.lists(st.just(PERSON) | DETECTIONS | ANYTHING, max_size=3)
ITERABLES = SEVERAL | SEVERAL.map(tuple) | SEVERAL.map(iter) | ANYTHING


@settings(deadline=None, max_examples=150)
@given(own=st.just(OWN) | OWN_STATES, detections=ITERABLES, time=st.just(2.0) | ANYTHING)
def test_any_input_drives_or_raises_an_input_error(
    loaded: Driver, own: Any, detections: Any, time: Any
) -> None:
    loaded.reset()
    before = loaded.step(OWN, [PERSON], 0.5)
    try:
        command = loaded.step(own, detections, time)
    except InputError:
        after = loaded.step(OWN, [PERSON], 0.75)
        loaded.reset()
        np.testing.assert_array_equal(loaded.step(OWN, [PERSON], 0.5).action, before.action)
        np.testing.assert_array_equal(loaded.step(OWN, [PERSON], 0.75).action, after.action)
    else:
        assert np.isfinite(command.action).all()


def test_people_without_ids_are_followed_through_a_crowd() -> None:
    world = World(Scenario(humans=12, robots=1, fov_degrees=200.0, missed_detection=0.1), 1)
    observation, slots = world.reset([4]), Slots(12, 6.0)
    who: dict[int, int] = {}
    swaps = sightings = 0
    for step in range(120):
        own, named = as_seen(observation, 0)
        seen = [person._replace(id=None) for person in named]
        places, new = slots.assign(seen, own.x, own.y, 0.25 * step)
        known = {id(person): true.id for person, true in zip(seen, named, strict=True)}
        assert len({slot for slot, _ in places}) == len(seen)
        for slot, person in places:
            sightings += 1
            swaps += slot not in new and who[slot] != known[id(person)]
            who[slot] = known[id(person)]
        observation = world.step(np.zeros((1, 1, 3), np.float32)).observation
    assert sightings > 500
    assert swaps <= 0.005 * sightings


def test_ids_are_known_again_and_of_too_many_the_nearest_count() -> None:
    slots = Slots(2, 1.0)
    a, b, c = (Detection(x, 0.0, 0.0, 0.0, id=name) for x, name in ((1, "a"), (2, "b"), (3, "c")))
    assert slots.assign([c, b, a], 0.0, 0.0, 0.0) == ([(0, a), (1, b)], [0, 1])
    assert slots.assign([b], 0.0, 0.0, 0.5) == ([(1, b)], [])
    assert slots.assign([c], 0.0, 0.0, 9.0) == ([(0, c)], [0])  # a was not seen for the longest
    assert slots.assign([b], 0.0, 0.0, 99.0) == ([(1, b)], [])
    far = Detection(2.0, 0.9, 0.0, 0.0)  # farther than the gate from anybody, and without a name
    assert slots.assign([far], 0.0, 0.0, 99.1)[1] == [0]


def test_the_shield_steps_in(driver: Driver) -> None:
    wall = [
        Detection(1.0 + 0.75 * math.cos(a), 2.0 + 0.75 * math.sin(a), 0.0, 0.0)
        for a in (-0.9, 0.0, 0.9)
    ]
    command = driver.step(OWN._replace(velocity_x=1.0), wall, 0.0)
    assert command.shielded
    assert command.acceleration == pytest.approx(-4.0)  # from 1 m/s in 0.25 s
    assert command.speed == 0.0


ALLOWED = ("numpy", "numba", "llvmlite", "onnxruntime", "flatbuffers", "google", "mrsan", "samarl")
ALONE = f"""
import json, sys

class OnlyThese:
    def find_spec(self, name, path=None, target=None):
        top = name.partition(".")[0]
        if top in {ALLOWED!r} or top in sys.stdlib_module_names or top.startswith("_"):
            return None
        raise ModuleNotFoundError(f"{{name}} is not installed on this robot")

sys.meta_path.insert(0, OnlyThese())
from samarl.runtime import Detection, Driver, OwnState
driver = Driver.load(sys.argv[1])
for line in sys.stdin:
    own, seen, time = json.loads(line)
    command = driver.step(OwnState(*own), [Detection(*one) for one in seen], time)
    print(json.dumps([float(number) for number in command.action]))
assert not {{"torch", "torchrl", "tensordict", "gymnasium", "omegaconf"}} & set(sys.modules)
"""


def test_it_needs_numpy_numba_and_onnxruntime_alone(path: Path, driver: Driver) -> None:
    steps = [(list(OWN), [list(PERSON._replace(x=4.0 - 0.25 * k))], 0.25 * k) for k in range(8)]
    done = subprocess.run(
        [sys.executable, "-c", ALONE, str(path)],
        input="\n".join(map(json.dumps, steps)),
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr
    for line, (own, seen, time) in zip(done.stdout.splitlines(), steps, strict=True):
        command = driver.step(OwnState(*own), [Detection(*one) for one in seen], time)
        assert json.loads(line) == pytest.approx(command.action.tolist(), abs=1e-6)
