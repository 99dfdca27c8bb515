"""Agents: planners and trained policies behind one interface."""

from samarl.agents.agent import Agent, ScopeWarning
from samarl.agents.build import build_agent
from samarl.policies.explanation import Explanation

__all__ = ["Agent", "Explanation", "ScopeWarning", "build_agent"]
