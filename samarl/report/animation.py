"""Animation of one episode, interpolated between its steps."""

from __future__ import annotations

import importlib
import math
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import rc_context
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Wedge
from matplotlib.patheffects import withStroke
from numpy.typing import NDArray
from PIL import Image, ImageColor

from mrsan import ConfigurationError, Outcome
from samarl.evaluation.trajectory import Trajectory
from samarl.files import atomic_write
from samarl.policies.explanation import ACTIVITIES
from samarl.progress import progress_bar
from samarl.report.style import COLOURS, CONTACT, INK, MUTED, STYLE
from samarl.report.trajectories import HITS, draw_passages, draw_walls, height_share, view_limits

_GIF_COLOURS = 64
_DPI = {".gif": 80, ".mp4": 140}
_FRAMES_PER_SECOND = {".gif": 10.0, ".mp4": 20.0}  # lower bound; the rate is below twice that
_HOLD_SECONDS = 3.0  # for which the last frame, which tells the outcome, is shown
_MAX_SECONDS = 20.0  # of the whole animation; longer episodes are sped up
_AT_GOAL = 1e-3  # m, within which a waypoint is the goal
_CAUSES = {  # of a failed episode; robots that were interrupted did not cause it
    Outcome.hit_human: "hit a person",
    Outcome.hit_robot: "hit a robot",
    Outcome.hit_wall: "hit a wall",
    Outcome.timeout: "ran out of time",
}


def save_animation(trajectories: Sequence[tuple[Trajectory, str]], path: Path) -> None:
    """Write a .gif or .mp4, atomically: in real time, but at most 20 s long.

    Trajectories with their titles are drawn side by side.

    Raises:
        ConfigurationError: the encoder for .mp4 is not installed.
    """
    kind = path.suffix.lower()
    size = 6.0 * len(trajectories), 1.1 + 5.3 * height_share(trajectories)
    figure = Figure(figsize=size, dpi=_DPI[kind], layout="constrained")
    steps = max(len(trajectory.robot_position) for trajectory, _ in trajectories) - 1
    time_step = trajectories[0][0].scenario.time_step
    speed = playback_speed(steps * time_step)
    times, seconds = frame_times(steps, time_step / speed, _FRAMES_PER_SECOND[kind])
    images = progress_bar(
        _frames(figure, trajectories, times, speed), total=len(times), desc=path.name, unit="frame"
    )
    write_frames(path, iter(images), seconds)


def write_frames(path: Path, frames: Iterator[NDArray[np.uint8]], seconds: float) -> None:
    """Write a .gif or .mp4, atomically.

    Pictures are [H, W, 3], `seconds` apart.

    Raises:
        ConfigurationError: the encoder for .mp4 is not installed.
    """
    write = {".gif": _write_gif, ".mp4": _write_mp4}[path.suffix.lower()]
    with atomic_write(path) as part:
        write(part, frames, seconds)


def playback_speed(duration: float) -> float:
    """Return how many times faster than real time an episode of `duration` s is shown."""
    return max(1.0, math.ceil(10 * duration / (_MAX_SECONDS - _HOLD_SECONDS - 0.5)) / 10)


def frame_times(steps: int, time_step: float, rate: float) -> tuple[NDArray[np.float64], float]:
    """Return the times of an episode at which frames are drawn.

    Long steps are divided into several frames; short steps are skipped, so that the frame rate lies
    between `rate` and twice `rate`.

    Args:
        steps: number of steps of the episode.
        time_step: length of a step, s.
        rate: lower bound of the frame rate, 1/s.

    Returns:
        The times in steps, from the first state to the last, and the time between frames in s.
    """
    stride = int(1.0 / (rate * time_step) + 1e-9)  # steps from frame to frame
    if stride > 1:
        return np.append(np.arange(0.0, steps, stride), float(steps)), stride * time_step
    per_step = math.ceil(rate * time_step)
    return np.arange(steps * per_step + 1) / per_step, time_step / per_step


def video_encoder() -> Any:
    """Return the module that encodes videos.

    Raises:
        ConfigurationError: it is not installed.
    """
    try:
        return importlib.import_module("imageio_ffmpeg")
    except ImportError as error:
        raise ConfigurationError(
            "output ends in .mp4, which needs imageio-ffmpeg: pip install 'samarl[video]' "
            "(.gif needs no extra package)"
        ) from error


def _write_gif(path: Path, frames: Iterator[NDArray[np.uint8]], seconds: float) -> None:
    # One palette for all frames and no dithering, so that static parts compress well.
    images: list[Image.Image] = []
    palette: Image.Image | None = None
    for pixels in frames:
        image = Image.fromarray(pixels)
        if palette is None:
            sample = image.copy()
            for i, colour in enumerate((*COLOURS, CONTACT, *_tints(CONTACT))):  # of later frames
                side = image.height // 12
                sample.paste(colour, (0, i * side, side, (i + 1) * side))
            palette = sample.quantize(_GIF_COLOURS, dither=Image.Dither.NONE)
        images.append(image.quantize(palette=palette, dither=Image.Dither.NONE))
    # GIF durations are multiples of 0.01 s; rounding the end times keeps the total exact.
    end_times = np.rint(100 * seconds * np.arange(1, len(images) + 1))
    duration = [10 * int(d) for d in np.diff(end_times, prepend=0)]
    duration[-1] += round(1000 * _HOLD_SECONDS)
    images[0].save(path, "GIF", save_all=True, append_images=images[1:], duration=duration, loop=0)


def _tints(colour: str) -> Iterator[str]:
    """Yield the colour blended over white, as for the discs of personal space."""
    for share in (0.1, 0.2):
        mixed = (255 - share * (255 - value) for value in ImageColor.getrgb(colour))
        yield "#" + "".join(f"{round(value):02x}" for value in mixed)


def _write_mp4(path: Path, frames: Iterator[NDArray[np.uint8]], seconds: float) -> None:
    first = next(frames)
    height, width = first.shape[:2]
    writer = video_encoder().write_frames(
        str(path),
        (width, height),
        fps=1 / seconds,
        codec="libx264",
        macro_block_size=2,
        output_params=["-f", "mp4", "-movflags", "+faststart"],
    )
    writer.send(None)
    try:
        writer.send(first.tobytes())
        pixels = first
        for pixels in frames:
            writer.send(pixels.tobytes())
        for _ in range(round(_HOLD_SECONDS / seconds)):
            writer.send(pixels.tobytes())
    finally:
        writer.close()


def _frames(
    figure: Figure,
    trajectories: Sequence[tuple[Trajectory, str]],
    times: NDArray[np.float64],
    speed: float,
) -> Iterator[NDArray[np.uint8]]:
    """Yield the frames [height, width, 3] at `times` in steps; ended episodes show their last."""
    canvas = FigureCanvasAgg(figure)
    with rc_context(STYLE):
        stages = figure.subplots(1, len(trajectories), squeeze=False)[0]
        for axes, (trajectory, title) in zip(stages, trajectories, strict=True):
            _draw_stage(axes, trajectory, title)
        for time in times:
            artists: list[Artist] = []
            for axes, (trajectory, _) in zip(stages, trajectories, strict=True):
                artists += _draw_state(
                    axes, trajectory, min(time, len(trajectory.robot_position) - 1), speed
                )
            canvas.draw()
            if time == 0:
                figure.set_layout_engine("none")  # keep the layout of the first frame
            yield np.asarray(canvas.buffer_rgba())[..., :3].copy()
            for artist in artists:
                artist.remove()


def _draw_stage(axes: Axes, trajectory: Trajectory, title: str) -> None:
    """Draw the static parts: axes and goals."""
    axes.set_title(title, fontsize=9.5)
    axes.set_aspect("equal")
    marks = "; diamonds: waypoints" if trajectory.waypoint is not None else ""
    marks += "; dashed rings: queue places" if len(trajectory.passages.mouth) else ""
    axes.set_xlabel(
        f"x (m)\nfilled: people in view of a driving robot{marks}\n"
        "rings: personal space, red when entered",
        fontsize=8,
    )
    axes.set_ylabel("y (m)")
    axes.grid(True, axis="both")
    draw_passages(axes, trajectory)
    draw_walls(axes, trajectory)
    x_limits, y_limits = view_limits(trajectory)
    axes.set_xlim(x_limits)
    axes.set_ylim(y_limits)
    for i, goal in enumerate(trajectory.robot_goal):
        axes.plot(*goal, marker="*", markersize=14, color=_colour(i), markeredgecolor="white")


def _draw_state(
    axes: Axes, trajectory: Trajectory, time: float, speed: float = 1.0
) -> list[Artist]:
    """Draw everything that moves at a time in steps, interpolated linearly between steps."""
    robots = _between(trajectory.robot_position, time)
    artists = _draw_humans(axes, trajectory, time, robots)
    for i in range(len(robots)):
        artists += _draw_robot(axes, trajectory, time, i, robots[i])
    clock = f"{time * trajectory.scenario.time_step:.1f} s"
    if speed > 1.0:
        clock += f"  (speed {speed:g})"
    artists.append(axes.text(0.02, 0.98, clock, transform=axes.transAxes, va="top", fontsize=11))
    if time >= len(trajectory.robot_position) - 1:
        artists.append(_draw_ending(axes, trajectory))
    return artists


def _draw_ending(axes: Axes, trajectory: Trajectory) -> Artist:
    """Draw a box that tells how the episode ended, at the edge farther from the robots."""
    outcomes = trajectory.episodes.outcome[0]
    height, (low, high) = trajectory.robot_position[-1, :, 1], axes.get_ylim()
    top = high - height.max() > height.min() - low
    success = bool(trajectory.episodes.success[0])
    return axes.text(
        0.5,
        0.97 if top else 0.03,
        ending(outcomes),
        transform=axes.transAxes,
        ha="center",
        va="top" if top else "bottom",
        fontsize=12,
        fontweight="bold",
        color=INK if success else CONTACT,
        zorder=10,
        bbox={"facecolor": "white", "edgecolor": INK if success else CONTACT, "pad": 5},
    )


def ending(outcomes: Sequence[int] | NDArray[np.int8]) -> str:
    """Return how an episode ended, as text, from the outcome of each robot."""
    robots: dict[Outcome, list[str]] = {}
    for i, value in enumerate(outcomes):
        robots.setdefault(Outcome(value), []).append(str(i))
    if set(robots) == {Outcome.arrived}:
        return "Success: all robots arrived"
    causes = [
        f"robot{'s' if len(who) > 1 else ''} {_listed(who)} {_CAUSES[outcome]}"
        for outcome, who in robots.items()
        if outcome in _CAUSES
    ]
    return "\n".join(["Failure:", *causes]) if len(causes) > 1 else f"Failure: {causes[0]}"


def _listed(names: Sequence[str]) -> str:
    *others, last = names
    return f"{', '.join(others)} and {last}" if others else last


def _draw_humans(
    axes: Axes, trajectory: Trajectory, time: float, robots: NDArray[np.float32]
) -> list[Artist]:
    """Draw the people who are present and their personal space; `robots` are positions [N, 2]."""
    scenario, t = trajectory.scenario, int(time)
    driving = trajectory.driving[t]
    visible = (trajectory.humans_visible[t] & driving[:, None]).any(0)
    humans = _between(trajectory.human_position, time)
    zone = scenario.reward.discomfort_distance
    artists: list[Artist] = []
    for j in np.flatnonzero(trajectory.human_present[t]):
        radius = float(trajectory.human_radius[j])
        gap = np.linalg.norm(robots - humans[j], axis=-1) - radius - scenario.robot_radius
        intruded = bool((gap[driving] < zone).any())
        space = _disc(
            humans[j],
            radius + zone,
            color=CONTACT if intruded else MUTED,
            alpha=0.2 if intruded else 0.1,
            linewidth=0,
        )
        fill = MUTED if visible[j] else "white"
        body = _disc(humans[j], radius, facecolor=fill, edgecolor=MUTED, zorder=2)
        artists += [axes.add_patch(space), axes.add_patch(body)]
    return artists


def _draw_robot(
    axes: Axes, trajectory: Trajectory, time: float, i: int, position: NDArray[np.float32]
) -> list[Artist]:
    """Draw robot `i` with its path and, while it drives, its view and waypoint."""
    t, colour, radius = int(time), _colour(i), trajectory.scenario.robot_radius
    heading = _between(np.unwrap(trajectory.robot_heading, axis=0), time)[i]
    path = np.concatenate([trajectory.robot_position[: t + 1, i], position[None]])
    artists: list[Artist] = [*axes.plot(*path.T, color=colour, linewidth=1.4)]
    if trajectory.driving[t, i]:
        artists += _draw_view(axes, trajectory, position, heading, colour)
        artists += _draw_intent(axes, trajectory, t, i, position)
    artists.append(
        axes.add_patch(_disc(position, radius, facecolor=colour, edgecolor="white", zorder=4))
    )
    artists.append(
        axes.text(
            position[0],
            position[1],
            str(i),
            color="white",
            fontsize=7,
            zorder=6,
            ha="center",
            va="center",
            clip_on=True,
        )
    )
    nose = np.array([np.cos(heading), np.sin(heading)])
    ends = np.stack([position + radius * nose, position + 1.6 * radius * nose])
    artists += axes.plot(*ends.T, color=INK, linewidth=1.6, zorder=5)
    collided = trajectory.episodes.outcome[0, i] in HITS
    if collided and time >= len(trajectory.robot_position) - 1:
        artists += axes.plot(
            *position, "x", color=CONTACT, markersize=16, markeredgewidth=2.5, zorder=7
        )
    return artists


def _draw_intent(
    axes: Axes, trajectory: Trajectory, t: int, i: int, position: NDArray[np.float32]
) -> list[Artist]:
    """Draw the waypoint or queue place that robot `i` drives to, and write what it does."""
    artists: list[Artist] = []
    t, colour = min(t, len(trajectory.driving) - 2), _colour(i)
    if trajectory.waypoint is not None:
        waypoint = trajectory.waypoint[t, i]
        if np.linalg.norm(waypoint - trajectory.robot_goal[i]) > _AT_GOAL:
            line = np.stack([position, waypoint]).T
            artists += axes.plot(*line, ":", color=colour, linewidth=1)
            artists += axes.plot(*waypoint, "D", color=colour, markersize=5)
    if trajectory.activity is not None and trajectory.activity[t, i]:
        artists.append(
            axes.annotate(
                ACTIVITIES[trajectory.activity[t, i]],
                (position[0], position[1] + trajectory.scenario.robot_radius),
                (0, 3),
                textcoords="offset points",
                ha="center",
                fontsize=8,
                fontweight="bold",
                color=colour,
                path_effects=[withStroke(linewidth=2.5, foreground="white")],
                zorder=8,
            )
        )
    return artists


def _draw_view(
    axes: Axes, trajectory: Trajectory, position: NDArray[np.float32], heading: float, colour: str
) -> list[Artist]:
    """Draw a limited field of view as a sector."""
    half, direction = trajectory.scenario.fov_degrees / 2, np.degrees(heading)
    if half >= 180:
        return []
    sector = Wedge(
        (position[0], position[1]),
        trajectory.scenario.sensing_range,
        direction - half,
        direction + half,
        color=colour,
        alpha=0.07,
        linewidth=0,
    )
    return [axes.add_patch(sector)]


def _disc(centre: NDArray[np.float32], radius: float, **style: Any) -> Circle:
    return Circle((centre[0], centre[1]), radius, **style)


def _between(series: NDArray, time: float) -> NDArray:
    """Return a state series [T + 1, ...] at a time in steps."""
    t = int(time)
    following = series[min(t + 1, len(series) - 1)]
    return series[t] + (time - t) * (following - series[t])


def _colour(i: int) -> str:
    return COLOURS[i % len(COLOURS)]
