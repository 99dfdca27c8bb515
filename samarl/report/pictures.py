"""Pictures and films of episodes, by the extension of their file."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

from mrsan import ConfigurationError, Split
from samarl.agents import Agent
from samarl.evaluation.trajectory import Trajectory
from samarl.physics.engine import MujocoEngine
from samarl.physics.offscreen import prepare_renderer
from samarl.progress import progress_bar

FILMS = (".gif", ".mp4")


def picture_writer(path: Path) -> Callable[[Sequence[tuple[Trajectory, str]], Path], None]:
    """Return the function that draws a file with this extension.

    Raises:
        ConfigurationError: the extension is not supported, or there is no encoder for videos.
    """
    extension = path.suffix.lower()
    if extension in (".png", ".svg", ".pdf"):
        from samarl.report.trajectories import save_trajectories  # imports matplotlib

        return save_trajectories
    if extension in FILMS:
        from samarl.report.animation import save_animation, video_encoder

        if extension == ".mp4":
            video_encoder()  # fails before the case is run
        return save_animation
    raise ConfigurationError(
        f"output is {str(path)!r}; it must end in .png, .svg, .pdf, .gif or .mp4"
    )


def title_of(name: str, trajectory: Trajectory) -> str:
    """Return the title of a picture of an agent's episode."""
    scenario, (split, index) = trajectory.scenario, Split.of(trajectory.case)
    return (
        f"{name}, {split.name} case {index}: {scenario.fov_degrees:g}° view, "
        f"{scenario.humans} humans, {scenario.robots} robots"
    )


def film_physics(agent: Agent, engine: MujocoEngine, case: int, name: str, path: Path) -> None:
    """Run one case in MuJoCo and write its film.

    Raises:
        ConfigurationError: the file is no film, or the engine cannot play the scenario.
    """
    if path.suffix.lower() not in FILMS:
        raise ConfigurationError(
            f"output is {str(path)!r}; it must end in .gif or .mp4 with engine=mujoco"
        )
    scenario = agent.scenario
    engine.check(scenario)
    prepare_renderer()  # before MuJoCo is imported
    from samarl.physics.controllers import controller_of
    from samarl.physics.rendering import rendered_frames
    from samarl.physics.world import PhysicsWorld
    from samarl.report.animation import write_frames

    world = PhysicsWorld(scenario, engine)
    frames = rendered_frames(world, controller_of(agent, name), case)
    shown = progress_bar(frames, desc=path.name, unit="frame")
    write_frames(path, iter(shown), scenario.time_step)
