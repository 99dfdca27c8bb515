"""`python -m mrsan.play`: drive one robot of a scenario with the keyboard."""

from __future__ import annotations

import argparse
import math
import sys
from collections.abc import Collection, Sequence
from typing import Any

import numpy as np
import yaml
from numpy.typing import NDArray

from mrsan.cases import CASES_PER_SPLIT
from mrsan.choices import Kinematics
from mrsan.features import GOAL
from mrsan.fields import ConfigurationError
from mrsan.metrics import Outcome, episodes_of, social_score
from mrsan.rendering import Renderer
from mrsan.scenario import Scenario
from mrsan.se2 import unrotate
from mrsan.tasks import overridden
from mrsan.world import World

KEYS = "arrow keys or WASD: drive, r: again, n: next case, q: quit"
_DIRECTIONS = {"w": "up", "s": "down", "a": "left", "d": "right"}
_ACCELERATION, _BRAKING = 1.0, 2.0  # of the keys, m/s^2
_DRIVING_ANGLE = math.pi / 3  # to the goal, beyond which robots that drive themselves stop, rad


def keyboard_action(
    keys: Collection[str], speed: float, heading: float, scenario: Scenario
) -> list[float]:
    """Return the action [A] of pressed keys.

    Up and down change the speed, left and right turn. Holonomic robots drive in the direction on
    the screen instead.

    Args:
        keys: of up, down, left and right.
        speed: of the robot, m/s.
        heading: of the robot, rad.
        scenario: the kinematics and their limits.
    """
    ahead = ("up" in keys) - ("down" in keys)
    left = ("left" in keys) - ("right" in keys)
    if scenario.kinematics is Kinematics.holonomic:
        norm = max(math.hypot(ahead, left), 1.0)
        x, y = unrotate(math.cos(heading), math.sin(heading), -left / norm, ahead / norm)
        return [_clipped(x), _clipped(y)]
    acceleration = _ACCELERATION if ahead > 0 else ahead * _BRAKING
    if scenario.kinematics is Kinematics.unicycle:
        new_speed = speed + acceleration * scenario.time_step
        return [_clipped(2.0 * new_speed / scenario.robot_speed - 1.0), left]
    return [_clipped(acceleration / scenario.max_acceleration), 0.0, left]


def straight_action(x: float, y: float, scenario: Scenario) -> list[float]:
    """Return the action [A] of a robot that drives to a point in its body frame, m."""
    if scenario.kinematics is Kinematics.holonomic:
        norm = max(math.hypot(x, y), 1e-6)
        return [_clipped(x / norm), _clipped(y / norm)]
    bearing = math.atan2(y, x)
    ahead, turn = 1.0 if abs(bearing) < _DRIVING_ANGLE else -1.0, bearing / scenario.max_turn
    middle = [] if scenario.kinematics is Kinematics.unicycle else [0.0]
    return [ahead, *middle, _clipped(turn)]


def still_action(scenario: Scenario) -> list[float]:
    """Return the action [A] of a robot that stands."""
    if scenario.kinematics is Kinematics.holonomic:
        return [0.0, 0.0]
    return [-1.0] + [0.0] * (scenario.action_size - 1)


def _clipped(value: float) -> float:
    return min(max(float(value), -1.0), 1.0)


class Game:
    """An episode in which robot 0 is driven by keys."""

    def __init__(self, scenario: Scenario, case: int, others: str) -> None:
        """Begin a case.

        Args:
            scenario: the task.
            case: its number.
            others: what the other robots do: `still`, or `straight` to their goals.
        """
        self.world, self.others = World(scenario), others
        self.begin(case)

    def begin(self, case: int) -> None:
        """Begin a case from its start."""
        self.case, self.total_reward = case, 0.0
        self._observation = self.world.reset([case])

    @property
    def is_over(self) -> bool:
        """Return whether robot 0 has arrived or the episode has ended."""
        return bool(self.world.state.done[0] or self.world.state.arrived[0, 0])

    @property
    def speed(self) -> float:
        """Return the speed of robot 0, m/s."""
        return float(np.hypot(*self.world.state.robot_velocity[0, 0]))

    def step(self, keys: Collection[str]) -> None:
        """Advance by one time step unless the game is over."""
        if self.is_over:
            return
        step = self.world.step(self._actions(keys)[None])
        self._observation = step.observation
        self.total_reward += float(step.reward[0, 0])

    def _actions(self, keys: Collection[str]) -> NDArray[np.float32]:
        """Return the actions of all robots, [N, A]."""
        scenario = self.world.scenario
        heading = float(self.world.state.robot_heading[0, 0])
        actions = [keyboard_action(keys, self.speed, heading, scenario)]
        targets = self._observation.sensors.get("route", self._observation.ego[..., GOAL])
        for x, y in targets[0, 1:].tolist():
            straight = self.others == "straight"
            actions.append(straight_action(x, y, scenario) if straight else still_action(scenario))
        return np.array(actions, np.float32)

    def status(self) -> str:
        """Return one line with the speed and the score, or with how the episode ended."""
        state = self.world.state
        score = f"reward {self.total_reward:+.2f}"
        if not self.is_over:
            distance = math.dist(state.robot_position[0, 0], state.robot_goal[0, 0])
            return f"case {self.case}: {self.speed:.2f} m/s, goal in {distance:.1f} m, {score}"
        episodes = episodes_of(state, self.world.scenario, np.ones(1, np.bool_))
        outcome = Outcome(episodes.outcome[0, 0]).name.replace("_", " ")
        return (
            f"case {self.case}: {outcome} after {episodes.time[0, 0]:.2f} s, {score}, "
            f"social score {social_score(episodes)[0, 0]:.0f}"
        )


class Window:
    """A Matplotlib figure that shows a game and passes keys to it."""

    def __init__(self, game: Game, figure: Any) -> None:
        """Draw the first picture and listen to keys.

        Args:
            game: the game.
            figure: an empty `matplotlib.figure.Figure` that belongs to a canvas.
        """
        self._game, self._figure = game, figure
        self._pressed: set[str] = set()
        self._renderer = Renderer(None, game.world.scenario)
        axes = figure.add_axes((0.0, 0.06, 1.0, 0.94))
        axes.set_axis_off()
        self._image = axes.imshow(self._renderer.picture(game.world))
        self.text = figure.text(0.02, 0.035, game.status())
        figure.text(0.02, 0.01, KEYS, fontsize=8, color="#555555")
        canvas = figure.canvas
        if canvas.manager is not None:  # Matplotlib's own keys would save and scroll
            canvas.mpl_disconnect(canvas.manager.key_press_handler_id)
        canvas.mpl_connect("key_press_event", self._press)
        canvas.mpl_connect("key_release_event", self._release)
        self._timer = canvas.new_timer(interval=round(1000 * game.world.scenario.time_step))
        self._timer.add_callback(self.tick)
        self._timer.start()

    def tick(self) -> None:
        """Advance the game by one time step and draw it."""
        self._game.step(self._pressed)
        self._draw()

    def _draw(self) -> None:
        self._image.set_data(self._renderer.picture(self._game.world))
        self.text.set_text(self._game.status())
        self._figure.canvas.draw_idle()

    def _press(self, event: Any) -> None:
        if event.key == "q":
            self._timer.stop()
            self._figure.canvas.stop_event_loop()
            if self._figure.canvas.manager is not None:
                self._figure.canvas.manager.destroy()
        elif event.key in ("r", "n"):
            self._game.begin(self._game.case + (event.key == "n"))
            self._draw()
        else:
            self._pressed.add(_DIRECTIONS.get(event.key, event.key))

    def _release(self, event: Any) -> None:
        self._pressed.discard(_DIRECTIONS.get(event.key, event.key))


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="python -m mrsan.play",
        description=f"Drive the blue robot of a scenario with the keyboard. {KEYS[:1].upper()}"
        f"{KEYS[1:]}. Holonomic robots drive in the direction of the key, others accelerate, brake "
        "and turn.",
        epilog="Example: python -m mrsan.play humans=5 layout=doorway robots=2 --others straight",
    )
    parser.add_argument(
        "settings",
        nargs="*",
        metavar="field=value",
        help="fields of mrsan.Scenario (default: SAMARL's scenario with robots=1)",
    )
    parser.add_argument("--case", type=int, default=0, help="number of the first case (default: 0)")
    parser.add_argument(
        "--others",
        choices=("still", "straight"),
        default="straight",
        help="what the other robots do: stand, or drive to their goals (default: straight)",
    )
    return parser


def _scenario(settings: Sequence[str]) -> Scenario:
    """Return the scenario of settings `field=value`.

    Raises:
        ConfigurationError: a setting is not of this form, or is not valid.
    """
    values: dict[str, Any] = {"robots": 1}
    for setting in settings:
        name, equals, value = setting.partition("=")
        if not equals:
            raise ConfigurationError(f"{setting!r} is not a setting; write field=value")
        values[name] = yaml.safe_load(value)
    return overridden(None, values)


def _open_figure() -> tuple[Any, Any]:
    """Return `matplotlib.pyplot` and a figure in a window.

    Raises:
        ConfigurationError: no window can be opened.
    """
    import matplotlib.pyplot as plt  # here because importing it takes a second

    try:
        figure = plt.figure("mrsan", figsize=(6, 6.4))
    except ImportError as error:
        reason = str(error)
    else:
        if plt.get_backend().lower() != "agg":
            return plt, figure
        reason = "Matplotlib found no display, or no toolkit such as tkinter or PyQt6"
    raise ConfigurationError(f"there is no screen for a window ({reason})")


def main(arguments: Sequence[str] | None = None) -> None:
    """Entry point."""
    options = _parser().parse_args(arguments)
    try:
        scenario = _scenario(options.settings)
        if not 0 <= options.case < CASES_PER_SPLIT:
            raise ConfigurationError(f"--case is {options.case}; it must lie in [0, 2^40)")
        pyplot, figure = _open_figure()
        Window(Game(scenario, options.case, options.others), figure)
    except (ConfigurationError, yaml.YAMLError) as error:
        print(f"error: {' '.join(str(error).split())}", file=sys.stderr)
        sys.exit(2)
    pyplot.show()


if __name__ == "__main__":
    main()
