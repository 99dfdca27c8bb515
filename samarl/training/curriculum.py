"""Curricula: the scenarios of a training run, and during which part of it each is used."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

from omegaconf import MISSING

from mrsan import ConfigurationError, Scenario
from mrsan.fields import check_numbers, number, setting


@dataclass
class CurriculumStage:
    """A scenario for training, the number of its worlds, and when it is used."""

    worlds: int = number(MISSING, 1, 10**6, help="worlds simulated side by side")
    begin: float = number(0.0, 0.0, 1.0, help="training progress at which the stage begins")
    end: float = number(1.0, 0.0, 1.0, help="training progress at which the stage ends")
    midway_start_probability: float = number(
        0.0, 0.0, 1.0, help="probability that an episode starts on the route around the crowd"
    )
    failure_restart_probability: float = number(
        0.0, 0.0, 1.0, help="probability that a world goes back up to 16 steps after a collision"
    )
    noise_correlation: float = number(
        0.0, 0.0, 0.99, help="correlation of the local level's noise between steps"
    )
    scenario: Scenario = field(default_factory=Scenario)
    standstill_limit: float = number(
        0.0, 0.0, 1e6, unit="s", help="an episode ends once a robot has stood for so long; 0: never"
    )
    standstill_penalty: float = number(
        0.0, 0.0, 1e6, help="penalty of the robot that ended an episode by standing"
    )

    guide: str | None = setting(
        None, help="agent like right_of_way that sends robots to goals and queue places"
    )
    teacher: str | None = setting(
        None, help="agent whose actions are imitated at first; null: algorithm.teacher"
    )
    teacher_share: float = number(
        1.0, 0.0, 1.0, above=True, help="share of the worlds in which the teacher says its action"
    )

    @property
    def driver_scenario(self) -> Scenario:
        """The scenario as the policy observes it: messages are for the guide, if there is one."""
        return self.scenario if self.guide is None else replace(self.scenario, team_messages=False)

    def is_active(self, progress: float) -> bool:
        """Return whether the stage is used at a training progress from 0 to 1."""
        return self.begin <= progress < self.end


def check_stages(stages: list[CurriculumStage]) -> None:
    """Check all numbers, and that at least one stage is active at any time.

    Raises:
        ConfigurationError: names the field that is wrong.
    """
    for index, stage in enumerate(stages):
        name = f"curriculum.stages[{index}]"
        check_numbers(stage, name)
        if stage.begin >= stage.end:
            raise ConfigurationError(
                f"{name}.begin is {stage.begin}; it must be less than {name}.end ({stage.end})"
            )
    for progress in (0.0, *(stage.end for stage in stages)):
        if progress < 1.0 and not any(stage.is_active(progress) for stage in stages):
            raise ConfigurationError(
                f"curriculum.stages has no stage that is active at {progress:g} of the run; it "
                "must have at least one at any time"
            )


def single_stage(
    stages: list[CurriculumStage], scenario: Scenario, worlds: int | None
) -> CurriculumStage:
    """Return one stage with a scenario, and otherwise like the last stage of a curriculum.

    Without `worlds` it has as many as all stages with which the curriculum ends.
    """
    final = [stage for stage in stages if stage.end == 1.0]
    total = sum(stage.worlds for stage in final)
    return replace(final[-1], begin=0.0, worlds=worlds or total, scenario=scenario)
