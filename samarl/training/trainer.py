"""The training loop: collect, update, validate, save; resumes after any interruption."""

from __future__ import annotations

import contextlib
import copy
import ctypes
import json
import time
from collections import deque
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor
from torch.optim.swa_utils import AveragedModel, get_ema_multi_avg_fn
from tqdm import tqdm

from mrsan import ConfigurationError, Split, social_score
from mrsan.fields import check_numbers, required, setting
from mrsan.threads import use_threads
from samarl import distributed
from samarl.agents.learned import DeployedPolicy
from samarl.algorithms import ALGORITHMS
from samarl.evaluation.runner import run_cases
from samarl.files import code_version, machine
from samarl.launch import local_device, per_process, rank, world_size
from samarl.observations.features import empty_frames
from samarl.policies.checkpoint import (
    attribute_errors_to,
    check_finite,
    load_policy,
    make_policy,
    pack,
    save_policy,
    unpack,
)
from samarl.policies.policy import Policy
from samarl.rollout import Rollout
from samarl.training.collector import RolloutCollector
from samarl.training.curriculum import CurriculumStage
from samarl.training.device import usable_device
from samarl.training.logging import Logger
from samarl.training.resume import check_same_run
from samarl.training.run_dir import BEST, LAST, STATE, RunDir

RESUME_OVERRIDABLE = ("threads", "wandb")  # of `TrainerConfig`: a run may go on with others
MOST_SEEDS = 2**20  # each has 2^20 training cases


@dataclass
class TrainerConfig:
    """Numbers of a training run."""

    steps: int = required(1, 10**12, help="environment steps, of all worlds together")
    rollout: int = required(1, 100000, help="steps per world between updates")
    seed: int = required(0, MOST_SEEDS - 1, help="seed of the weights, the noise and the cases")
    threads: int = required(1, 1024, help="threads of torch and the simulator in each process")
    validate_every: int = required(1, 10**12, help="environment steps between validations")
    validation_cases: int = required(1, 10**6, help="validation cases")
    save_every: int = required(1, 10**12, help="environment steps between checkpoints")
    ema_decay: float = required(
        0.0, 0.9999, help="decay of the moving average of the weights, per update"
    )
    device: str = setting("cpu", help="device of the networks; the simulation runs on the CPU")
    bfloat16: bool = setting(False, help="encode with bfloat16")
    compile: bool = setting(False, help="compile the encoders (needs a C++ compiler)")
    wandb: str | None = setting(None, help="project that also receives the TensorBoard curves")


class Trainer:
    """One training run in a folder, of one process or of several that train together."""

    def __init__(
        self,
        run_dir: Path,
        config: TrainerConfig,
        policy: Mapping[str, Any],
        algorithm: Mapping[str, Any],
        stages: list[CurriculumStage],
        command: str,
        init_from: Path | None = None,
    ) -> None:
        """Set up the run, from the saved state where the folder holds one.

        Args:
            run_dir: the folder: the state, the policies, `progress.csv`.
            config: the run's numbers.
            policy: `name` and numbers of the policy, with its encoder.
            algorithm: `name` and numbers of the algorithm.
            stages: what is trained on.
            command: what started it, for the record.
            init_from: a policy of the same sizes whose weights to begin with; how much is explored
                and what that policy does not have begin anew.

        Raises:
            ConfigurationError: a number is wrong, the saved state is of another configuration, or
                the algorithm cannot train in several processes and there are several.
        """
        check_numbers(config, "trainer")
        self.config, self.stages = config, stages
        self.name = str(policy.get("name"))
        _keep_freed_memory()
        use_threads(config.threads)
        torch.manual_seed(config.seed)
        sizes = {key: value for key, value in policy.items() if key != "name"}
        scenario = stages[0].scenario
        self.policy = make_policy(
            self.name, sizes, scenario.action_size, empty_frames(scenario).sizes
        )
        self.made: dict[str, Any] = {
            "command": command,
            "commit": code_version(),
            "machine": machine(),
        }
        if init_from is not None:
            self._load_initial_weights(init_from)
        distributed.init_process_group(config.device)
        self.policy.to(usable_device(local_device(config.device)))
        self.policy.low_precision = config.bfloat16
        self.averaged = AveragedModel(
            self.policy, multi_avg_fn=get_ema_multi_avg_fn(config.ema_decay)
        )
        self.mean.low_precision = False  # as it will be deployed
        if config.compile:
            for networks in self.policy.networks:
                encoder: Any = networks.encoder
                for part in ("observe", "read"):
                    setattr(encoder, part, torch.compile(getattr(encoder, part), dynamic=True))
        entry = ALGORITHMS[str(algorithm.get("name"))]
        if world_size() > 1:
            _check_averages(str(algorithm.get("name")))
        self.algorithm = entry.cls(self.policy, ALGORITHMS.config(algorithm))
        if world_size() > 1:  # the weights are the same so far, from here on chance is another
            torch.manual_seed(config.seed + MOST_SEEDS * rank())
        self.configuration = json.loads(
            json.dumps(
                {
                    "trainer": {**asdict(config), **dict.fromkeys(RESUME_OVERRIDABLE)},
                    "policy": dict(policy),
                    "algorithm": dict(algorithm),
                    "curriculum": {"stages": [asdict(stage) for stage in stages]},
                },
                default=str,
            )
        )
        self.collectors = self._collectors()
        self.steps_done = 0
        self.seconds = 0.0
        self.best = -1.0
        self.recent: deque[float] = deque(maxlen=2000)  # success of the last episodes
        self.rows: list[dict[str, float]] = []
        self.run_dir = RunDir(run_dir)
        if self.run_dir.has_checkpoint:
            self.restore()
        for module in (self.policy, self.averaged, self.algorithm):
            distributed.broadcast_from_rank0(module.state_dict().values())

    def _collectors(self) -> list[RolloutCollector]:
        """One for each stage, with training cases of its own."""
        first, collectors = self.config.seed * MOST_SEEDS, []
        cases = 2 * sum(stage.worlds for stage in self.stages)
        if cases > MOST_SEEDS:
            raise ConfigurationError(
                f"curriculum.stages has {cases // 2} worlds; it must have {MOST_SEEDS // 2} at most"
            )
        for index, stage in enumerate(self.stages):
            part = per_process(stage, f"curriculum.stages[{index}]", "worlds")
            collectors.append(
                RolloutCollector(
                    part,
                    self.policy,
                    self.config.rollout,
                    first + 2 * part.worlds * rank(),
                    self.algorithm.reward_shaping,
                    self.algorithm.uses_global_state,
                    self.algorithm.uses_shield_targets,
                )
            )
            first += 2 * stage.worlds
        return collectors

    @distributed.defer_stop_signals()
    def run(self) -> None:
        """Train to the end; Ctrl-C and SIGTERM stop it after a round, and nothing is lost."""
        c, first = self.config, rank() == 0
        self.algorithm.set_progress(self.steps_done / c.steps)
        logger = None
        if first:
            logger = Logger(self.run_dir.folder, c.wandb, self.configuration, self.steps_done)
        bar = tqdm(
            total=c.steps,
            initial=self.steps_done,
            unit="step",
            unit_scale=True,
            disable=None if first else True,
        )
        try:
            while self.steps_done < c.steps:
                before = self.steps_done
                row = self.round()
                due = self.steps_done // c.validate_every > before // c.validate_every
                if first and (due or self.steps_done >= c.steps):
                    row |= self._validate()
                self.rows.append(row)
                if logger is not None:
                    logger.log(row, self.steps_done)
                bar.set_postfix_str(f"success {100 * row['charts/success']:.1f} %")
                bar.update(self.steps_done - before)
                stops = distributed.stop_requested()
                if stops or self.steps_done // c.save_every > before // c.save_every:
                    self.save()
                if stops:
                    raise KeyboardInterrupt
        except (FloatingPointError, distributed.LostProcessError) as error:
            good = (
                "the last good state is kept"
                if self.run_dir.has_checkpoint
                else "nothing was saved"
            )
            lost = self.run_dir.has_checkpoint and isinstance(error, distributed.LostProcessError)
            raise ConfigurationError(
                f"training stopped at step {self.steps_done}: {error}; {good} in "
                f"{self.run_dir.folder}{', from which the same command goes on' if lost else ''}"
            ) from error
        finally:
            bar.close()
            if logger is not None:
                logger.close()
        self.save()

    def round(self) -> dict[str, float]:
        """Collect one rollout of every stage that is trained on now, and learn from them."""
        begun = time.perf_counter()
        rollouts = self.collect()
        collected = time.perf_counter()
        statistics = self.algorithm.update(rollouts)
        self.averaged.update_parameters(self.policy)
        ended = [episodes for rollout in rollouts for episodes in rollout.episodes]
        successes = [float(success) for episodes in ended for success in episodes.success]
        gathered = distributed.all_gather_object((successes, statistics))
        steps = world_size() * sum(rollout.environment_steps for rollout in rollouts)
        self.steps_done += steps
        self.algorithm.set_progress(min(self.steps_done / self.config.steps, 1.0))
        took = time.perf_counter() - begun
        self.seconds += took
        for successes, _ in gathered:
            self.recent.extend(successes)
        means = _means(of_process for _, of_process in gathered)
        return {
            "steps": float(self.steps_done),
            "seconds": round(self.seconds, 1),
            "charts/steps_per_second": round(steps / took, 1),
            "charts/collect_share": round((collected - begun) / took, 3),
            "charts/success": round(float(np.mean(self.recent or [0.0])), 4),
            **{key: round(value, 6) for key, value in means.items()},
        }

    def collect(self) -> list[Rollout]:
        """One rollout of every stage that is trained on now."""
        share = self.steps_done / self.config.steps
        return [
            collector.collect()
            for stage, collector in zip(self.stages, self.collectors, strict=True)
            if stage.begin <= share < stage.end
        ]

    @property
    def mean(self) -> Policy:
        """The policy with the mean of the weights, which is validated and saved."""
        policy = self.averaged.module
        assert isinstance(policy, Policy)
        return policy

    def _load_initial_weights(self, init_from: Path) -> None:
        weights, card = load_policy(init_from)
        given = weights.state_dict()
        begun = self.policy.state_dict()
        anew = {name: value for name, value in begun.items() if "log_std" in name}
        try:
            self.policy.load_state_dict({**given, **anew})
        except RuntimeError as error:
            raise ConfigurationError(
                f"init_from is {str(init_from)!r} with {card.config}; its sizes must be those of "
                "this run's policy"
            ) from error
        self.made["init_from"] = {"sha256": card.sha256, **card.provenance}

    def _validate(self) -> dict[str, float]:
        """Deterministic success on validation cases with all people present; keeps the best.

        Only the scenarios that the training ends with count.
        """
        cases = Split.validation.case(0) + np.arange(self.config.validation_cases)
        row: dict[str, float] = {}
        successes = []
        policy = copy.deepcopy(self.mean).cpu().eval()
        for stage in self.stages:
            if stage.end < 1.0:
                continue
            full = replace(stage.scenario, humans_min=None)
            name = f"{full.fov_degrees:g}_{full.humans}h_{full.robots}r"
            name += "_team" if full.team_tracks else ""
            if f"validation/success_{name}" in row:
                continue
            episodes = run_cases(
                DeployedPolicy(policy, full), full, cases, len(cases), "validation"
            )
            successes.append(float(episodes.success.mean()))
            row[f"validation/success_{name}"] = round(successes[-1], 4)
            row[f"validation/social_score_{name}"] = round(float(social_score(episodes).mean()), 2)
        figures = ", ".join(f"{key.split('/')[1]} {value:g}" for key, value in row.items())
        tqdm.write(f"step {self.steps_done}, {self.seconds:.0f} s, validation: {figures}")
        if np.mean(successes) > self.best:
            self.best = float(np.mean(successes))
            self._save_policy(BEST, row)
        return row

    def _save_policy(self, name: str, validation: dict[str, float]) -> None:
        made = {
            **self.made,
            "steps": self.steps_done,
            "seconds": round(self.seconds),
            "validation": validation,
            "configuration": self.configuration,
        }
        save_policy(self.run_dir.folder / name, self.mean, self.name, made)

    def _shared_state(self) -> dict[str, Any]:
        return {
            "policy": dict(self.policy.state_dict()),
            "averaged": dict(self.averaged.state_dict()),
            "algorithm": dict(self.algorithm.state_dict()),
        }

    def _own_state(self, number: int) -> dict[str, Any]:
        """What each process has of its own, by names that tell the processes apart."""
        prefix = f"process {number}/" if number else ""
        return {
            f"{prefix}random": torch.get_rng_state(),
            f"{prefix}collectors": [collector.state_dict() for collector in self.collectors],
        }

    def save(self) -> None:
        """Write the state of all processes, the last policy and the curve."""
        tensors: dict[str, Tensor] = {}
        for own in distributed.gather_to_rank0(_packed(self._own_state(rank()))):
            tensors |= own
        if rank() > 0:
            return
        tensors |= _packed(self._shared_state())
        for name, optimiser in self.algorithm.optimisers().items():
            for index, values in optimiser.state_dict()["state"].items():
                for key, value in values.items():
                    tensors[f"optimiser/{name}/{index}/{key}"] = value
        progress = {
            "steps_done": self.steps_done,
            "seconds": self.seconds,
            "best": self.best,
            "recent": list(self.recent),
            "rows": self.rows,
            "made": self.made,
            "processes": world_size(),
            "configuration": self.configuration,
        }
        self.run_dir.save(tensors, progress)
        self._save_policy(LAST, {})

    def restore(self) -> None:
        """Resume from the state in the folder.

        Raises:
            ConfigurationError: the state is damaged, or of a run with other settings.
        """
        path = self.run_dir.folder / STATE
        tensors, progress = self.run_dir.load()
        with attribute_errors_to(path):
            check_same_run(progress, self.configuration, self.made, self.run_dir.folder)
            self._load_state(path, tensors, progress)

    def _load_state(
        self, path: Path, tensors: Mapping[str, Tensor], progress: Mapping[str, Any]
    ) -> None:
        own = self._own_state(rank())
        state = {
            key.rpartition("/")[2]: unpack(example, key, tensors)
            for key, example in (self._shared_state() | own).items()
        }
        for key in ("policy", "averaged"):
            check_finite(path, state[key])
        self.policy.load_state_dict(state["policy"])
        self.averaged.load_state_dict(state["averaged"])
        self.algorithm.load_state_dict(state["algorithm"])
        for name, optimiser in self.algorithm.optimisers().items():
            found: dict[int, dict[str, Tensor]] = {}
            for key, value in tensors.items():
                if key.startswith(f"optimiser/{name}/"):
                    _, _, index, of = key.split("/")
                    found.setdefault(int(index), {})[of] = value.clone()
            _check_moments(found, optimiser)
            groups = optimiser.state_dict()["param_groups"]
            optimiser.load_state_dict({"state": found, "param_groups": groups})
        for collector, saved in zip(self.collectors, state["collectors"], strict=True):
            collector.load_state_dict(saved)
        torch.set_rng_state(state["random"])
        self.steps_done, self.seconds = int(progress["steps_done"]), float(progress["seconds"])
        self.best, self.rows = float(progress["best"]), [dict(row) for row in progress["rows"]]
        self.recent.extend(map(float, progress["recent"]))
        self.made = progress["made"]


def _check_averages(algorithm: str) -> None:
    good = [name for name in ALGORITHMS if ALGORITHMS[name].cls.supports_data_parallel]
    if algorithm not in good:
        raise ConfigurationError(
            f"algorithm.name is {algorithm!r}; with several processes it must be one that averages "
            f"its gradients: {', '.join(good)}"
        )


def _packed(state: Mapping[str, Any]) -> dict[str, Tensor]:
    tensors: dict[str, Tensor] = {}
    for key, value in state.items():
        tensors |= pack(key, value)
    return tensors


def _means(statistics: Iterable[Mapping[str, float]]) -> dict[str, float]:
    """Of each statistic, the mean over the processes that have it."""
    found: dict[str, list[float]] = {}
    for of_process in statistics:
        for key, value in of_process.items():
            found.setdefault(key, []).append(value)
    return {key: sum(values) / len(values) for key, values in found.items()}


def _check_moments(
    found: Mapping[int, Mapping[str, Tensor]], optimiser: torch.optim.Optimizer
) -> None:
    """Refuse an optimiser's state that is not of its parameters; it does not look itself."""
    parameters = [p for group in optimiser.param_groups for p in group["params"]]
    for index, moments in found.items():
        for name, value in moments.items():
            if value.dim() and value.shape != parameters[index].shape:
                raise ValueError(f"{name} of parameter {index} has shape {list(value.shape)}")


def _keep_freed_memory() -> None:
    """Let glibc keep what is freed for the next tensor of that size.

    Large tensors would otherwise go back to the system every time, and zeroing their pages anew
    costs a third of an update. Nothing happens with another C library.
    """
    trim_threshold, mmap_threshold, most = -1, -3, 2**30
    with contextlib.suppress(OSError, AttributeError):
        mallopt = ctypes.CDLL("libc.so.6").mallopt
        mallopt(mmap_threshold, most)
        mallopt(trim_threshold, most)
