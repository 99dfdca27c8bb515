"""Policy files: safetensors and JSON, written atomically and without pickle.

A policy consists of two files: `NAME.safetensors` holds the weights, and the card `NAME.json` holds
the name of the class, its configuration, the provenance, and a digest of the weights. Class names
are only looked up in `POLICIES`, so loading a file never executes code from it.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
from collections.abc import Iterator, Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any, TypeGuard

from safetensors import SafetensorError, safe_open
from safetensors.torch import load_file, save
from torch import Tensor, nn
from torch.nn.modules.module import register_module_parameter_registration_hook
from torch.optim import Optimizer

from mrsan import ConfigurationError
from mrsan.choices import ACTION_SIZE
from samarl.files import atomic_write, write_json
from samarl.observations.frames import FeatureSizes
from samarl.policies import (  # noqa: F401 (registers them)
    flat,
    hierarchical,
    lookahead,
    squashed,
)
from samarl.policies.card import FORMAT, PolicyCard, find_policy, read_card
from samarl.policies.policy import POLICIES, Policy

LARGEST_SIZE = 4096  # of a group of features


def feature_sizes(card: PolicyCard) -> FeatureSizes | None:
    """Return what a policy observes; None: people and robots.

    Raises:
        ConfigurationError: the card holds something else.
    """
    sizes = card.sizes
    if not sizes:
        return None
    ego, entities, sensors = (sizes.get(part) for part in ("ego", "entities", "sensors"))
    if (
        _is_size(ego)
        and isinstance(entities, dict)
        and isinstance(sensors, dict)
        and {"humans", "robots"} <= entities.keys()
        and all(map(_is_size, entities.values()))
        and all(isinstance(shape, list) and all(map(_is_size, shape)) for shape in sensors.values())
    ):
        shapes = {name: tuple(shape) for name, shape in sensors.items()}
        return FeatureSizes(ego, entities, shapes)
    raise ConfigurationError(
        f"sizes is {sizes!r:.100}; it must have `ego`, `entities` with humans and robots, "
        f"and `sensors`, with sizes from 1 to {LARGEST_SIZE}"
    )


def _is_size(value: Any) -> TypeGuard[int]:
    return type(value) is int and 1 <= value <= LARGEST_SIZE


def write_tensors(path: Path, tensors: dict[str, Tensor], metadata: dict[str, str]) -> str:
    """Write tensors atomically; return the digest of the file."""
    content = save({name: value.contiguous().cpu() for name, value in tensors.items()}, metadata)
    with atomic_write(path) as temporary, temporary.open("wb") as file:
        file.write(content)
        file.flush()
        os.fsync(file.fileno())
    return hashlib.sha256(content).hexdigest()


def save_learner(
    path: Path,
    networks: Mapping[str, nn.Module],
    optimiser: Optimizer,
    run: str,
    progress: tuple[str, int],
) -> None:
    """Write atomically what a learner needs to go on after an interruption.

    Args:
        path: file.
        networks: by name.
        optimiser: of all their parameters.
        run: digest of the configuration.
        progress: what is counted, such as "steps", and how many are done.
    """
    tensors = {
        f"{name}/{key}": value
        for name, network in networks.items()
        for key, value in network.state_dict().items()
    }
    for number, moments in optimiser.state_dict()["state"].items():
        tensors |= {f"optimiser/{number}/{name}": value for name, value in moments.items()}
    counted, done = progress
    write_tensors(path, tensors, {"run": run, counted: str(done)})


def restore_learner(
    path: Path, networks: Mapping[str, nn.Module], optimiser: Optimizer, run: str, counted: str
) -> int:
    """Load what `save_learner` wrote; return how many steps, or what else is counted, are done.

    Raises:
        ConfigurationError: the file is damaged, or belongs to another training run.
    """
    with attribute_errors_to(path), safe_open(path, "pt") as file:
        saved = {"run": "", **(file.metadata() or {})}
        tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118
    if saved["run"] != run:
        raise ConfigurationError(
            f"{path} belongs to another training run; choose another output, or remove it"
        )
    weights: dict[str, dict[str, Tensor]] = {name: {} for name in networks}
    moments: dict[int, dict[str, Tensor]] = {}
    with attribute_errors_to(path):
        for name, value in tensors.items():
            part, _, key = name.partition("/")
            if part == "optimiser":
                number, moment = key.split("/")
                moments.setdefault(int(number), {})[moment] = value
            else:
                weights[part][key] = value
        for name, network in networks.items():
            check_finite(path, weights[name])
            network.load_state_dict(weights[name])
        groups = optimiser.state_dict()["param_groups"]
        optimiser.load_state_dict({"state": moments, "param_groups": groups})
        return int(saved[counted])


def save_policy(path: Path, policy: Policy, name: str, provenance: dict[str, Any]) -> None:
    """Write the weights to `path`, which ends in `.safetensors`, and the card next to it."""
    digest = write_tensors(path, dict(policy.state_dict()), {})
    card = PolicyCard(
        name,
        policy.action_size,
        asdict(policy.config),
        provenance,
        digest,
        json.loads(json.dumps(asdict(policy.sizes))),
    )
    write_json(path.with_suffix(".json"), {"format": FORMAT, **asdict(card)})


def make_policy(
    name: str, config: Mapping[str, Any], action_size: int, sizes: FeatureSizes | None = None
) -> Policy:
    """Create a policy with random weights.

    Args:
        name: in `POLICIES`.
        config: settings of the policy, with its encoder.
        action_size: numbers per action.
        sizes: the groups of entities and the sensors that it observes; None: people and robots.

    Raises:
        ConfigurationError: a name is unknown or a setting is not valid.
    """
    if action_size not in ACTION_SIZE.values():
        raise ConfigurationError(
            f"action_size is {action_size}; it must be one of {sorted({*ACTION_SIZE.values()})}"
        )
    return POLICIES[name].cls(POLICIES.config({**config, "name": name}), action_size, sizes)


def load_policy(path: Path | str) -> tuple[Policy, PolicyCard]:
    """Read a policy and its card.

    Raises:
        ConfigurationError: a file is missing or damaged, is not that of a policy or has another
            format, or a weight is not finite.
    """
    path = find_policy(path) if isinstance(path, str) else path
    card, card_path = read_card(path), path.with_suffix(".json")
    if hashlib.sha256(path.read_bytes()).hexdigest() != card.sha256:
        raise ConfigurationError(f"{path} is damaged: its digest is not that in {card_path}")
    try:
        with _limit_parameters(path):
            policy = make_policy(card.policy, card.config, card.action_size, feature_sizes(card))
    except ConfigurationError as error:
        raise ConfigurationError(f"{card_path}: {error}") from error
    with attribute_errors_to(path, "does not fit its card"):
        policy.load_state_dict(load_file(path))
    check_finite(path, policy.state_dict())
    return policy.eval(), card


@contextlib.contextmanager
def attribute_errors_to(path: Path, reason: str = "is damaged") -> Iterator[None]:
    """Attribute all errors that the content of a file causes to that file.

    Raises:
        ConfigurationError: names the file.
    """
    try:
        yield
    except ConfigurationError:
        raise
    except (
        SafetensorError,
        LookupError,
        TypeError,
        ValueError,
        AttributeError,
        ArithmeticError,
        RuntimeError,
    ) as error:
        cause = (str(error).splitlines() or [type(error).__name__])[0]
        raise ConfigurationError(f"{path} {reason} ({cause:.300})") from error


def check_finite(path: Path, tensors: Mapping[str, Tensor]) -> None:
    """Refuse weights of a file that are not finite.

    Raises:
        ConfigurationError: names the tensor that contains NaN or infinity.
    """
    for name, tensor in tensors.items():
        if not tensor.isfinite().all():
            raise ConfigurationError(
                f"{path} has {name} with NaN or infinity in it; weights must be finite"
            )


@contextlib.contextmanager
def _limit_parameters(path: Path) -> Iterator[None]:
    """Refuse to create networks that are much larger than a weights file, before memory runs out.

    Raises:
        ConfigurationError: the parameters need more than twice the size of the file.
    """
    remaining_bytes = 2 * path.stat().st_size + 2**20

    def count(module: nn.Module, name: str, parameter: nn.Parameter | None) -> None:
        nonlocal remaining_bytes
        remaining_bytes -= 0 if parameter is None else parameter.nbytes
        if remaining_bytes < 0:
            raise ConfigurationError(f"its sizes are those of a policy that {path} cannot hold")

    hook = register_module_parameter_registration_hook(count)
    try:
        yield
    finally:
        hook.remove()
