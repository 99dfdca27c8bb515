"""Who sends the robots of a stage of a curriculum to goals and queue places."""

from __future__ import annotations

from mrsan import ConfigurationError, Scenario
from samarl.agents import build_agent
from samarl.agents.planners.right_of_way import RightOfWay
from samarl.configuration import load_method_config


def build_guide(name: str | None, scenario: Scenario) -> RightOfWay | None:
    """Return the agent of `CurriculumStage.guide`; None without a name.

    Raises:
        ConfigurationError: there is no such agent, or it does not direct drivers.
    """
    if name is None:
        return None
    field = "curriculum.stages.guide"
    guide = build_agent(load_method_config(name, field), scenario)
    if not isinstance(guide, RightOfWay):
        raise ConfigurationError(f"{field} is {name!r}; it must be right_of_way")
    return guide
