"""The agent selected on the command line."""

from __future__ import annotations

import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from hydra.core.hydra_config import HydraConfig
from omegaconf import DictConfig

from mrsan import ConfigurationError, Scenario, World
from mrsan.compile_ahead import compile_ahead
from samarl.agents import Agent, build_agent
from samarl.configuration import load_agent_config, scenario_in
from samarl.evaluation.runner import warm_up

AGENT_OF_POLICY = {  # the shipped agent that uses each kind of policy
    "flat": "samarl_flat",
    "hierarchical": "samarl",
    "lookahead": "cadrl",
    "squashed": "msa3cpred",
}


def selected_agent(config: DictConfig) -> DictConfig:
    """Return the configuration of the agent with the checkpoint named on the command line.

    Raises:
        ConfigurationError: the agent uses no checkpoint, or the checkpoint holds another kind of
            policy.
    """
    agent: DictConfig = config.agent
    if config.checkpoint is not None:
        if "checkpoint" not in agent:
            raise ConfigurationError(
                f"checkpoint is {config.checkpoint!r}; it must be null for agents without a policy "
                "(agent=samarl has one)"
            )
        agent.checkpoint = config.checkpoint
    overrides = HydraConfig.get().overrides.task
    if config.checkpoint is not None or any("agent.checkpoint=" in word for word in overrides):
        _check_policy_kind(str(HydraConfig.get().runtime.choices.agent), str(agent.checkpoint))
    return agent


def compile_for(agent: Mapping[str, Any], scenario: Scenario) -> None:
    """Compile what evaluating an agent needs, side by side, unless it is cached."""
    with compile_ahead(World(scenario)) as compiles:
        if compiles:
            warm_up(build_agent(agent, scenario), scenario)


def _check_policy_kind(name: str, checkpoint: str) -> None:
    """Refuse a checkpoint with another kind of policy than the agent's own.

    Its results would otherwise carry the name of another method.

    Args:
        name: name of the agent.
        checkpoint: a file or the name of a shipped policy.

    Raises:
        ConfigurationError: the kinds differ.
    """
    from samarl.policies.checkpoint import (  # imports torch, which planners do not need
        find_policy,
        read_card,
    )

    own = str(load_agent_config(name).get("checkpoint"))
    if own in (checkpoint, "???"):
        return
    kind, own_kind = (read_card(find_policy(policy)).policy for policy in (checkpoint, own))
    if kind != own_kind:
        other = AGENT_OF_POLICY.get(kind, "NAME, defined by your own conf/agent/NAME.yaml")
        raise ConfigurationError(
            f"checkpoint is {checkpoint!r}, a {kind} policy; it must be a {own_kind} policy for "
            f"agent={name}, or use agent={other}"
        )


def check_agent(config: DictConfig) -> tuple[str, Path] | None:
    """Check the scenario and the agent of a command without running it.

    Returns:
        The setting `output` if the command has it, see `run_command`.

    Raises:
        ConfigurationError: one of them is not valid.
    """
    scenario = scenario_in(config)
    scenario.load_recording()
    build_agent(selected_agent(config), scenario)
    return ("output", Path(config.output)) if "output" in config else None


def print_scope_warning(agent: Agent) -> None:
    """Print the scope warning of an agent, if there is one."""
    if warning := agent.scope_warning():
        print(f"note: {warning}", file=sys.stderr)
