"""Checkpoints: safetensors and JSON, written whole or not at all, never a pickle.

A policy is two files: `NAME.safetensors` holds the weights and `NAME.json` says which class they
belong to, its sizes, how it was made, and the digest of the weights. Class names resolve through
`POLICIES` alone, so loading a stranger's file runs none of their code.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import torch
from safetensors import SafetensorError
from safetensors.torch import load_file, save
from torch import Tensor, nn
from torch.nn.modules.module import register_module_parameter_registration_hook
from torch.utils._pytree import tree_flatten, tree_leaves, tree_unflatten

from mrsan import ConfigurationError
from mrsan.choices import ACTION_SIZE
from samarl.files import atomic_write, find_folder, read_json, write_json
from samarl.messages import choice_hint
from samarl.observations.frames import FeatureSizes
from samarl.policies import (  # noqa: F401 (makes them known)
    flat,
    hierarchical,
    lookahead,
    squashed,
)
from samarl.policies.policy import POLICIES, Policy

FORMAT = 3


@dataclass
class PolicyCard:
    """What a policy file says of itself."""

    policy: str  # a name in POLICIES
    action_size: int
    config: dict[str, Any]  # of the policy, with its encoder
    provenance: dict[str, Any]  # command, commit, configuration, steps ... of the training
    sha256: str  # digest of the file of the weights
    # Fields of `FeatureSizes`; empty in older files, whose policies observe people and robots.
    sizes: dict[str, Any] = field(default_factory=dict)

    def feature_sizes(self) -> FeatureSizes | None:
        """Return what the policy observes; None: people and robots."""
        if not self.sizes:
            return None
        sensors = {name: tuple(shape) for name, shape in self.sizes["sensors"].items()}
        return FeatureSizes(self.sizes["ego"], self.sizes["entities"], sensors)


_CARD_TYPES = {
    "policy": str,
    "action_size": int,
    "config": dict,
    "provenance": dict,
    "sha256": str,
    "sizes": dict,
}


def write_tensors(path: Path, tensors: dict[str, Tensor], metadata: dict[str, str]) -> str:
    """Write tensors atomically; returns the digest of the file."""
    content = save({key: value.contiguous().cpu() for key, value in tensors.items()}, metadata)
    with atomic_write(path) as part, part.open("wb") as file:
        file.write(content)
        file.flush()
        os.fsync(file.fileno())
    return hashlib.sha256(content).hexdigest()


def save_policy(path: Path, policy: Policy, name: str, provenance: dict[str, Any]) -> None:
    """Write `path` (ending in .safetensors) and its card beside it."""
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
    """Return a policy with fresh weights.

    Args:
        name: in `POLICIES`.
        config: the numbers of the policy, with its encoder.
        action_size: A.
        sizes: the groups of entities and the sensors that it observes; None: people and robots.

    Raises:
        ConfigurationError: a name is not known or a number is wrong.
    """
    if action_size not in ACTION_SIZE.values():
        raise ConfigurationError(
            f"action_size is {action_size}; it must be one of {sorted({*ACTION_SIZE.values()})}"
        )
    values = POLICIES.config({**config, "name": name})
    policy = POLICIES[name].cls(values, action_size, sizes)
    return policy


def find_policy(name: str, field: str = "checkpoint") -> Path:
    """Return the file of a policy.

    Args:
        name: a path, or the name of a shipped policy.
        field: the setting that holds it, for the error.

    Raises:
        ConfigurationError: there is neither such a file nor such a shipped policy.
    """
    shipped = find_folder("results") / "checkpoints"
    for path in (Path(name), shipped / f"{name}.safetensors"):
        if path.is_file():
            return path
    names = [path.stem for path in shipped.glob("*.safetensors")]
    raise ConfigurationError(
        f"{field} is {name!r}, which does not exist; it must be a .safetensors file or the name of "
        f"a shipped policy; {choice_hint(name, names, 'samarl is one')}"
    )


def load_policy(path: Path) -> tuple[Policy, PolicyCard]:
    """Read a policy and its card.

    Raises:
        ConfigurationError: a file is missing, damaged, foreign or of another format; or a weight
            is no finite number.
    """
    card, card_path = read_card(path), path.with_suffix(".json")
    if hashlib.sha256(path.read_bytes()).hexdigest() != card.sha256:
        raise ConfigurationError(
            f"{path} is damaged: it is not the file that {card_path} describes"
        )
    try:
        with _no_larger_than(path):
            policy = make_policy(card.policy, card.config, card.action_size, card.feature_sizes())
    except ConfigurationError as error:
        raise ConfigurationError(f"{card_path}: {error}") from error
    with attribute_errors_to(path, "does not fit its card"):
        policy.load_state_dict(load_file(path))
    check_finite(path, policy.state_dict())
    return policy.eval(), card


@contextlib.contextmanager
def attribute_errors_to(path: Path, reason: str = "is damaged") -> Iterator[None]:
    """Whatever goes wrong with the content of a file is said to be its fault.

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
        what = (str(error).splitlines() or [type(error).__name__])[0]
        raise ConfigurationError(f"{path} {reason} ({what})") from error


def check_finite(path: Path, tensors: Mapping[str, Tensor]) -> None:
    """Refuse weights of a file with which a network gives no numbers.

    Raises:
        ConfigurationError: names the tensor that holds NaN or infinity.
    """
    for name, tensor in tensors.items():
        if not tensor.isfinite().all():
            raise ConfigurationError(
                f"{path} has {name} with NaN or infinity in it; weights must be finite"
            )


def read_card(weights: Path) -> PolicyCard:
    """Read the card beside a file of weights.

    Raises:
        ConfigurationError: one of both files is missing, or the card is damaged or of another
            format.
    """
    path = weights.with_suffix(".json")
    for file in (weights, path):
        if not file.is_file():
            raise ConfigurationError(
                f"there is no file {file}; a policy is a .safetensors file and, beside it, a "
                ".json file of the same name"
            )
    try:
        content = read_json(path)
        version = content.pop("format")
        card = PolicyCard(**content)
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise ConfigurationError(f"{path} is not the card of a policy ({error})") from error
    if version != FORMAT:
        raise ConfigurationError(f"{path} has format {version!r}; it must be {FORMAT}")
    for name, kind in _CARD_TYPES.items():
        if not isinstance(getattr(card, name), kind):
            raise ConfigurationError(
                f"{path} has {name} {getattr(card, name)!r:.60}; it must be a {kind.__name__}"
            )
    return card


@contextlib.contextmanager
def _no_larger_than(path: Path) -> Iterator[None]:
    """Refuse to make networks that are larger than a file of weights by far, before it is done."""
    left = 2 * path.stat().st_size + 2**20

    def count(module: nn.Module, name: str, parameter: nn.Parameter | None) -> None:
        nonlocal left
        left -= 0 if parameter is None else parameter.nbytes
        if left < 0:
            raise ConfigurationError(f"its sizes are those of a policy that {path} cannot hold")

    hook = register_module_parameter_registration_hook(count)
    try:
        yield
    finally:
        hook.remove()


def pack(prefix: str, tree: Any) -> dict[str, Tensor]:
    """The leaves of a nested structure of tensors, arrays and numbers, as named tensors."""
    leaves = tree_leaves(tree)
    return {
        f"{prefix}/{i}": torch.as_tensor(leaf).detach().clone()
        for i, leaf in enumerate(leaves)
        if leaf is not None
    }


def unpack(example: Any, prefix: str, tensors: Mapping[str, Tensor]) -> Any:
    """The inverse of `pack`, in the structure of `example`.

    Raises:
        ValueError: a tensor is missing, or of another shape or type than in `example`.
    """
    leaves, structure = tree_flatten(example)
    found: list[Any] = []
    for i, leaf in enumerate(leaves):
        if leaf is None:
            found.append(None)
            continue
        name, expected = f"{prefix}/{i}", torch.as_tensor(leaf)
        value = tensors.get(name)
        if value is None or (value.shape, value.dtype) != (expected.shape, expected.dtype):
            raise ValueError(f"{name} must be a tensor {list(expected.shape)} of {expected.dtype}")
        # A copy: what lies in a file's buffer is aligned otherwise, and sums round otherwise.
        found.append(
            value.to(leaf.device).clone() if isinstance(leaf, Tensor) else value.numpy().copy()
        )
    return tree_unflatten(found, structure)
