"""The training loop: collect, update, average, validate, save."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import torch
from torch.optim.swa_utils import AveragedModel, get_ema_multi_avg_fn
from tqdm import tqdm

from mrsan.fields import check_numbers
from mrsan.threads import use_threads
from samarl import distributed
from samarl.errors import TrainingError
from samarl.files import code_version, machine
from samarl.launch import local_device, rank, world_size
from samarl.policies.card import BEST, LAST
from samarl.policies.checkpoint import attribute_errors_to, check_finite, save_policy
from samarl.policies.policy import Policy
from samarl.rollout import Rollout
from samarl.training.config import MAX_SEEDS, TrainerConfig, run_configuration
from samarl.training.curriculum import CurriculumStage
from samarl.training.device import keep_freed_memory, usable_device
from samarl.training.health import Health
from samarl.training.logging import Logger
from samarl.training.progress import Progress
from samarl.training.resume import check_same_run
from samarl.training.run_dir import STATE, RunDir
from samarl.training.setup import (
    build_algorithm,
    build_collectors,
    build_policy,
    load_initial_weights,
)
from samarl.training.state import gather_state, unflatten_state
from samarl.training.validation import validate


class Trainer:
    """A training run in a folder; several processes may train together."""

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
        """Set up a new run, or resume the run that is saved in the folder.

        Args:
            run_dir: folder of the run.
            config: settings of the run.
            policy: `name` and settings of the policy, with its encoder.
            algorithm: `name` and settings of the algorithm.
            stages: of the curriculum.
            command: command line that started the run, recorded as provenance.
            init_from: policy of the same sizes that provides the initial weights, except the
                exploration noise.

        Raises:
            ConfigurationError: a setting is not valid, the run in the folder has other settings, or
                there are several processes and the algorithm does not support them.
        """
        check_numbers(config, "trainer")
        self.config, self.stages = config, stages
        self.configuration = run_configuration(config, policy, algorithm, stages)
        self.provenance: dict[str, Any]
        self.provenance = {"command": command, "commit": code_version(), "machine": machine()}
        keep_freed_memory()
        use_threads(config.threads)
        torch.manual_seed(config.seed)
        self.policy_name = str(policy.get("name"))
        self.policy = build_policy(policy, stages[0].driver_scenario)
        if init_from is not None:
            self.provenance["init_from"] = load_initial_weights(self.policy, init_from)
        distributed.init_process_group(config.device)
        self.policy.to(usable_device(local_device(config.device)))
        self.averaged = AveragedModel(
            self.policy, multi_avg_fn=get_ema_multi_avg_fn(config.ema_decay)
        )
        self.algorithm = build_algorithm(algorithm, self.policy)
        if world_size() > 1:  # equal initial weights, but different noise
            torch.manual_seed(config.seed + MAX_SEEDS * rank())
        self.collectors = build_collectors(config, stages, self.policy, self.algorithm)
        self.progress = Progress()
        self.run_dir = RunDir(run_dir)
        if self.run_dir.has_checkpoint:
            self.load()
        for module in (self.policy, self.averaged, self.algorithm):
            distributed.broadcast_from_rank0(module.state_dict().values())

    @distributed.defer_stop_signals()
    def run(self) -> None:
        """Train to the end.

        Raises:
            KeyboardInterrupt: SIGINT or SIGTERM was received; the round was completed and saved.
            TrainingError: a gradient is not finite, or another process has ended.
            ConfigurationError: a file cannot be written.
        """
        c, progress = self.config, self.progress
        self.algorithm.set_progress(self.steps_done / c.steps)
        folder = self.run_dir.folder
        health = Health()
        for row in progress.rows:  # before this run was resumed
            health.update(row, row["steps"] / c.steps)
        logger = Logger(folder, c.wandb, self.configuration, self.steps_done, c.steps)
        with self._report_failure(), logger:
            while self.steps_done < c.steps:
                steps_before = self.steps_done
                row = self.round()
                finished = self.steps_done >= c.steps
                if rank() == 0 and (finished or progress.passed(c.validate_every, steps_before)):
                    row |= self.validate()
                progress.rows.append(row)
                logger.log(row, self.steps_done)
                for warning in health.update(row, self.steps_done / c.steps):
                    logger.write(f"warning: {warning}")
                stop = distributed.stop_requested()
                if stop or progress.passed(c.save_every, steps_before):
                    self.save()
                if stop:
                    raise KeyboardInterrupt
        self.save()
        for warning in health.warnings.values():
            logger.write(f"warning about this run: {warning}")

    def round(self) -> dict[str, float]:
        """Collect rollouts, update the networks and average the weights; return the statistics."""
        start_time = time.perf_counter()
        rollouts = self.collect()
        collected_time = time.perf_counter()
        statistics = self.algorithm.update(list(rollouts.values()))
        self.averaged.update_parameters(self.policy)
        row = self.progress.add_round(rollouts, statistics, start_time, collected_time)
        self.algorithm.set_progress(min(self.steps_done / self.config.steps, 1.0))
        return row

    def collect(self) -> dict[int, Rollout]:
        """Return the rollouts of the stages that take part in this round, by their numbers."""
        progress = self.steps_done / self.config.steps
        active = [i for i, stage in enumerate(self.stages) if stage.is_active(progress)]
        shaping, imitates = self.algorithm.reward_shaping, self.algorithm.imitates
        imitates &= any(collector.teacher is not None for collector in self.collectors)
        return {
            stage: self.collectors[stage].collect(shaping, imitates)
            for stage in self.progress.next_stages(active, self.config.least_participation)
        }

    @property
    def steps_done(self) -> int:
        """Environment steps so far, of all worlds together."""
        return self.progress.steps_done

    @property
    def averaged_policy(self) -> Policy:
        """The policy with averaged weights, which is validated and saved."""
        policy = self.averaged.module
        assert isinstance(policy, Policy)
        return policy

    def validate(self) -> dict[str, float]:
        """Validate the averaged policy, save it if it is the best, and return the statistics."""
        success, row = validate(self.averaged_policy, self.stages, self.config.validation_cases)
        figures = ", ".join(f"{key.split('/')[1]} {value:g}" for key, value in row.items())
        seconds = f"{self.progress.seconds:.0f} s"
        tqdm.write(f"step {self.steps_done}, {seconds}, validation: {figures}")
        if success > self.progress.best_success:
            self.progress.best_success = success
            self._save_policy(BEST, row)
        return row

    def save(self) -> None:
        """Write the state of all processes, the averaged policy and the learning curve."""
        state = self.state_dict()
        progress = {
            **state.pop("progress"),
            "configuration": self.configuration,
            "provenance": self.provenance,
            "world_size": world_size(),
        }
        tensors = gather_state(state)
        if rank() == 0:
            self.run_dir.save(tensors, progress)
            self._save_policy(LAST, {})

    def load(self) -> None:
        """Resume from the state in the folder.

        Raises:
            ConfigurationError: the state is damaged, or belongs to a run with other settings.
        """
        path = self.run_dir.folder / STATE
        tensors, progress = self.run_dir.load()
        with attribute_errors_to(path):
            check_same_run(progress, self.configuration, self.provenance, self.run_dir.folder)
            example = self.state_dict() | {"progress": {}}
            state = unflatten_state(example, tensors, self.algorithm.optimisers())
            for part in ("policy", "averaged"):
                check_finite(path, state[part])
            self.load_state_dict(state | {"progress": progress})
            self.provenance = progress["provenance"]

    def _save_policy(self, file_name: str, validation: dict[str, float]) -> None:
        """Write the averaged policy with its provenance and the statistics of its validation."""
        provenance = {
            **self.provenance,
            "steps": self.steps_done,
            "seconds": round(self.progress.seconds),
            "validation": validation,
            "configuration": self.configuration,
        }
        path = self.run_dir.folder / file_name
        save_policy(path, self.averaged_policy, self.policy_name, provenance)

    @contextlib.contextmanager
    def _report_failure(self) -> Iterator[None]:
        """Report failures of a round, with what was saved before.

        Raises:
            TrainingError: a gradient is not finite, or another process has ended.
        """
        try:
            yield
        except (FloatingPointError, distributed.LostProcessError) as error:
            folder, saved = self.run_dir.folder, self.run_dir.has_checkpoint
            outcome = f"{folder} holds the last save" if saved else f"nothing was saved in {folder}"
            if saved and isinstance(error, distributed.LostProcessError):
                outcome += ", from which the same command resumes"
            raise TrainingError(
                f"training stopped at step {self.steps_done}: {error}; {outcome}"
            ) from error

    def state_dict(self) -> dict[str, Any]:
        """Return all that the rest of the run depends on; `rankR` is only of this process."""
        optimisers = self.algorithm.optimisers()
        return {
            "policy": self.policy.state_dict(),
            "averaged": self.averaged.state_dict(),
            "algorithm": self.algorithm.state_dict(),
            "optimisers": {name: value.state_dict()["state"] for name, value in optimisers.items()},
            f"rank{rank()}": {
                "collectors": [collector.state_dict() for collector in self.collectors],
                "random_state": torch.get_rng_state(),
            },
            "progress": self.progress.state_dict(),
        }

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Continue from a state that `state_dict` returned."""
        self.policy.load_state_dict(state["policy"])
        self.averaged.load_state_dict(state["averaged"])
        self.algorithm.load_state_dict(state["algorithm"])
        for name, optimiser in self.algorithm.optimisers().items():
            param_groups = optimiser.state_dict()["param_groups"]
            moments = state["optimisers"][name]
            optimiser.load_state_dict({"state": moments, "param_groups": param_groups})
        process_state = state[f"rank{rank()}"]
        pairs = zip(self.collectors, process_state["collectors"], strict=True)
        for collector, collector_state in pairs:
            collector.load_state_dict(collector_state)
        torch.set_rng_state(process_state["random_state"])
        self.progress.load_state_dict(state["progress"])
