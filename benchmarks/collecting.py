"""Our rollouts and those of TorchRL's collector, in turns: `python -m benchmarks.collecting`.

The same policy explores in the same number of worlds. What TorchRL's collector gathers is put into
the same `Rollout`, so a learner cannot tell them apart; it cannot take worlds back in time.
"""

from __future__ import annotations

import argparse
import statistics
import tempfile
import time
from collections.abc import Iterator
from typing import Any

import numpy as np
import torch
from tensordict import TensorDict, TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torch import Tensor
from torchrl.collectors import Collector
from torchrl.envs import InitTracker, TransformedEnv
from tqdm import trange

from benchmarks.training import default_trainer
from benchmarks.workload import add_output, interruptible, made_by, positive_whole_number
from mrsan import Observation
from mrsan.features import VELOCITY
from mrsan.scenario import Scenario
from mrsan.torchrl_env import TorchRLEnv
from samarl.files import write_json
from samarl.observations.frames import Frames
from samarl.policies.policy import LOCAL
from samarl.policies.stochastic import StochasticPolicy
from samarl.rollout import Rollout
from samarl.training.collector import RolloutCollector
from samarl.training.curriculum import CurriculumStage

WORLDS, STEPS = 96, 32
SEEN = [("agents", "observation", name) for name in Observation._fields[:5]]  # nothing is told
KNOWN = [("agents", "known", name) for name in Frames._fields]


def main() -> None:
    """Measure, print the figures, write the JSON."""
    arguments = _parse()
    scenario = Scenario()
    with tempfile.TemporaryDirectory() as folder:
        policy = default_trainer(["policy=flat", f"run_dir={folder}"]).policy
    assert isinstance(policy, StochasticPolicy)
    stage = CurriculumStage(WORLDS, scenario=scenario)
    ours = RolloutCollector(stage, policy, STEPS, 0, central=False)
    theirs = torchrl_rollouts(policy, scenario, WORLDS, STEPS, arguments.rounds + 1)
    seconds: dict[str, list[float]] = {"samarl": [], "torchrl": []}
    with interruptible():
        for number in trange(arguments.rounds + 1, desc="collecting", unit="round", disable=None):
            for name, collect in (("samarl", ours.collect), ("torchrl", lambda: next(theirs))):
                begun = time.perf_counter()
                collect()
                if number > 0:  # the first one compiles and warms up
                    seconds[name].append(time.perf_counter() - begun)
    rates = {name: WORLDS * STEPS / statistics.median(taken) for name, taken in seconds.items()}
    result: dict[str, Any] = {
        "world_steps_per_second": {name: round(rate, 1) for name, rate in rates.items()},
        "times_as_fast": round(rates["samarl"] / rates["torchrl"], 2),
        **made_by("collecting"),
    }
    write_json(arguments.output, result)
    for name, rate in rates.items():
        print(f"{name}: {rate:,.0f} world-steps a second")
    print(f"written to {arguments.output}")


class Actor(TensorDictModuleBase):
    """A policy as TorchRL drives one: it explores, and notes what a learner needs."""

    def __init__(self, policy: StochasticPolicy, scenario: Scenario, worlds: int) -> None:
        super().__init__()
        self.policy, self.scenario = policy, scenario
        self.state = policy.initial_state(worlds, scenario)
        self.in_keys = [*SEEN, ("agents", "active_mask"), "is_init"]
        noted = ("action", "chosen", "sample_log_prob", "noise")
        self.out_keys = [*(("agents", name) for name in noted), *KNOWN]

    def forward(self, step: TensorDictBase) -> TensorDictBase:
        """Decide for all robots of all worlds."""
        nothing = np.empty((*step["agents", "active_mask"].shape[:2], 0), np.bool_)
        seen = (step[key].numpy() for key in SEEN)
        observation = Observation._make((*seen, nothing, nothing))
        began, active = step["is_init"][:, 0].numpy(), step["agents", "active_mask"][..., 0]
        decision = self.policy.act(
            observation, self.state, began, self.scenario, 0.0, active.numpy()
        )
        level = decision.levels[LOCAL]
        step["agents", "action"] = torch.from_numpy(decision.action)  # what is driven
        step["agents", "chosen"], step["agents", "sample_log_prob"] = level.action, level.log_prob
        step["agents", "noise"] = decision.step.previous_noise
        for key, tensor in zip(KNOWN, decision.features, strict=True):
            step[key] = tensor.view(*active.shape, *tensor.shape[2:])
        return step


def torchrl_rollouts(
    policy: StochasticPolicy, scenario: Scenario, worlds: int, steps: int, total: int
) -> Iterator[Rollout]:
    """`total` rollouts of T steps in E worlds by TorchRL's collector, without the true state.

    The policy may be trained between them. It must be flat, which is paid what the task pays, and
    its encoder must remember nothing but the last frames.
    """
    env = TransformedEnv(TorchRLEnv(scenario, worlds, seed=0), InitTracker())
    actor = Actor(policy, scenario, worlds)
    size = worlds * steps
    batches = Collector(env, actor, frames_per_batch=size, total_frames=total * size)
    h = policy.history
    past: Any = None  # the last h + 1 steps of the batch before
    for batch in batches:
        if past is None:  # nothing was known before the first step
            past = torch.zeros_like(batch[:, :1]).expand(worlds, h + 1).clone()
            past["is_init"][:] = True
            shown, last = torch.cat([past[:, :h], batch], 1), batch
        else:
            shown = torch.cat([past, batch], 1)
            last = shown[:, h:]
        past = shown[:, -h - 1 :]
        yield _rollout(policy, scenario, shown, last, actor.state)
        frames, begins = _known(past[:, 1:] if h else past[:, :0])
        policy.resume(frames, begins, actor.state, torch.arange(worlds * scenario.robots))


def _known(steps: TensorDictBase) -> tuple[Frames, Tensor]:
    """The frames [B, T, ...] of steps [E, T], and where episodes begin, [B, T]."""
    frames = Frames(*(steps[key].transpose(1, 2).flatten(0, 1) for key in KNOWN))
    robots = steps["agents", "active_mask"].shape[2]
    return frames, steps["is_init"][..., 0].repeat_interleave(robots, 0)


def _rollout(
    policy: StochasticPolicy,
    scenario: Scenario,
    shown: TensorDictBase,
    steps: TensorDictBase,
    state: dict,
) -> Rollout:
    """Of all that is shown, [E, h + T + 1], and of the steps, [E, T + 1]."""
    paid = steps["next", "agents", "reward_parts"]
    collided, over = paid["collision"][..., 0] != 0.0, steps["next", "success"]
    agents: Any = steps["agents"]
    after: Any = steps["next", "agents"]
    found = TensorDict(
        {
            "is_init": steps["is_init"],
            "mask": torch.ones_like(steps["is_init"]),
            ("agents", "active_mask"): agents["active_mask"][..., 0],
            ("agents", "action"): agents["chosen"],
            ("agents", "sample_log_prob"): agents["sample_log_prob"],
            ("agents", "noise"): agents["noise"],
            ("agents", "speed"): agents["observation", "ego"][..., VELOCITY].norm(dim=-1),
            ("next", "done"): steps["next", "done"],
            ("next", "agents", "reward"): after["reward"][..., 0],
            ("next", "agents", "team_reward"): paid["team"][..., 0],
            ("next", "agents", "terminated"): (collided | over) & steps["next", "done"],
        },
        steps.batch_size,
    )
    frames, begins = _known(shown)
    encoder = policy.memory(state)["encoder"]
    taken = steps.shape[0] * (steps.shape[1] - 1)
    return Rollout(scenario, 0.0, found, frames, begins, encoder, None, [], taken)


def _parse() -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.collecting", description=(__doc__ or "").partition("\n")[0]
    )
    parser.add_argument("--rounds", type=positive_whole_number, default=10, help="timed (10)")
    add_output(parser, "collecting")
    return parser.parse_args()


if __name__ == "__main__":
    main()
