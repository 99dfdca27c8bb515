"""The card of a policy: the JSON file next to its weights. Reading it does not import torch."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from mrsan import ConfigurationError
from mrsan.suggestions import choice_hint
from samarl.files import find_folder, read_json

FORMAT = 3
BEST, LAST = "best.safetensors", "last.safetensors"  # policies in the folder of a training run
RULE = "rule"  # of the setting `right_of_way` of policies: the rule of the planner


@dataclass
class PolicyCard:
    """The JSON file of a policy."""

    policy: str  # a name in POLICIES
    action_size: int
    config: dict[str, Any]  # of the policy, with its encoder
    provenance: dict[str, Any]  # command, commit, configuration, steps ... of the training
    sha256: str  # digest of the weights file
    # Fields of `FeatureSizes`; empty in older files, whose policies observe people and robots.
    sizes: dict[str, Any] = field(default_factory=dict)

    def values_in_training(self, name: str) -> list[Any]:
        """Return the values of a setting in the training, such as `fov_degrees` in all stages."""
        return list(_values(self.provenance.get("configuration"), name))


def _values(tree: Any, key: str) -> Iterator[Any]:
    """Yield all values under `key` in a nested structure."""
    if isinstance(tree, dict):
        for name, value in tree.items():
            if name == key:
                yield value
            else:
                yield from _values(value, key)
    elif isinstance(tree, list):
        for value in tree:
            yield from _values(value, key)


_CARD_TYPES = {
    "policy": str,
    "action_size": int,
    "config": dict,
    "provenance": dict,
    "sha256": str,
    "sizes": dict,
}


def find_policy(name: str, field: str = "checkpoint") -> Path:
    """Return the file of a policy.

    Args:
        name: a path, the folder of a training run, whose best policy is returned, or the name of
            a shipped policy.
        field: name of the setting, for error messages.

    Raises:
        ConfigurationError: there is no such file and no such shipped policy.
    """
    shipped = find_folder("results") / "checkpoints"
    for path in (Path(name), Path(name) / BEST, shipped / f"{name}.safetensors"):
        if path.is_file():
            return path
    names = [path.stem for path in shipped.glob("*.safetensors")]
    raise ConfigurationError(
        f"{field} is {name!r}, which does not exist; it must be a .safetensors file, the folder of "
        f"a training run or the name of a shipped policy in {shipped}, such as samarl"
        + (f"; {suggestion}" if (suggestion := choice_hint(name, names, "")) else "")
    )


def is_policy(name: str) -> bool:
    """Return whether `find_policy` finds a policy."""
    try:
        return find_policy(name).suffix == ".safetensors"
    except ConfigurationError:
        return False


def read_card(weights: Path) -> PolicyCard:
    """Read the card next to a weights file.

    Raises:
        ConfigurationError: one of the files is missing, or the card is damaged or has another
            format.
    """
    path = weights.with_suffix(".json")
    for file in (weights, path):
        if not file.is_file():
            raise ConfigurationError(
                f"there is no file {file}; a policy is a .safetensors file with a .json file of "
                "the same name next to it"
            )
    try:
        content = read_json(path)
        version = content.pop("format")
        card = PolicyCard(**content)
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise ConfigurationError(f"{path} is not the card of a policy ({error!s:.300})") from error
    if version != FORMAT:
        raise ConfigurationError(f"{path} has format {version!r:.60}; it must be {FORMAT}")
    for name, type_ in _CARD_TYPES.items():
        if not isinstance(getattr(card, name), type_):
            raise ConfigurationError(
                f"{path} has {name} {getattr(card, name)!r:.60}; it must be a {type_.__name__}"
            )
    return card
