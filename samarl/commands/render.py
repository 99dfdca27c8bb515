"""`samarl-render`: draw one case as a figure or an animation."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from omegaconf import MISSING, DictConfig

from mrsan import Split
from mrsan.cases import CASES_PER_SPLIT
from mrsan.fields import check_numbers, number
from samarl import api
from samarl.commands.agents import agent_in, check_agent, with_notes
from samarl.commands.cli import run_command
from samarl.configuration import engine_in, open_mapping
from samarl.evaluation.methods import split_method


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
    check_numbers(Render(case=config.case, split=config.split), "")
    agent, against = agent_in(config), config.against
    if against is not None:
        name, settings = split_method(against)
        against = with_notes(api.load_agent(name, agent.scenario, **settings))
        if settings:
            against.label = config.against
    path = api.render(
        agent,
        case=config.case,
        output=config.output,
        against=against,
        split=config.split,
        engine=engine_in(config),
    )
    print(f"written to {path}")


if __name__ == "__main__":
    main()
