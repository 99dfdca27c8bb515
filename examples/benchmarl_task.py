"""Train with BenchMARL on this benchmark: `python examples/benchmarl_task.py`.

BenchMARL 1.5 requires TorchRL below 0.12, which this package supports as well:
`pip install benchmarl "torchrl<0.12" "tensordict<0.12"`, preferably in a separate environment. All
algorithms and models of BenchMARL can be used; this example uses MAPPO with a multi-layer
perceptron.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from pathlib import Path
from typing import Any

from benchmarl.algorithms import MappoConfig
from benchmarl.environments.common import Task, TaskClass
from benchmarl.experiment import Experiment, ExperimentConfig
from benchmarl.models.mlp import MlpConfig
from torchrl.data import Composite
from torchrl.envs import CatTensors, Compose, EnvBase, FlattenObservation, TransformedEnv

from mrsan.torchrl_env import TorchRLEnv

EGO, HUMANS, ROBOTS = (("agents", "observation", name) for name in ("ego", "humans", "robots"))
FLAT = ("agents", "flat")


class SocialNavigationClass(TaskClass):
    """A BenchMARL task whose configuration holds fields of `mrsan.Scenario`."""

    def get_env_fun(
        self, num_envs: int, continuous_actions: bool, seed: int | None, device: Any
    ) -> Callable[[], EnvBase]:
        """Return a function that creates worlds with flat observations for a perceptron."""

        def make() -> EnvBase:
            worlds = TorchRLEnv(worlds=num_envs, device=device, seed=seed, **self.config)
            flatten = Compose(
                FlattenObservation(-2, -1, in_keys=[HUMANS, ROBOTS]),
                CatTensors([EGO, HUMANS, ROBOTS], FLAT),
            )
            return TransformedEnv(worlds, flatten)

        return make

    def supports_continuous_actions(self) -> bool:
        """Return True: actions are accelerations and turns."""
        return True

    def supports_discrete_actions(self) -> bool:
        """Return False."""
        return False

    def max_steps(self, env: EnvBase) -> int:
        """Return the number of steps within the time limit."""
        return round(env.scenario.time_limit / env.scenario.time_step)

    def has_render(self, env: EnvBase) -> bool:
        """Return False: use `samarl-render` to draw episodes."""
        return False

    def group_map(self, env: EnvBase) -> dict[str, list[str]]:
        """Return one group with all robots."""
        return env.group_map

    def observation_spec(self, env: EnvBase) -> Composite:
        """Return the specification of the observations of the actors."""
        return _only(env.full_observation_spec_unbatched, FLAT[-1])

    def action_spec(self, env: EnvBase) -> Composite:
        """Return the specification of the actions."""
        return env.full_action_spec_unbatched

    def info_spec(self, env: EnvBase) -> None:
        """Return None: nothing else is logged."""

    def state_spec(self, env: EnvBase) -> None:
        """Return None: critics receive the observations of all robots."""

    def action_mask_spec(self, env: EnvBase) -> None:
        """Return None: every action is allowed at any time."""

    @staticmethod
    def env_name() -> str:
        """Return the name of the environment in logs."""
        return "mrsan"


class SocialNavigation(Task):
    """The tasks of the benchmark, for example `SocialNavigation.CIRCLE.get_task({"humans": 5})`."""

    CIRCLE = None

    @staticmethod
    def associated_class() -> type[TaskClass]:
        """Return the class of the tasks."""
        return SocialNavigationClass


def _only(spec: Composite, key: str) -> Composite:
    """Return a specification with only the entry `key` of the robots."""
    agents = spec["agents"].clone()
    for other in set(agents.keys()) - {key}:
        del agents[other]
    return Composite(agents=agents)


def main() -> None:
    """Train with BenchMARL's experiment."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--humans", type=int, default=0, help="number of people in each world")
    parser.add_argument("--robots", type=int, default=2, help="number of robots in each world")
    parser.add_argument("--steps", type=int, default=400_000, help="steps of all worlds together")
    parser.add_argument("--worlds", type=int, default=64)
    arguments = parser.parse_args()
    experiment = ExperimentConfig.get_from_yaml()
    experiment.max_n_frames, experiment.gamma = arguments.steps, 0.99
    experiment.on_policy_n_envs_per_worker = arguments.worlds
    experiment.on_policy_collected_frames_per_batch = 64 * arguments.worlds
    experiment.on_policy_n_minibatch_iters, experiment.on_policy_minibatch_size = 4, 1024
    experiment.evaluation, experiment.loggers, experiment.create_json = False, [], False
    outputs = Path("outputs")
    outputs.mkdir(exist_ok=True)
    experiment.save_folder = str(outputs)
    scenario = {"humans": arguments.humans, "robots": arguments.robots}
    Experiment(
        task=SocialNavigation.CIRCLE.get_task(scenario),
        algorithm_config=MappoConfig.get_from_yaml(),
        model_config=MlpConfig.get_from_yaml(),
        critic_model_config=MlpConfig.get_from_yaml(),
        seed=0,
        config=experiment,
    ).run()


if __name__ == "__main__":
    main()
