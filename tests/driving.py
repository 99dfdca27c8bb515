"""An exported policy on a robot, for tests of the runtime."""

from pathlib import Path

from mrsan import Scenario
from samarl.agents import Agent
from samarl.agents.learned import Learned
from samarl.agents.shielded import Shielded
from samarl.export import export_agent
from samarl.planning.shield import Shield
from samarl.policies.checkpoint import save_policy
from samarl.runtime import Driver
from tests import learning


def driver_without_walls(folder: Path, shield: Shield | None, gain: float = 100.0) -> Driver:
    """A policy that was trained without walls; with a gain of 100 it drives towards its goal."""
    save_policy(folder / "policy.safetensors", learning.policy("flat", gain=gain), "flat", {})
    scenario = Scenario(humans=3, robots=2)
    agent: Agent = Learned(scenario, str(folder / "policy.safetensors"))
    if shield is not None:
        agent = Shielded(scenario, agent, shield)
    export_agent(folder / "policy.onnx", agent, "policy")
    return Driver.load(folder / "policy.onnx")
