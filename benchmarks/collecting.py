"""Compare SAMARL's and TorchRL's collectors: `python -m benchmarks.collecting`.

Both explore with the same policy in the same number of worlds, in alternating rounds. The data of
TorchRL's collector is converted to the same `Rollout`, so a learner can use either. TorchRL's
collector cannot restart worlds from earlier states.
"""

from __future__ import annotations

import argparse
import statistics
import tempfile
import time
from collections.abc import Iterator
from typing import Any

import torch
from tensordict import TensorDict, TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torch import Tensor
from torchrl.collectors import Collector
from torchrl.envs import InitTracker, TransformedEnv

from benchmarks.training import default_trainer
from benchmarks.workload import add_output, interruptible, positive_whole_number, provenance
from mrsan import Entities, Observation
from mrsan.features import VELOCITY
from mrsan.scenario import Scenario
from mrsan.sensors.suite import SensorSuite
from mrsan.torchrl_env import TorchRLEnv
from samarl.files import write_json
from samarl.observations.features import empty_frames
from samarl.observations.frames import Frames
from samarl.policies.policy import LOCAL
from samarl.policies.stochastic import StochasticPolicy
from samarl.progress import progress_bar
from samarl.rollout import Rollout
from samarl.training.collector import RolloutCollector
from samarl.training.curriculum import CurriculumStage

WORLDS, STEPS = 96, 32
OBSERVATION_KEYS = [
    ("agents", "observation", name) for name in SensorSuite(Scenario()).empty(1).arrays()
]
FRAME_KEYS = {name: ("agents", "known", name) for name in empty_frames(Scenario()).arrays("known")}


def main() -> None:
    """Measure both collectors, print their speeds and write the JSON file."""
    arguments = _parse()
    scenario = Scenario()
    with tempfile.TemporaryDirectory() as folder:
        policy = default_trainer(["policy=flat", f"run_dir={folder}"]).policy
    assert isinstance(policy, StochasticPolicy)
    stage = CurriculumStage(WORLDS, scenario=scenario)
    samarl_collector = RolloutCollector(stage, policy, STEPS, 0)
    torchrl_collector = torchrl_rollouts(policy, scenario, WORLDS, STEPS, arguments.rounds + 1)
    collectors = (
        ("samarl", samarl_collector.collect),
        ("torchrl", lambda: next(torchrl_collector)),
    )
    seconds: dict[str, list[float]] = {"samarl": [], "torchrl": []}
    with interruptible():
        for number in progress_bar(range(arguments.rounds + 1), desc="collecting", unit="round"):
            for name, collect in collectors:
                start = time.perf_counter()
                collect()
                if number > 0:  # the first round compiles and warms up
                    seconds[name].append(time.perf_counter() - start)
    rates = {name: WORLDS * STEPS / statistics.median(times) for name, times in seconds.items()}
    result: dict[str, Any] = {
        "world_steps_per_second": {name: round(rate, 1) for name, rate in rates.items()},
        "times_as_fast": round(rates["samarl"] / rates["torchrl"], 2),
        **provenance("collecting"),
    }
    write_json(arguments.output, result)
    for name, rate in rates.items():
        print(f"{name}: {rate:,.0f} world-steps per second")
    print(f"written to {arguments.output}")


class Actor(TensorDictModuleBase):
    """Explores with a policy as a TorchRL module and records what a learner needs."""

    def __init__(self, policy: StochasticPolicy, scenario: Scenario, worlds: int) -> None:
        super().__init__()
        self.policy, self.scenario = policy, scenario
        self.state = policy.initial_state(worlds, scenario)
        self.in_keys = [*OBSERVATION_KEYS, ("agents", "active_mask"), "is_init"]
        recorded = ("action", "unclipped_action", "sample_log_prob", "previous_noise")
        self.out_keys = [*(("agents", name) for name in recorded), *FRAME_KEYS.values()]

    def forward(self, step: TensorDictBase) -> TensorDictBase:
        """Choose the actions of all robots of all worlds."""
        ego, humans, humans_visible, robots, robots_visible = (
            step[key].numpy() for key in OBSERVATION_KEYS
        )
        entities = {
            "humans": Entities(humans, humans_visible),
            "robots": Entities(robots, robots_visible),
        }
        observation = Observation(ego, entities, {}, {})
        is_init, active = step["is_init"][:, 0].numpy(), step["agents", "active_mask"][..., 0]
        decision = self.policy.act(
            observation, self.state, is_init, self.scenario, 0.0, active.numpy()
        )
        level = decision.levels[LOCAL]
        step["agents", "action"] = torch.from_numpy(decision.action)  # clipped
        step["agents", "unclipped_action"] = level.action
        step["agents", "sample_log_prob"] = level.log_prob
        step["agents", "previous_noise"] = decision.step.previous_noise
        for name, tensor in decision.features.arrays("known").items():
            step[FRAME_KEYS[name]] = tensor.view(*active.shape, *tensor.shape[2:])
        return step


def torchrl_rollouts(
    policy: StochasticPolicy, scenario: Scenario, worlds: int, steps: int, total: int
) -> Iterator[Rollout]:
    """Yield `total` rollouts of T steps in E worlds from TorchRL's collector.

    They do not contain the true state. The policy may be trained between two rollouts. It must be
    `flat`, whose reward is that of the task, and its encoder must not remember more than the last
    frames.
    """
    env = TransformedEnv(TorchRLEnv(scenario, worlds, seed=0), InitTracker())
    actor = Actor(policy, scenario, worlds)
    size = worlds * steps
    batches = Collector(env, actor, frames_per_batch=size, total_frames=total * size)
    h = policy.history
    past: Any = None  # the last h + 1 steps of the previous batch
    for batch in batches:
        if past is None:  # before the first step all frames are empty
            past = torch.zeros_like(batch[:, :1]).expand(worlds, h + 1).clone()
            past["is_init"][:] = True
            with_history, steps_and_next = torch.cat([past[:, :h], batch], 1), batch
        else:
            with_history = torch.cat([past, batch], 1)
            steps_and_next = with_history[:, h:]
        past = with_history[:, -h - 1 :]
        yield _rollout(policy, scenario, with_history, steps_and_next, actor.state)
        frames, is_init = _frames(past[:, 1:] if h else past[:, :0])
        policy.resume(frames, is_init, actor.state, torch.arange(worlds * scenario.robots))


def _frames(steps: TensorDictBase) -> tuple[Frames, Tensor]:
    """Return the frames [B, T, ...] of steps [E, T] and where episodes begin, [B, T]."""
    frames = Observation.from_arrays(
        {name: steps[key].transpose(1, 2).flatten(0, 1) for name, key in FRAME_KEYS.items()}
    )
    robots = steps["agents", "active_mask"].shape[2]
    return frames, steps["is_init"][..., 0].repeat_interleave(robots, 0)


def _rollout(
    policy: StochasticPolicy,
    scenario: Scenario,
    with_history: TensorDictBase,
    steps: TensorDictBase,
    state: dict,
) -> Rollout:
    """Return the rollout of steps [E, T + 1]; `with_history` also has the h steps before them."""
    reward_parts = steps["next", "agents", "reward_parts"]
    collided, success = reward_parts["collision"][..., 0] != 0.0, steps["next", "success"]
    agents: Any = steps["agents"]
    after: Any = steps["next", "agents"]
    data = TensorDict(
        {
            "is_init": steps["is_init"],
            "mask": torch.ones_like(steps["is_init"]),
            ("agents", "active_mask"): agents["active_mask"][..., 0],
            ("agents", "action"): agents["unclipped_action"],
            ("agents", "sample_log_prob"): agents["sample_log_prob"],
            ("agents", "previous_noise"): agents["previous_noise"],
            ("agents", "speed"): agents["observation", "ego"][..., VELOCITY].norm(dim=-1),
            ("next", "done"): steps["next", "done"],
            ("next", "agents", "reward"): after["reward"][..., 0],
            ("next", "agents", "terminated"): (collided | success) & steps["next", "done"],
        },
        steps.batch_size,
    )
    frames, is_init = _frames(with_history)
    encoder = policy.memory(state)["encoder"]
    environment_steps = steps.shape[0] * (steps.shape[1] - 1)
    return Rollout(scenario, 0.0, data, frames, is_init, encoder, None, [], environment_steps)


def _parse() -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.collecting", description=(__doc__ or "").partition("\n")[0]
    )
    parser.add_argument(
        "--rounds",
        type=positive_whole_number,
        default=10,
        help="timed rounds (10)",
    )
    add_output(parser, "collecting")
    return parser.parse_args()


if __name__ == "__main__":
    main()
