"""The agent and the scenario that a command line selects."""

from __future__ import annotations

import sys
from pathlib import Path

from hydra.core.hydra_config import HydraConfig
from hydra.core.override_parser.overrides_parser import OverridesParser
from omegaconf import DictConfig, OmegaConf

from mrsan import ConfigurationError, Scenario
from samarl.agents import Agent, build_agent
from samarl.api import scenario_of_training
from samarl.configuration import is_own_policy, load_agent_config, scenario_in, training_scenario
from samarl.policies.card import find_policy, read_card
from samarl.user_files import AGENT_OF_POLICY, name_of


def agent_in(config: DictConfig) -> Agent:
    """Build the agent for its scenario; print notes on its training.

    Raises:
        ConfigurationError: a setting is not valid, or the checkpoint holds another kind of policy.
    """
    if policy := _policy_with_scenario(config):
        scenario_of_training(policy)
    return with_notes(_build(config))


def with_notes(agent: Agent) -> Agent:
    """Return an agent; print how the scenario differs from those of its training."""
    if warning := agent.scope_warning():
        print(f"note: {warning}", file=sys.stderr)
    return agent


def check_agent(config: DictConfig) -> tuple[str, Path] | None:
    """Check the scenario and the agent of a command without running it.

    Returns:
        The setting `output` if the command has it, see `run_command`.

    Raises:
        ConfigurationError: one of them is not valid.
    """
    _build(config).scenario.load_recording()
    return ("output", Path(config.output)) if "output" in config else None


def _build(config: DictConfig) -> Agent:
    settings = config.agent
    if config.checkpoint is not None:
        if "checkpoint" not in settings:
            raise ConfigurationError(
                f"checkpoint is {config.checkpoint!r}; it must be null for agents without a policy "
                "(agent=samarl has one)"
            )
        settings.checkpoint = config.checkpoint
    name = str(HydraConfig.get().runtime.choices.agent)
    if _given_checkpoint(config):
        _check_policy_kind(name, str(settings.checkpoint))
    agent = build_agent(settings, _scenario(config))
    settings = [word.removeprefix("agent.") for word in _overrides() if word.startswith("agent.")]
    agent.label = " ".join([name_of(name), *settings])
    return agent


def _scenario(config: DictConfig) -> Scenario:
    """Return the scenario: for a policy of the user that of its training, with explicit changes."""
    policy = _policy_with_scenario(config)
    if policy is None:
        return scenario_in(config)
    scenario = OmegaConf.structured(training_scenario(policy))
    OmegaConf.set_struct(scenario, False)
    for override in OverridesParser.create().parse_overrides(_overrides()):
        group, _, field = override.key_or_group.partition(".")
        if group == "scenario":
            OmegaConf.update(scenario, field, override.value(), merge=True)
    config.scenario = scenario
    return scenario_in(config)


def _policy_with_scenario(config: DictConfig) -> str | None:
    """Return the policy whose training determines the scenario, or None.

    It is one that is selected by `agent=PATH` or `checkpoint=PATH`, unless `scenario=NAME` is set.
    """
    if any(word.partition("=")[0] == "scenario" for word in _overrides()):
        return None
    name = str(HydraConfig.get().runtime.choices.agent)
    return _given_checkpoint(config) or (name if is_own_policy(name) else None)


def _given_checkpoint(config: DictConfig) -> str | None:
    """Return the checkpoint of the command line, which replaces that of the agent, or None."""
    is_set = any(word.startswith("agent.checkpoint=") for word in _overrides())
    return config.checkpoint or (str(config.agent.checkpoint) if is_set else None)


def _overrides() -> list[str]:
    return list(HydraConfig.get().overrides.task)


def _check_policy_kind(name: str, checkpoint: str) -> None:
    """Refuse a checkpoint with another kind of policy than the agent's own.

    Its results would otherwise carry the name of another method.

    Raises:
        ConfigurationError: the kinds differ.
    """
    own = str(load_agent_config(name).get("checkpoint"))
    if own in (checkpoint, "???"):
        return
    kind, own_kind = (read_card(find_policy(policy)).policy for policy in (checkpoint, own))
    if kind != own_kind:
        raise ConfigurationError(
            f"checkpoint is {checkpoint!r}, a {kind} policy; it must be a {own_kind} policy for "
            f"agent={name}, or use agent={AGENT_OF_POLICY.get(kind, checkpoint)}"
        )
