"""`samarl-export`: export a trained policy as an ONNX file that runs without torch."""

from __future__ import annotations

from dataclasses import dataclass, field
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from omegaconf import MISSING, DictConfig

from mrsan import ConfigurationError
from samarl.commands.agents import agent_in, check_agent
from samarl.commands.cli import run_command
from samarl.configuration import open_mapping
from samarl.files import check_writable


@dataclass
class Export:
    """Schema of `conf/export.yaml`."""

    output: str = MISSING
    scenario: Any = MISSING
    agent: Any = open_mapping()
    checkpoint: str | None = None
    plugins: list[str] = field(default_factory=list)


def main() -> None:
    """Entry point."""
    run_command(export, "export", check_agent, export_schema=Export)


def export(config: DictConfig) -> None:
    """Export the policy."""
    path = Path(config.output)
    if path.suffix.lower() != ".onnx":
        raise ConfigurationError(f"output is {config.output!r}; it must end in .onnx")
    if not (find_spec("onnx") and find_spec("onnxruntime")):
        raise ConfigurationError("onnx is not installed; pip install 'samarl[export]' installs it")
    from samarl.export import export_agent

    check_writable(path, "output")
    agent = agent_in(config)
    export_agent(path, agent, agent.label)
    print(f"written to {path}")


if __name__ == "__main__":
    main()
