"""Everything that drives robots, behind one interface."""

from samarl.agents.agent import Agent, Explanation, build_agent

__all__ = ["Agent", "Explanation", "build_agent"]
