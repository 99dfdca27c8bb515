"""`samarl-render`: one case as a picture."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from hydra.core.hydra_config import HydraConfig
from omegaconf import MISSING, DictConfig, OmegaConf

from mrsan import ConfigurationError, Scenario, Split
from mrsan.scenario import check_numbers, number
from samarl.agents import build_agent
from samarl.cli import chosen_agent, run_command
from samarl.evaluation.recording import record_episode


@dataclass
class Render:
    """Schema of `conf/render.yaml`."""

    case: int = number(MISSING, 0, 10**9)
    split: Split = Split.test
    output: str = MISSING
    scenario: Any = MISSING
    agent: Any = MISSING
    checkpoint: str | None = None
    plugins: list[str] = field(default_factory=list)


def main() -> None:
    """Entry point."""
    run_command(render, "render", render_schema=Render)


def render(config: DictConfig) -> None:
    """Play one case and draw it."""
    from samarl.report.trajectories import save_trajectories

    scenario = OmegaConf.to_object(config.scenario)
    assert isinstance(scenario, Scenario)
    check_numbers(Render(case=config.case, split=config.split), "render")
    path = Path(config.output)
    if path.suffix not in (".png", ".svg", ".pdf"):
        raise ConfigurationError(f"output is {config.output!r}; it must end in .png, .svg or .pdf")
    agent = build_agent(chosen_agent(config), scenario)
    recording = record_episode(agent, scenario, config.split.case(config.case))
    name = HydraConfig.get().runtime.choices.agent
    title = (
        f"{name}, {config.split.name} case {config.case}: {scenario.fov_degrees:g}° view, "
        f"{scenario.humans} humans, {scenario.robots} robots"
    )
    save_trajectories(recording, path, title)
    print(f"written to {path}")


if __name__ == "__main__":
    main()
