"""Everything that drives robots, behind one interface."""

from samarl.agents.agent import Agent, Explanation
from samarl.agents.build import build_agent

__all__ = ["Agent", "Explanation", "build_agent"]
