"""Everything that drives robots, behind one interface."""

from samarl.agents.agent import Agent, build_agent

__all__ = ["Agent", "build_agent"]
