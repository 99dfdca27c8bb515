"""Training from Python: `train` and the run that it returns."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mrsan import ConfigurationError, Scenario
from samarl import api
from samarl.agents import Agent
from samarl.api import Name
from samarl.configuration import import_plugins, training_scenario
from samarl.evaluation.result import EvaluationResult
from samarl.training.curriculum import CurriculumStage
from samarl.training.settings import RunSettings, composed_settings, resumed_settings

if TYPE_CHECKING:
    from pandas import DataFrame

Choice = str | Mapping[str, Any]


class Run:
    """A training run in its folder.

    Examples:
        ```python
        run = samarl.train("outputs/office", policy="flat", scenario="office.yaml")
        run.evaluate(cases=100)  # in the scenario of its training
        run.curves().plot("steps", "charts/success")
        run = run.resume(steps=2_000_000)
        ```
    """

    def __init__(self, folder: Name) -> None:
        """Open the folder of a run, which may be training still."""
        self.folder = Path(folder)

    def __repr__(self) -> str:
        return f"Run({str(self.folder)!r})"

    @property
    def scenario(self) -> Scenario:
        """Return the scenario of the training, see `samarl.configuration.training_scenario`."""
        return training_scenario(str(self.folder))

    @property
    def agent(self) -> Agent:
        """Return the best policy as an agent in the scenario of the training."""
        return api.load_agent(self.folder, self.scenario)

    def evaluate(
        self, scenario: Name | Scenario | None = None, cases: int = 500, **settings: Any
    ) -> EvaluationResult:
        """Evaluate the best policy.

        Args:
            scenario: None: that of the training.
            cases: how many, or which.
            **settings: further arguments of `samarl.evaluate`.
        """
        agent = self.agent if scenario is None else api.load_agent(self.folder, scenario)
        return api.evaluate(agent, cases=cases, **settings)

    def curves(self) -> DataFrame:
        """Return the learning curve, one row per update; docs/runs.md explains the columns.

        Raises:
            ConfigurationError: nothing has been saved yet.
        """
        from pandas import read_csv

        path = self.folder / "progress.csv"
        if not path.is_file():
            raise ConfigurationError(f"folder is {str(self.folder)!r}; it must hold progress.csv")
        return read_csv(path)

    def resume(
        self, steps: int | None = None, *, threads: int | None = None, plugins: Sequence[str] = ()
    ) -> Run:
        """Continue the training run, for example after an interrupt.

        Args:
            steps: environment steps in total; None: as before.
            threads: of each process; None: the default.
            plugins: modules to import first.

        Raises:
            ConfigurationError: the folder holds no run, or `steps` is smaller than before.
            KeyboardInterrupt: it was interrupted; another call resumes it.
        """
        import_plugins(plugins)
        changes = {"steps": steps, "threads": threads}
        trainer = {name: value for name, value in changes.items() if value is not None}
        return _run(resumed_settings(self.folder, trainer, plugins), f"{self!r}.resume()")


def train(
    run_dir: Name | None = None,
    *,
    experiment: str | None = None,
    policy: Choice | None = None,
    encoder: Choice | None = None,
    algorithm: Choice | None = None,
    curriculum: Choice | Sequence[CurriculumStage] | None = None,
    trainer: Choice | None = None,
    scenario: Name | Scenario | None = None,
    worlds: int | None = None,
    init_from: Name | None = None,
    plugins: Sequence[str] = (),
) -> Run:
    """Train a policy, or resume the interrupted run in the folder.

    `policy`, `encoder`, `algorithm`, `curriculum` and `trainer` are names of files in the folders
    of `conf/`, or mappings of their fields that change, in which `name` is the name of the file.

    Args:
        run_dir: folder of the run. None: that of the recipe.
        experiment: recipe in `conf/experiment/`. None: the default recipe, with two levels.
        policy: "flat", "hierarchical", ..., or {"name": "flat", "hidden": 32}.
        encoder: "set_pool", "spatio_temporal", ...
        algorithm: "mappo", "ippo", ..., or changes such as {"learning_rate": 1e-3}.
        curriculum: "circle", ..., or a list of stages.
        trainer: changes such as {"steps": 1_000_000, "seed": 1}.
        scenario: trains in one scenario instead of the curriculum (`samarl.load_scenario` lists the
            forms).
        worlds: number of its worlds. None: as many as at the end of the curriculum.
        init_from: policy with the initial weights.
        plugins: modules that register what the settings name, and that other processes import.

    Raises:
        ConfigurationError: a setting is not valid, or the folder holds a run with other settings.
        TrainingError: the training run failed.
        KeyboardInterrupt: it was interrupted; the same call resumes it.

    Examples:
        ```python
        three = samarl.load_scenario(humans=3)
        run = samarl.train("outputs/a", policy="flat", scenario=three, trainer={"steps": 200_000})
        run.evaluate()
        ```
    """
    arguments = {name: value for name, value in locals().items() if value}
    import_plugins(plugins)
    settings = composed_settings(
        None if run_dir is None else Path(run_dir),
        {
            "experiment": experiment,
            "policy": policy,
            "encoder": encoder,
            "algorithm": algorithm,
            "curriculum": curriculum,
            "trainer": trainer,
        },
        scenario=None if scenario is None else api.load_scenario(scenario),
        worlds=worlds,
        init_from=None if init_from is None else str(init_from),
        plugins=plugins,
    )
    call = ", ".join(f"{name}={value!r}" for name, value in arguments.items())
    return _run(settings, f"samarl.train({call})")


def _run(settings: RunSettings, command: str) -> Run:
    """Train in this process, and in others if the settings say so."""
    from samarl.training.run import run_training  # imports torch

    run_training(settings, command)
    return Run(settings.folder)
