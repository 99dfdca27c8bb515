"""Checkpoints: safetensors and JSON, written whole or not at all, never a pickle.

A policy is two files: `NAME.safetensors` holds the weights and `NAME.json` says which class they
belong to, its sizes, how it was made, and the digest of the weights. Class names resolve through
`POLICIES` alone, so loading a stranger's file runs none of their code.
"""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import torch
from safetensors import SafetensorError
from safetensors.torch import load_file, save
from torch import Tensor
from torch.utils._pytree import tree_flatten, tree_leaves, tree_unflatten

from mrsan import ConfigurationError
from samarl.files import find_folder, unfinished, write_json
from samarl.policies import (  # noqa: F401 (makes them known)
    flat,
    hierarchical,
    lookahead,
    squashed,
)
from samarl.policies.policy import POLICIES, Policy

FORMAT = 2


@dataclass
class PolicyCard:
    """What a policy file says of itself."""

    policy: str  # a name in POLICIES
    action_size: int
    config: dict[str, Any]  # of the policy, with its encoder
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


def save_policy(path: Path, policy: Policy, name: str, made: dict[str, Any]) -> None:
    """Write `path` (ending in .safetensors) and its card beside it."""
    digest = write_tensors(path, dict(policy.state_dict()), {})
    card = PolicyCard(name, policy.action_size, asdict(policy.config), made, digest)
    write_json(path.with_suffix(".json"), {"format": FORMAT, **asdict(card)})


def make_policy(name: str, config: Mapping[str, Any], action_size: int) -> Policy:
    """A policy with fresh weights.

    Raises:
        ConfigurationError: a name is not known or a number is wrong.
    """
    values = POLICIES.config({**config, "name": name})
    policy = POLICIES[name].made(values, action_size)
    return policy


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


def load_policy(path: Path) -> tuple[Policy, PolicyCard]:
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
    if hashlib.sha256(path.read_bytes()).hexdigest() != card.sha256:
        raise ConfigurationError(
            f"{path} is damaged: it is not the file that {card_path} describes"
        )
    policy = make_policy(card.policy, card.config, card.action_size)
    try:
        policy.load_state_dict(load_file(path))
    except (TypeError, RuntimeError, SafetensorError, ValueError) as error:
        reason = str(error).splitlines()[0]
        raise ConfigurationError(f"{path} does not fit its card ({reason})") from error
    return policy.eval(), card


def pack(prefix: str, tree: Any) -> dict[str, Tensor]:
    """The leaves of a nested structure of tensors, arrays and numbers, as named tensors."""
    leaves = tree_leaves(tree)
    return {
        f"{prefix}/{i}": torch.as_tensor(leaf).detach().clone() for i, leaf in enumerate(leaves)
    }


def unpack(example: Any, prefix: str, tensors: Mapping[str, Tensor]) -> Any:
    """The inverse of `pack`, in the structure of `example`."""
    leaves, structure = tree_flatten(example)
    found: list[Any] = []
    for i, leaf in enumerate(leaves):
        value = tensors[f"{prefix}/{i}"]
        # A copy: what lies in a file's buffer is aligned otherwise, and sums round otherwise.
        found.append(
            value.to(leaf.device).clone() if isinstance(leaf, Tensor) else value.numpy().copy()
        )
    return tree_unflatten(found, structure)
