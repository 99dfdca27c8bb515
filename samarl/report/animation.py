"""One episode as a moving picture, smooth between its steps."""

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
from numpy.typing import NDArray
from PIL import Image, ImageColor
from tqdm import tqdm

from mrsan import ConfigurationError, Outcome
from samarl.evaluation.recording import Recording
from samarl.files import unfinished
from samarl.report.style import COLOURS, CONTACT, INK, MUTED, STYLE

_GIF_COLOURS = 64
_DPI = {".gif": 80, ".mp4": 140}
_FRAMES_PER_SECOND = {".gif": 10.0, ".mp4": 20.0}  # at least, and less than twice that
_HOLD_SECONDS = 1.5  # the last frame stays


def save_animation(recordings: Sequence[tuple[Recording, str]], path: Path) -> None:
    """Write a .gif or an .mp4 that plays as fast as the episodes, atomically.

    Args:
        recordings: each with its title; side by side.
        path: where to.

    Raises:
        ConfigurationError: there is no encoder for .mp4.
    """
    kind = path.suffix.lower()
    write = {".gif": _write_gif, ".mp4": _write_mp4}[kind]
    figure = Figure(figsize=(6.0 * len(recordings), 6.4), dpi=_DPI[kind],
                    layout="constrained")  # fmt: skip
    steps = max(len(recording.robot_position) for recording, _ in recordings) - 1
    time_step = recordings[0][0].scenario.time_step
    times, seconds = frame_times(steps, time_step, _FRAMES_PER_SECOND[kind])
    pictures = tqdm(_frames(figure, recordings, times), total=len(times), desc=path.name,
                    unit="frame", disable=None)  # fmt: skip
    with unfinished(path) as part:
        write(part, iter(pictures), seconds)


def frame_times(steps: int, time_step: float, rate: float) -> tuple[NDArray[np.float64], float]:
    """Choose the moments of an episode that become frames.

    Long steps are divided into several frames; of short ones only every so many becomes a frame,
    so that the rate stays below twice the `rate` however short they are.

    Args:
        steps: of the episode.
        time_step: s.
        rate: frames per second that suffice.

    Returns:
        The times in steps, from the first state to the last, and the seconds between two of them.
    """
    stride = int(1.0 / (rate * time_step) + 1e-9)  # steps from frame to frame
    if stride > 1:
        return np.append(np.arange(0.0, steps, stride), float(steps)), stride * time_step
    per_step = math.ceil(rate * time_step)
    return np.arange(steps * per_step + 1) / per_step, time_step / per_step


def video_encoder() -> Any:
    """The module that encodes videos.

    Raises:
        ConfigurationError: it is not installed.
    """
    try:
        return importlib.import_module("imageio_ffmpeg")
    except ImportError as error:
        raise ConfigurationError(
            "output ends in .mp4, which needs imageio-ffmpeg: pip install 'samarl[video]' "
            "(.gif needs nothing more)"
        ) from error


def _write_gif(path: Path, pictures: Iterator[NDArray[np.uint8]], seconds: float) -> None:
    # One palette for all frames, without dithering: then what stands still costs nothing.
    images: list[Image.Image] = []
    palette: Image.Image | None = None
    for picture in pictures:
        image = Image.fromarray(picture)
        if palette is None:
            sample = image.copy()
            for i, colour in enumerate((*COLOURS, CONTACT, *_tints(CONTACT))):  # seen later
                side = image.height // 12
                sample.paste(colour, (0, i * side, side, (i + 1) * side))
            palette = sample.quantize(_GIF_COLOURS, dither=Image.Dither.NONE)
        images.append(image.quantize(palette=palette, dither=Image.Dither.NONE))
    # A GIF counts in hundredths of a second; rounded so that the whole takes as long as it should.
    shown_until = np.rint(100 * seconds * np.arange(1, len(images) + 1))
    duration = [10 * int(d) for d in np.diff(shown_until, prepend=0)]
    duration[-1] += round(1000 * _HOLD_SECONDS)
    images[0].save(path, "GIF", save_all=True, append_images=images[1:], duration=duration, loop=0)


def _tints(colour: str) -> Iterator[str]:
    """What a colour looks like where it is faint, over white."""
    for share in (0.1, 0.2):
        mixed = (255 - share * (255 - value) for value in ImageColor.getrgb(colour))
        yield "#" + "".join(f"{round(value):02x}" for value in mixed)


def _write_mp4(path: Path, pictures: Iterator[NDArray[np.uint8]], seconds: float) -> None:
    first = next(pictures)
    height, width = first.shape[:2]
    writer = video_encoder().write_frames(
        str(path), (width, height), fps=1 / seconds, codec="libx264",
        macro_block_size=2, output_params=["-f", "mp4", "-movflags", "+faststart"],
    )  # fmt: skip
    writer.send(None)
    try:
        writer.send(first.tobytes())
        for picture in pictures:
            writer.send(picture.tobytes())
    finally:
        writer.close()


def _frames(
    figure: Figure, recordings: Sequence[tuple[Recording, str]], times: NDArray[np.float64]
) -> Iterator[NDArray[np.uint8]]:
    """The pictures [height, width, 3] at `times` in steps; the last of an episode stays."""
    canvas = FigureCanvasAgg(figure)
    with rc_context(STYLE):
        stages = figure.subplots(1, len(recordings), squeeze=False)[0]
        for axes, (recording, title) in zip(stages, recordings, strict=True):
            _draw_stage(axes, recording, title)
        for time in times:
            drawn: list[Artist] = []
            for axes, (recording, _) in zip(stages, recordings, strict=True):
                drawn += _draw_state(axes, recording, min(time, len(recording.robot_position) - 1))
            canvas.draw()
            if time == 0:
                figure.set_layout_engine("none")  # it has settled
            yield np.asarray(canvas.buffer_rgba())[..., :3].copy()
            for artist in drawn:
                artist.remove()


def _draw_stage(axes: Axes, recording: Recording, title: str) -> None:
    """What does not move: the frame, and the goals."""
    axes.set_title(title, fontsize=9.5)
    axes.set_aspect("equal")
    marks = "; diamonds: waypoints" if recording.waypoint is not None else ""
    axes.set_xlabel(
        f"x (m)\nfilled: people in view of a driving robot{marks}\n"
        "rings: personal space, red when entered",
        fontsize=8,
    )
    axes.set_ylabel("y (m)")
    axes.grid(True, axis="both")
    everything = np.concatenate(
        [
            recording.robot_position.reshape(-1, 2),
            recording.human_position[recording.human_present],
            recording.robot_goal,
        ]
    )
    middle = (everything.min(0) + everything.max(0)) / 2
    half = (everything.max(0) - everything.min(0)).max() / 2 + 0.6
    axes.set_xlim(middle[0] - half, middle[0] + half)
    axes.set_ylim(middle[1] - half, middle[1] + half)
    for i, goal in enumerate(recording.robot_goal):
        axes.plot(*goal, marker="*", markersize=14, color=_colour(i), markeredgecolor="white")


def _draw_state(axes: Axes, recording: Recording, time: float) -> list[Artist]:
    """Everything that moves, at a time in steps; between two steps it moves evenly."""
    scenario, t = recording.scenario, int(time)
    seen = (recording.humans_seen[t] & recording.driving[t][:, None]).any(0)
    robots, humans = (_between(p, time) for p in (recording.robot_position,
                                                  recording.human_position))  # fmt: skip
    headings = _between(np.unwrap(recording.robot_heading, axis=0), time)
    drawn: list[Artist] = []

    def disc(centre: NDArray, radius: float, **look: Any) -> None:
        drawn.append(axes.add_patch(Circle((centre[0], centre[1]), radius, **look)))

    zone = scenario.reward.discomfort_distance
    for j in np.flatnonzero(recording.human_present[t]):
        radius = float(recording.human_radius[j])
        apart = np.linalg.norm(robots - humans[j], axis=-1) - radius - scenario.robot_radius
        near = bool((apart[recording.driving[t]] < zone).any())
        disc(humans[j], radius + zone, color=CONTACT if near else MUTED,
             alpha=0.2 if near else 0.1, linewidth=0)  # fmt: skip
        disc(humans[j], radius, facecolor=MUTED if seen[j] else "white", edgecolor=MUTED, zorder=2)
    for i, (robot, heading) in enumerate(zip(robots, headings, strict=True)):
        colour, radius = _colour(i), scenario.robot_radius
        way = np.concatenate([recording.robot_position[: t + 1, i], robot[None]])
        drawn += axes.plot(*way.T, color=colour, linewidth=1.4)
        if recording.driving[t, i]:
            half, towards = scenario.fov_degrees / 2, np.degrees(heading)
            if half < 180:
                wedge = Wedge((robot[0], robot[1]), scenario.sensing_range, towards - half,
                              towards + half, color=colour, alpha=0.07, linewidth=0)  # fmt: skip
                drawn.append(axes.add_patch(wedge))
            if recording.waypoint is not None:
                waypoint = recording.waypoint[min(t, len(recording.waypoint) - 1), i]
                drawn += axes.plot(*np.stack([robot, waypoint]).T, ":", color=colour, linewidth=1)
                drawn += axes.plot(*waypoint, "D", color=colour, markersize=5)
        disc(robot, radius, facecolor=colour, edgecolor="white", zorder=4)
        number = axes.text(robot[0], robot[1], str(i), color="white", fontsize=7, zorder=6,
                           ha="center", va="center", clip_on=True)  # fmt: skip
        drawn.append(number)
        nose = np.array([np.cos(heading), np.sin(heading)])
        ends = np.stack([robot + radius * nose, robot + 1.6 * radius * nose])
        drawn += axes.plot(*ends.T, color=INK, linewidth=1.6, zorder=5)
        collided = recording.episodes.outcome[0, i] in (Outcome.hit_human, Outcome.hit_robot)
        if collided and time >= len(recording.robot_position) - 1:
            drawn += axes.plot(*robot, "x", color=CONTACT, markersize=16, markeredgewidth=2.5,
                               zorder=7)  # fmt: skip
    clock = f"{time * scenario.time_step:.1f} s"
    drawn.append(axes.text(0.02, 0.98, clock, transform=axes.transAxes, va="top", fontsize=11))
    return drawn


def _between(series: NDArray, time: float) -> NDArray:
    """A state of [T + 1, ...] at a time in steps."""
    t = int(time)
    following = series[min(t + 1, len(series) - 1)]
    return series[t] + (time - t) * (following - series[t])


def _colour(i: int) -> str:
    return COLOURS[i % len(COLOURS)]
