"""The training loop: collect, update, validate, save; resumes after any interruption."""

from __future__ import annotations

import copy
import csv
import io
import json
import time
from collections import deque
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numba
import numpy as np
import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import load_file
from torch import Tensor
from torch.optim.swa_utils import AveragedModel, get_ema_multi_avg_fn
from torch.utils.tensorboard import SummaryWriter
from tqdm import tqdm

from mrsan import ConfigurationError, Split, social_score
from mrsan.scenario import check_numbers, required
from samarl.agents.learned import Deployed
from samarl.algorithms.mappo import MAPPO, Learner
from samarl.evaluation.files import code_version, machine, write_atomically
from samarl.evaluation.runner import run_cases
from samarl.policies.checkpoint import load_policy, pack, save_policy, unpack, write_tensors
from samarl.policies.hierarchical import Architecture, HierarchicalPolicy
from samarl.training.curriculum import Group
from samarl.training.rollout import Batch, Rollout

STATE = "state.safetensors"  # everything that is needed to go on
LAST, BEST = "last.safetensors", "best.safetensors"  # policies
FREE = ("threads", "wandb")  # of `Training`: a run may go on with others


@dataclass
class Training:
    """Knobs of a training run."""

    steps: int = required(1, 10**12)  # environment steps in all worlds together
    rollout: int = required(1, 100000)  # steps per world between updates
    seed: int = required(0, 2**31)
    threads: int = required(1, 1024)  # of torch and the simulator
    validate_every: int = required(1, 10**12)  # environment steps
    validation_cases: int = required(1, 10**6)
    save_every: int = required(1, 10**12)  # environment steps
    averaging: float = required(0.0, 0.9999)  # decay, per update, of the mean of the weights
    waypoint_progress: float = required(0.0, 100.0)  # reward per metre, local level
    device: str = "cpu"  # of the networks; the simulation is always on the CPU
    bfloat16: bool = False  # encode with bfloat16
    compile: bool = False  # compile the encoders (needs a C++ compiler)
    wandb: str | None = None  # project to which the TensorBoard curves are sent as well

    def __post_init__(self) -> None:
        """Check every number."""
        check_numbers(self, "training")


class Trainer:
    """One training run in a folder."""

    def __init__(
        self,
        folder: Path,
        training: Training,
        architecture: Architecture,
        mappo: MAPPO,
        groups: list[Group],
        command: str,
        initial: Path | None = None,
    ) -> None:
        """Set up the run, from the saved state where the folder holds one.

        Args:
            folder: of the run: the state, the policies, `progress.csv`.
            training: its knobs.
            architecture: of the policy.
            mappo: the knobs of the update.
            groups: what is trained on.
            command: what started it, for the record.
            initial: a policy of the same architecture whose weights to begin with; how much is
                explored begins anew.

        Raises:
            ConfigurationError: the saved state belongs to another configuration.
        """
        self.folder, self.training, self.groups = folder, training, groups
        torch.set_num_threads(training.threads)
        numba.set_num_threads(min(training.threads, numba.config.NUMBA_NUM_THREADS))
        torch.manual_seed(training.seed)
        self.policy = HierarchicalPolicy(architecture, groups[0].scenario.action_size)
        self.made: dict[str, Any] = {
            "command": command, "commit": code_version(), "machine": machine()
        }  # fmt: skip
        if initial is not None:
            self._begin_with(initial)
        self.policy.to(_device(training.device))
        self.policy.low_precision = training.bfloat16
        if training.compile:
            self.policy.encoder.compile(dynamic=True)
            self.policy.critic_encoder.compile(dynamic=True)
        self.averaged = AveragedModel(
            self.policy, multi_avg_fn=get_ema_multi_avg_fn(training.averaging)
        )
        self.learner = Learner(self.policy, mappo)
        self.rollouts = [
            Rollout(
                group,
                self.policy,
                training.rollout,
                (training.seed << 20) + 4096 * i,
                mappo.local_discount,
                training.waypoint_progress,
            )
            for i, group in enumerate(groups)
        ]
        self.steps_done = 0
        self.seconds = 0.0
        self.best = -1.0
        self.recent: deque[float] = deque(maxlen=2000)  # success of the last episodes
        self.rows: list[dict[str, float]] = []
        self.configuration = json.loads(
            json.dumps(
                {
                    "training": {**asdict(training), **dict.fromkeys(FREE)},
                    "architecture": asdict(architecture),
                    "mappo": asdict(mappo),
                    "groups": [asdict(group) for group in groups],
                },
                default=str,
            )
        )
        if (folder / STATE).exists():
            self._restore()

    def run(self) -> None:
        """Train to the end; an interruption loses at most `save_every` steps."""
        t = self.training
        self.learner.set_progress(self.steps_done / t.steps)
        writer = self._writer()
        bar = tqdm(
            total=t.steps, initial=self.steps_done, unit="step", unit_scale=True, disable=None
        )
        try:
            while self.steps_done < t.steps:
                begun = time.perf_counter()
                batches = self.collect()
                collected = time.perf_counter()
                statistics = self.learner.update(batches)
                self.averaged.update_parameters(self.policy)
                before = self.steps_done
                per_round = sum(batch.environment_steps for batch in batches)
                self.steps_done += per_round
                self.learner.set_progress(min(self.steps_done / t.steps, 1.0))
                self.seconds += time.perf_counter() - begun
                for batch in batches:
                    for episodes in batch.episodes:
                        self.recent.extend(episodes.success.astype(float))
                row = {
                    "steps": float(self.steps_done),
                    "seconds": round(self.seconds, 1),
                    "charts/steps_per_second": round(per_round / (time.perf_counter() - begun), 1),
                    "charts/collect_share": round(
                        (collected - begun) / (time.perf_counter() - begun), 3
                    ),
                    "charts/success": round(float(np.mean(self.recent or [0.0])), 4),
                    **{key: round(value, 6) for key, value in statistics.items()},
                }
                due = self.steps_done // t.validate_every > before // t.validate_every
                if due or self.steps_done >= t.steps:
                    row |= self._validate()
                self.rows.append(row)
                for key, value in row.items():
                    writer.add_scalar(key, value, self.steps_done)
                bar.set_postfix_str(f"success {100 * row['charts/success']:.1f} %")
                bar.update(per_round)
                if self.steps_done // t.save_every > before // t.save_every:
                    self.save()
        except FloatingPointError as error:
            state = self.folder / STATE
            good = f"the last good checkpoint is {state}" if state.exists() else "none was saved"
            raise ConfigurationError(
                f"training stopped at step {self.steps_done}: {error}; {good}"
            ) from error
        except KeyboardInterrupt:
            self.save()
            raise
        finally:
            bar.close()
            writer.close()
        self.save()

    @property
    def mean(self) -> HierarchicalPolicy:
        """The policy with the mean of the weights, which is validated and saved."""
        policy = self.averaged.module
        assert isinstance(policy, HierarchicalPolicy)
        return policy

    def collect(self) -> list[Batch]:
        """One rollout of every group that is trained on now."""
        share = self.steps_done / self.training.steps
        return [
            rollout.collect()
            for group, rollout in zip(self.groups, self.rollouts, strict=True)
            if group.begin <= share < group.end
        ]

    def _writer(self) -> SummaryWriter:
        """TensorBoard's curves; what an interrupted run wrote after its last save is dropped."""
        if self.training.wandb is not None:
            try:
                import wandb
            except ImportError as error:
                raise ConfigurationError(
                    f"training.wandb is {self.training.wandb!r}; it needs: pip install wandb"
                ) from error
            wandb.init(
                project=self.training.wandb,
                name=self.folder.name,
                dir=self.folder,
                config=self.configuration,
                sync_tensorboard=True,
            )
        purge = self.steps_done + 1 if self.steps_done else None
        return SummaryWriter(str(self.folder / "tensorboard"), purge_step=purge)

    def _begin_with(self, initial: Path) -> None:
        weights, card = load_policy(initial)
        anew = {k: v for k, v in self.policy.state_dict().items() if k.endswith("log_deviation")}
        try:
            self.policy.load_state_dict({**weights.state_dict(), **anew})
        except RuntimeError as error:
            raise ConfigurationError(
                f"initial is {str(initial)!r} with {card.architecture}; its sizes must be those of "
                "this run's architecture"
            ) from error
        self.made["initial"] = {"sha256": card.sha256, **card.made}

    def _validate(self) -> dict[str, float]:
        """Deterministic success on validation cases with all people present; keeps the best.

        Only the scenarios that the training ends with count.
        """
        cases = Split.validation.case(0) + np.arange(self.training.validation_cases)
        row: dict[str, float] = {}
        successes = []
        for group in self.groups:
            if group.end < 1.0:
                continue
            full = replace(group.scenario, humans_min=None)
            agent = Deployed(copy.deepcopy(self.mean).cpu(), full)
            episodes = run_cases(agent, full, cases, len(cases), "validation")
            name = f"{full.fov_degrees:g}_{full.humans}h_{full.robots}r"
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
        save_policy(self.folder / name, self.mean, "hierarchical", made)

    def _state(self) -> dict[str, Any]:
        optimiser = self.learner.optimiser.state_dict()["state"]
        return {
            "policy": dict(self.policy.state_dict()),
            "averaged": dict(self.averaged.state_dict()),
            "macro_values": dict(self.learner.macro.values.state_dict()),
            "local_values": dict(self.learner.local.values.state_dict()),
            "optimiser": {str(key): value for key, value in optimiser.items()},
            "random": torch.get_rng_state(),
            "rollouts": [rollout.state() for rollout in self.rollouts],
        }

    def save(self) -> None:
        """Write the state, the last policy and the curve."""
        tensors: dict[str, Tensor] = {}
        pack("", self._state(), tensors)
        progress = {
            "steps_done": self.steps_done,
            "seconds": self.seconds,
            "best": self.best,
            "recent": list(self.recent),
            "rows": self.rows,
            "made": self.made,
            "configuration": self.configuration,
        }
        write_tensors(self.folder / STATE, tensors, {"progress": json.dumps(progress)})
        self._save_policy(LAST, {})
        keys = list(dict.fromkeys(key for row in self.rows for key in row))
        text = io.StringIO()
        writer = csv.DictWriter(text, keys, lineterminator="\n")
        writer.writeheader()
        writer.writerows(self.rows)
        write_atomically(self.folder / "progress.csv", text.getvalue())

    def _restore(self) -> None:
        progress = _read_progress(self.folder)
        if progress["configuration"] != self.configuration:
            raise ConfigurationError(
                f"{self.folder / STATE} was written by another configuration; choose another "
                f"folder, or go on with its own: resume={self.folder}"
            )
        tensors = load_file(self.folder / STATE)
        optimiser: dict[int, dict[str, Tensor]] = {}
        for key, value in tensors.items():
            if key.startswith("optimiser/"):
                _, index, name = key.split("/")
                optimiser.setdefault(int(index), {})[name] = value
        example = {**self._state(), "optimiser": {}}
        state = unpack(example, "", {f"/{key}": value for key, value in tensors.items()})
        self.policy.load_state_dict(state["policy"])
        self.averaged.load_state_dict(state["averaged"])
        self.learner.macro.values.load_state_dict(state["macro_values"])
        self.learner.local.values.load_state_dict(state["local_values"])
        groups = self.learner.optimiser.state_dict()["param_groups"]
        self.learner.optimiser.load_state_dict({"state": optimiser, "param_groups": groups})
        for rollout, values in zip(self.rollouts, state["rollouts"], strict=True):
            rollout.restore(values)
        torch.set_rng_state(state["random"])
        self.steps_done, self.seconds = progress["steps_done"], progress["seconds"]
        self.best, self.rows = progress["best"], progress["rows"]
        self.recent.extend(progress["recent"])
        self.made = progress["made"]


def own_settings(folder: Path) -> dict[str, Any]:
    """The configuration with which the run in a folder was begun.

    Raises:
        ConfigurationError: the folder holds no run, or a damaged one.
    """
    if not (folder / STATE).is_file():
        raise ConfigurationError(
            f"resume is {str(folder)!r}; it must be the folder of a run, which holds {STATE}"
        )
    configuration: dict[str, Any] = _read_progress(folder)["configuration"]
    return configuration


def _read_progress(folder: Path) -> dict[str, Any]:
    path = folder / STATE
    try:
        with safe_open(path, "pt") as file:
            progress: dict[str, Any] = json.loads(file.metadata()["progress"])
            return progress
    except (SafetensorError, KeyError, ValueError, TypeError) as error:
        raise ConfigurationError(f"{path} is damaged ({error})") from error


def _device(name: str) -> torch.device:
    try:
        device = torch.device(name)
        torch.empty(0, device=device)
    except (RuntimeError, AssertionError) as error:
        reason = str(error).splitlines()[0]
        raise ConfigurationError(
            f"training.device is {name!r}; it must be a torch device of this machine ({reason})"
        ) from error
    return device
