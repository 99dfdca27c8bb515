"""Checkpoints: safetensors and JSON, written whole or not at all, never a pickle.

A policy is two files: `NAME.safetensors` holds the weights and `NAME.json` says which class they
belong to, its sizes, how it was made, and the digest of the weights. Class names resolve through
`POLICIES` alone, so loading a stranger's file runs none of their code.
"""

from __future__ import annotations

import hashlib
import json
import os
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import torch
from safetensors import SafetensorError
from safetensors.torch import load_file, save
from torch import Tensor

from mrsan import ConfigurationError
from samarl.evaluation.files import find_folder, unfinished, write_json
from samarl.policies.hierarchical import Architecture, HierarchicalPolicy

POLICIES: dict[str, tuple[type[HierarchicalPolicy], type[Architecture]]] = {
    "hierarchical": (HierarchicalPolicy, Architecture),
}
FORMAT = 1


@dataclass
class PolicyCard:
    """What a policy file says of itself."""

    policy: str  # a key of POLICIES
    action_size: int
    architecture: dict[str, Any]
    made: dict[str, Any]  # the command, commit, scenario, steps ... that made it
    sha256: str  # digest of the file of the weights


def write_tensors(path: Path, tensors: dict[str, Tensor], metadata: dict[str, str]) -> str:
    """Write tensors atomically; returns the digest of the file."""
    content = save({key: value.contiguous().cpu() for key, value in tensors.items()}, metadata)
    with unfinished(path) as part, part.open("wb") as file:
        file.write(content)
        file.flush()
        os.fsync(file.fileno())
    return hashlib.sha256(content).hexdigest()


def save_policy(path: Path, policy: HierarchicalPolicy, name: str, made: dict[str, Any]) -> None:
    """Write `path` (ending in .safetensors) and its card beside it."""
    digest = write_tensors(path, dict(policy.state_dict()), {})
    card = PolicyCard(name, policy.action_size, asdict(policy.architecture), made, digest)
    write_json(path.with_suffix(".json"), {"format": FORMAT, **asdict(card)})


def find_policy(name: str, field: str = "checkpoint") -> Path:
    """The file of a policy.

    Args:
        name: a path, or the name of a shipped policy.
        field: that holds it, for the error.

    Raises:
        ConfigurationError: it is neither.
    """
    shipped = find_folder("results") / "checkpoints"
    for path in (Path(name), shipped / f"{name}.safetensors"):
        if path.is_file():
            return path
    names = ", ".join(sorted(path.stem for path in shipped.glob("*.safetensors"))) or "(none)"
    raise ConfigurationError(
        f"{field} is {name!r}; it must be a .safetensors file or one of the shipped: {names}"
    )


def load_policy(path: Path) -> tuple[HierarchicalPolicy, PolicyCard]:
    """Read a policy and its card.

    Raises:
        ConfigurationError: a file is missing, damaged, foreign or of another format.
    """
    card_path = path.with_suffix(".json")
    for needed in (path, card_path):
        if not needed.is_file():
            raise ConfigurationError(
                f"there is no file {needed}; a policy is a .safetensors file and, beside it, a "
                ".json file of the same name"
            )
    try:
        content = json.loads(card_path.read_text(encoding="utf-8"))
        version = content.pop("format")
        card = PolicyCard(**content)
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise ConfigurationError(f"{card_path} is not the card of a policy ({error})") from error
    if version != FORMAT:
        raise ConfigurationError(f"{card_path} has format {version!r}; it must be {FORMAT}")
    if card.policy not in POLICIES:
        choices = ", ".join(POLICIES)
        raise ConfigurationError(f"{card_path} names {card.policy!r}; it must be among {choices}")
    if hashlib.sha256(path.read_bytes()).hexdigest() != card.sha256:
        raise ConfigurationError(
            f"{path} is damaged: it is not the file that {card_path} describes"
        )
    policy_class, architecture_class = POLICIES[card.policy]
    try:
        policy = policy_class(architecture_class(**card.architecture), card.action_size)
        policy.load_state_dict(load_file(path))
    except (TypeError, RuntimeError, SafetensorError, ValueError) as error:
        reason = str(error).splitlines()[0]
        raise ConfigurationError(f"{path} does not fit its card ({reason})") from error
    return policy.eval(), card


def pack(prefix: str, values: Any, out: dict[str, Tensor]) -> None:
    """Flatten nested dicts, lists, tuples of tensors, arrays and numbers into named tensors."""
    if isinstance(values, dict):
        items = [(str(key), value) for key, value in values.items()]
    elif isinstance(values, list | tuple):
        items = [(str(index), value) for index, value in enumerate(values)]
    else:
        out[prefix] = torch.as_tensor(values).clone()
        return
    for key, value in items:
        pack(f"{prefix}/{key}" if prefix else key, value, out)


def unpack(example: Any, prefix: str, tensors: dict[str, Tensor]) -> Any:
    """The inverse of `pack`, in the structure of `example`."""
    if isinstance(example, dict):
        return {key: unpack(value, f"{prefix}/{key}", tensors) for key, value in example.items()}
    if isinstance(example, list | tuple):
        return [unpack(value, f"{prefix}/{i}", tensors) for i, value in enumerate(example)]
    value = tensors[prefix]
    return value if isinstance(example, Tensor) else value.numpy()
