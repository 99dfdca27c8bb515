"""Driving with the keyboard, without a screen: keys are fed to a canvas of the Agg backend."""

import math

import numpy as np
import pytest
from matplotlib.backend_bases import KeyEvent
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from mrsan import Kinematics, Scenario
from mrsan.play import Game, Window, main


def window_of(game: Game) -> tuple[Window, FigureCanvasAgg]:
    canvas = FigureCanvasAgg(Figure())
    return Window(game, canvas.figure), canvas


def feed(canvas: FigureCanvasAgg, key: str, event: str = "key_press_event") -> None:
    canvas.callbacks.process(event, KeyEvent(event, canvas, key))


def test_the_up_key_drives_to_the_goal() -> None:
    game = Game(Scenario(robots=1, humans=0), 0, "still")  # a robot starts facing its goal
    window, canvas = window_of(game)
    feed(canvas, "up")
    window.tick()
    assert game.speed == pytest.approx(0.25)  # 1 m/s^2 for 0.25 s
    assert "0.25 m/s, goal in" in window.text.get_text()
    for _ in range(60):
        window.tick()
    assert game.is_over
    start, goal = game.world.state.robot_start[0, 0], game.world.state.robot_goal[0, 0]
    assert math.dist(start, goal) > 8.0
    assert "case 0: arrived after" in window.text.get_text()
    assert "social score 100" in window.text.get_text()
    clock = int(game.world.state.clock[0])
    window.tick()
    assert game.world.state.clock[0] == clock
    feed(canvas, "n")
    assert (game.case, game.is_over, game.total_reward) == (1, False, 0.0)


def test_a_released_key_has_no_effect_and_letters_are_arrows() -> None:
    game = Game(Scenario(robots=1, humans=0), 3, "still")
    window, canvas = window_of(game)
    heading = float(game.world.state.robot_heading[0, 0])
    feed(canvas, "a")  # turn left on the spot by 15 degrees
    feed(canvas, "down")
    window.tick()
    feed(canvas, "a", "key_release_event")
    window.tick()
    turn = float(game.world.state.robot_heading[0, 0]) - heading
    assert math.remainder(turn, 2 * math.pi) == pytest.approx(math.radians(15), abs=1e-5)
    feed(canvas, "r")
    assert game.world.state.clock[0] == 0


def test_holonomic_robots_drive_in_the_direction_on_the_screen() -> None:
    game = Game(Scenario(robots=1, humans=0, kinematics=Kinematics.holonomic), 0, "still")
    before = game.world.state.robot_position[0, 0].copy()
    for keys in ({"left"}, {"left"}, {"up"}):
        game.step(keys)
    moved = game.world.state.robot_position[0, 0] - before
    np.testing.assert_allclose(moved, [-0.5, 0.25], atol=1e-5)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ([], "error: there is no screen for a window"),
        (["human=3"], "'human' (3); did you mean humans"),
        (["robots=99"], "error: scenario.robots is 99; it must be a whole number in [1, 16]"),
        (["humans"], "error: 'humans' is not a setting; write field=value"),
        (["--case", "-1"], "error: --case is -1; it must lie in"),
    ],
)
def test_errors_are_one_line(
    arguments: list[str],
    message: str,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setattr("matplotlib.pyplot.get_backend", lambda: "agg")
    with pytest.raises(SystemExit) as stopped:
        main(arguments)
    error = capsys.readouterr().err
    assert (stopped.value.code, error.count("\n")) == (2, 1)
    assert message in error
