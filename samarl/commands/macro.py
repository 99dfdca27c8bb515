"""`samarl-macro`: train the macro level of `right_of_way` and compare it with the rule."""

from __future__ import annotations

import json
import time
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from omegaconf import MISSING, DictConfig

from mrsan import ConfigurationError, Scenario, Split
from mrsan.fields import check_numbers, number
from samarl.commands.cli import command_line, run_command
from samarl.configuration import load_method_config, open_mapping, scenario_of
from samarl.files import check_writable, code_version, machine, write_json
from samarl.policies.card import BEST
from samarl.registry import checked_fields


@dataclass
class Macro:
    """Schema of `conf/macro.yaml`."""

    training: Any = MISSING
    driver: str = MISSING
    scenarios: dict[str, Any] = open_mapping()
    validation_cases: int = number(MISSING, 1, 10**6, help="validation cases per scenario")
    output: str = MISSING
    plugins: list[str] = field(default_factory=list)


def main() -> None:
    """Entry point."""
    run_command(macro, "macro", macro_schema=Macro)


def macro(config: DictConfig) -> None:
    """Train a macro level, measure it beside the rule, and write the results."""
    from samarl.agents.build import build_agent
    from samarl.macro_level.learner import Learner
    from samarl.macro_level.network import NetworkConfig, save_macro_level
    from samarl.macro_level.settings import MacroRewards, MacroTraining

    values = checked_fields(MacroTraining, config.training, "training")
    values["rewards"] = MacroRewards(**values["rewards"])
    values["network"] = NetworkConfig(**values["network"])
    training = MacroTraining(**values)
    check_numbers(Macro(validation_cases=config.validation_cases), "")
    scenarios = {str(name): scenario_of(s, "scenarios") for name, s in config.scenarios.items()}
    if not scenarios:
        raise ConfigurationError("scenarios is empty; it must name at least one")
    output = Path(config.output)
    check_writable(output / BEST, "output")
    method = load_method_config(config.driver, "driver")
    agents = {name: build_agent(method, scenario) for name, scenario in scenarios.items()}
    learner = Learner(training, agents, output / "training.safetensors")
    if learner.steps:
        print(f"resuming at step {learner.steps} of {training.steps}")
    start = time.monotonic()
    learner.learn()
    provenance: dict[str, Any] = {
        "command": command_line("samarl-macro"),
        "commit": code_version(),
        "machine": machine(),
        "steps": learner.steps,
        "seconds": round(time.monotonic() - start, 1),  # of this command, if it was resumed
        "configuration": {
            "training": asdict(training),
            "curriculum": {"stages": [_stage(s) for s in scenarios.values()]},
        },
    }
    save_macro_level(output / BEST, learner.actor, provenance)
    rows = _compare(method, scenarios, output, config.validation_cases)
    write_json(output / "macro.json", provenance | {"validation": rows, "curve": learner.curve})
    print(f"written to {output}")


def _stage(scenario: Scenario) -> dict[str, Any]:
    """Return a stage of a curriculum for a card."""
    return {"scenario": json.loads(json.dumps(asdict(scenario), default=str))}


def _compare(
    method: dict[str, Any], scenarios: dict[str, Scenario], output: Path, cases: int
) -> dict[str, Any]:
    """Measure the macro level beside the rule; return and print success and makespan."""
    from samarl.agents.build import build_agent
    from samarl.evaluation.runner import run_cases
    from samarl.macro_level.decisions import guide_of

    numbers = Split.validation.case(0) + np.arange(cases, dtype=np.int64)
    rows: dict[str, Any] = {}
    for name, scenario in scenarios.items():
        for kind in ("rule", "learned", "learned, sampled"):
            agent = build_agent(method, scenario)
            guide = guide_of(agent)
            if kind != "rule":
                guide.use(str(output), sampled=kind == "learned, sampled")
            episodes = run_cases(agent, scenario, numbers, batch=256)
            success = episodes.success
            makespan = float(episodes.time.max(1)[success].mean()) if success.any() else np.nan
            row = {"success": float(success.mean()), "makespan": makespan}
            rows[f"{name}, {kind}"] = row
            print(
                f"{name}, {kind}: success {100 * row['success']:.1f} %, makespan {makespan:.1f} s"
            )
    return rows


if __name__ == "__main__":
    main()
