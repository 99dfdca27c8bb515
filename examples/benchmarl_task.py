"""The benchmark as a task of BenchMARL: `python examples/benchmarl_task.py`.

BenchMARL 1.5 needs TorchRL below 0.12, which this package works with as well:
`pip install benchmarl "torchrl<0.12" "tensordict<0.12"`, best in an environment of its own. All its
algorithms and models then train here; this is its MAPPO with a multi-layer perceptron.
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
    """Worlds whose numbers are the task's configuration: the fields of `mrsan.Scenario`."""

    def get_env_fun(
        self, num_envs: int, continuous_actions: bool, seed: int | None, device: Any
    ) -> Callable[[], EnvBase]:
        """Worlds in which all that a robot observes is one row, as a perceptron wants it."""

        def make() -> EnvBase:
            worlds = TorchRLEnv(worlds=num_envs, device=device, seed=seed, **self.config)
            one_row = Compose(
                FlattenObservation(-2, -1, in_keys=[HUMANS, ROBOTS]),
                CatTensors([EGO, HUMANS, ROBOTS], FLAT),
            )
            return TransformedEnv(worlds, one_row)

        return make

    def supports_continuous_actions(self) -> bool:
        """They are accelerations and turns."""
        return True

    def supports_discrete_actions(self) -> bool:
        """There are none."""
        return False

    def max_steps(self, env: EnvBase) -> int:
        """As many as the time limit allows."""
        return round(env.scenario.time_limit / env.scenario.time_step)

    def has_render(self, env: EnvBase) -> bool:
        """Pictures are made by `samarl-render`."""
        return False

    def group_map(self, env: EnvBase) -> dict[str, list[str]]:
        """All robots are one group."""
        return env.group_map

    def observation_spec(self, env: EnvBase) -> Composite:
        """What the actors see."""
        return _only(env.full_observation_spec_unbatched, FLAT[-1])

    def action_spec(self, env: EnvBase) -> Composite:
        """What they do."""
        return env.full_action_spec_unbatched

    def info_spec(self, env: EnvBase) -> None:
        """Nothing else is logged."""

    def state_spec(self, env: EnvBase) -> None:
        """Critics see what all robots see."""

    def action_mask_spec(self, env: EnvBase) -> None:
        """Every action is allowed at any time."""

    @staticmethod
    def env_name() -> str:
        """As it is called in logs."""
        return "mrsan"


class SocialNavigation(Task):
    """The tasks; `SocialNavigation.CIRCLE.get_task({"humans": 5})`."""

    CIRCLE = None

    @staticmethod
    def associated_class() -> type[TaskClass]:
        """Their class."""
        return SocialNavigationClass


def _only(spec: Composite, key: str) -> Composite:
    """Of the robots' entries the one of this name."""
    agents = spec["agents"].clone()
    for other in set(agents.keys()) - {key}:
        del agents[other]
    return Composite(agents=agents)


def main() -> None:
    """Train with BenchMARL's own experiment."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--humans", type=int, default=0, help="people in each world")
    parser.add_argument("--robots", type=int, default=2, help="in each world")
    parser.add_argument("--steps", type=int, default=400_000, help="of all worlds together")
    parser.add_argument("--worlds", type=int, default=64)
    wanted = parser.parse_args()
    experiment = ExperimentConfig.get_from_yaml()
    experiment.max_n_frames, experiment.gamma = wanted.steps, 0.99
    experiment.on_policy_n_envs_per_worker = wanted.worlds
    experiment.on_policy_collected_frames_per_batch = 64 * wanted.worlds
    experiment.on_policy_n_minibatch_iters, experiment.on_policy_minibatch_size = 4, 1024
    experiment.evaluation, experiment.loggers, experiment.create_json = False, [], False
    outputs = Path("outputs")
    outputs.mkdir(exist_ok=True)
    experiment.save_folder = str(outputs)
    scenario = {"humans": wanted.humans, "robots": wanted.robots}
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
