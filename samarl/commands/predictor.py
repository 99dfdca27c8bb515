"""`samarl-predictor`: train the predictor of people and compare it with constant velocity."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from omegaconf import MISSING, DictConfig, OmegaConf

from mrsan import ConfigurationError, Scenario, Split
from mrsan.fields import check_numbers, number
from mrsan.prediction import RecurrentPredictor, find_predictor
from samarl.commands.cli import command_line, run_command
from samarl.commands.recordings import recordings_in
from samarl.configuration import open_mapping, scenario_of
from samarl.files import check_writable, code_version, write_json, write_text
from samarl.prediction.training import Training
from samarl.registry import checked_fields

if TYPE_CHECKING:
    from samarl.prediction.windows import Windows

WEIGHTS = "recurrent.safetensors"


@dataclass
class Predictor:
    """Schema of `conf/predictor.yaml`."""

    predictor: str | None = None
    training: Any = MISSING
    crowds: dict[str, Any] = open_mapping()
    validation_cases: int = number(MISSING, 1, 10**6, help="validation cases per crowd")
    shown_steps: int = number(MISSING, 1, 200, help="steps ahead for which errors are shown")
    recordings: str | None = None
    frame_seconds: dict[str, float] = open_mapping(float)
    output: str = MISSING
    plugins: list[str] = field(default_factory=list)


def main() -> None:
    """Entry point."""
    run_command(predictor, "predictor", predictor_schema=Predictor)


def predictor(config: DictConfig) -> None:
    """Train a predictor or load the one in `predictor`, measure it, and write the results."""
    from samarl.prediction.learner import save_predictor
    from samarl.prediction.table import errors, page
    from samarl.prediction.windows import recorded_windows, simulate_windows

    training = Training(**checked_fields(Training, config.training, "training"))
    numbers = Predictor(validation_cases=config.validation_cases, shown_steps=config.shown_steps)
    check_numbers(numbers, "")
    if config.shown_steps > training.steps:
        raise ConfigurationError(
            f"shown_steps is {config.shown_steps}; it must be at most training.steps "
            f"({training.steps})"
        )
    crowds = {str(name): scenario_of(crowd, "crowds") for name, crowd in config.crowds.items()}
    if not crowds:
        raise ConfigurationError("crowds is empty; it must name at least one")
    time_step = next(iter(crowds.values())).time_step
    recordings = recordings_in(config.recordings, config.frame_seconds)
    output = Path(config.output)
    check_writable(output / WEIGHTS, "output")
    provenance: dict[str, Any] = {
        "command": command_line("samarl-predictor"),
        "commit": code_version(),
    }
    cases = Split.validation.case(0) + np.arange(config.validation_cases, dtype=np.int64)
    windows: dict[str, Windows] = {
        name: simulate_windows(scenario, cases, training) for name, scenario in crowds.items()
    }
    for path, frame_seconds in recordings.items():
        windows[path.stem] = recorded_windows(path, frame_seconds, time_step, training)
    if config.predictor is not None:
        measured = find_predictor(config.predictor, time_step)
        result = provenance | {"errors": errors(measured, windows, config.shown_steps)}
    else:
        trained = _train(training, crowds, output / "training.safetensors")
        result = provenance | {"errors": errors(trained, windows, config.shown_steps)}
        settings = {
            "training": asdict(training),
            "crowds": OmegaConf.to_container(config.crowds, enum_to_str=True),
        }
        save_predictor(output / WEIGHTS, trained, result | settings)
    write_json(output / "prediction.json", result)
    text = page(result, time_step)
    write_text(output / "prediction.md", text)
    print(text)
    print(f"written to {output}")


def _train(training: Training, crowds: Mapping[str, Scenario], state: Path) -> RecurrentPredictor:
    """Train a predictor, resuming from the file `state` if it exists."""
    from samarl.prediction.learner import Learner

    learner = Learner(training, crowds, state)
    if learner.round:
        print(f"resuming at round {learner.round} of {training.rounds}")
    learner.learn()
    return learner.predictor()


if __name__ == "__main__":
    main()
