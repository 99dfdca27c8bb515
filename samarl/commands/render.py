"""`samarl-render`: draw one case as a figure or an animation."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from hydra.core.hydra_config import HydraConfig
from omegaconf import MISSING, DictConfig

from mrsan import ConfigurationError, Split
from mrsan.cases import CASES_PER_SPLIT
from mrsan.fields import check_numbers, number
from samarl.agents import build_agent
from samarl.commands.agents import check_agent, compile_for, print_scope_warning, selected_agent
from samarl.commands.cli import run_command
from samarl.configuration import engine_in, load_agent_config, open_mapping, scenario_in
from samarl.evaluation.trajectory import Trajectory, record_episode
from samarl.files import check_writable
from samarl.physics.engine import MujocoEngine
from samarl.physics.offscreen import prepare_renderer
from samarl.progress import progress_bar


@dataclass
class Render:
    """Schema of `conf/render.yaml`."""

    case: int = number(MISSING, 0, len(Split) * CASES_PER_SPLIT - 1, help="case number")
    split: Split = Split.test
    output: str = MISSING
    scenario: Any = MISSING
    agent: Any = open_mapping()
    engine: Any = MISSING
    against: str | None = None
    checkpoint: str | None = None
    plugins: list[str] = field(default_factory=list)


def main() -> None:
    """Entry point."""
    run_command(render, "render", check_agent, render_schema=Render)


def render(config: DictConfig) -> None:
    """Run one case and draw it."""
    scenario = scenario_in(config)
    check_numbers(Render(case=config.case, split=config.split), "")
    case = config.split.number(config.case)
    path = Path(config.output)
    engine = engine_in(config)
    save = picture_writer(path)
    check_writable(path, "output")
    if isinstance(engine, MujocoEngine):
        _render_physics(config, engine, case, path)
        print(f"written to {path}")
        return
    agents: list[tuple[str, Any]] = [
        (HydraConfig.get().runtime.choices.agent, selected_agent(config))
    ]
    if config.against is not None:
        agents.append((config.against, load_agent_config(config.against, "against")))
    trajectories = []
    compile_for(agents[0][1], scenario)
    for name, agent_config in agents:
        agent = build_agent(agent_config, scenario)
        print_scope_warning(agent)
        trajectory = record_episode(agent, scenario, case)
        trajectories.append((trajectory, title_of(name, trajectory)))
    save(trajectories, path)
    print(f"written to {path}")


def title_of(name: str, trajectory: Trajectory) -> str:
    """Return the title of a picture of an agent's episode."""
    scenario, (split, index) = trajectory.scenario, Split.of(trajectory.case)
    return (
        f"{name}, {split.name} case {index}: {scenario.fov_degrees:g}° view, "
        f"{scenario.humans} humans, {scenario.robots} robots"
    )


def _render_physics(config: DictConfig, engine: MujocoEngine, case: int, path: Path) -> None:
    """Run one case in MuJoCo and write its film.

    Raises:
        ConfigurationError: the output is no film, there are two agents, or the engine cannot play
            the scenario.
    """
    if path.suffix.lower() not in (".gif", ".mp4"):
        raise ConfigurationError(
            f"output is {str(path)!r}; it must end in .gif or .mp4 with engine=mujoco"
        )
    if config.against is not None:
        raise ConfigurationError(
            f"against is {config.against!r}; it must be null with engine=mujoco"
        )
    scenario, name = scenario_in(config), str(HydraConfig.get().runtime.choices.agent)
    engine.check(scenario)
    prepare_renderer()  # before MuJoCo is imported
    from samarl.physics.controllers import controller_of
    from samarl.physics.rendering import rendered_frames
    from samarl.physics.world import PhysicsWorld
    from samarl.report.animation import write_frames

    world = PhysicsWorld(scenario, engine)
    agent = build_agent(selected_agent(config), scenario)
    frames = rendered_frames(world, controller_of(agent, name), case)
    shown = progress_bar(frames, desc=path.name, unit="frame")
    write_frames(path, iter(shown), scenario.time_step)


def picture_writer(path: Path) -> Callable[[Sequence[tuple[Trajectory, str]], Path], None]:
    """Return the function that draws a file with this extension.

    Raises:
        ConfigurationError: the extension is not supported, or there is no encoder for videos.
    """
    extension = path.suffix.lower()
    if extension in (".png", ".svg", ".pdf"):
        from samarl.report.trajectories import save_trajectories

        return save_trajectories
    if extension in (".gif", ".mp4"):
        from samarl.report.animation import save_animation, video_encoder

        if extension == ".mp4":
            video_encoder()  # fails before the case is run
        return save_animation
    raise ConfigurationError(
        f"output is {str(path)!r}; it must end in .png, .svg, .pdf, .gif or .mp4"
    )


if __name__ == "__main__":
    main()
