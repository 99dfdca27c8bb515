"""The agent that a command line chooses."""

from __future__ import annotations

import sys

from hydra.core.hydra_config import HydraConfig
from omegaconf import DictConfig

from mrsan import ConfigurationError
from samarl.agents import Agent, build_agent
from samarl.configuration import load_agent, scenario_in

_AGENTS = {  # one of each kind of policy
    "flat": "samarl_flat", "hierarchical": "samarl", "lookahead": "cadrl", "squashed": "msa3cpred",
}  # fmt: skip


def chosen_agent(config: DictConfig) -> DictConfig:
    """Return the configuration of the agent, with the checkpoint that the command line names.

    Raises:
        ConfigurationError: the agent has no checkpoint, or its policy is of another kind.
    """
    agent: DictConfig = config.agent
    if config.checkpoint is not None:
        if "checkpoint" not in agent:
            raise ConfigurationError(
                f"checkpoint is {config.checkpoint!r}; it must be null for an agent without one "
                "(agent=samarl has one)"
            )
        agent.checkpoint = config.checkpoint
    overrides = HydraConfig.get().overrides.task
    if config.checkpoint is not None or any("agent.checkpoint=" in word for word in overrides):
        _check_policy_kind(str(HydraConfig.get().runtime.choices.agent), str(agent.checkpoint))
    return agent


def _check_policy_kind(name: str, checkpoint: str) -> None:
    """Refuse a checkpoint that holds another kind of policy than the agent's own.

    Its rows and pictures would carry the name of a method that did not drive.

    Args:
        name: of the agent.
        checkpoint: a file, or the name of a shipped policy.
    """
    from samarl.policies.checkpoint import find_policy, read_card  # torch, which planners spare

    own = str(load_agent(name).get("checkpoint"))
    if own in (checkpoint, "???"):
        return
    kind, own_kind = (read_card(find_policy(policy)).policy for policy in (checkpoint, own))
    if kind != own_kind:
        other = _AGENTS.get(kind, "NAME with a file conf/agent/NAME.yaml of your own")
        raise ConfigurationError(
            f"checkpoint is {checkpoint!r}, a {kind} policy; agent={name} drives {own_kind} "
            f"policies (choose agent={other})"
        )


def check_agent(config: DictConfig) -> None:
    """Check the scenario and the agent of a command without playing.

    Raises:
        ConfigurationError: names what is wrong.
    """
    scenario = scenario_in(config)
    scenario.load_recording()
    build_agent(chosen_agent(config), scenario)


def print_scope_warning(agent: Agent) -> None:
    """Say what a user should know of an agent in its scenario, if there is anything."""
    if warning := agent.scope_warning():
        print(f"note: {warning}", file=sys.stderr)
