"""Files and folders of users as choices of Hydra's groups, as in `agent=outputs/mine`."""

from __future__ import annotations

import builtins
import contextlib
from pathlib import Path
from typing import Any

import yaml
from hydra.core.object_type import ObjectType
from hydra.plugins.config_source import ConfigResult, ConfigSource
from omegaconf import DictConfig, ListConfig, OmegaConf

from mrsan import ConfigurationError
from samarl.evaluation.methods import split_method
from samarl.files import find_folder
from samarl.policies.card import BEST, LAST, RULE, find_policy, is_policy, read_card

AGENT_OF_POLICY = {  # the included agent that uses each kind of policy
    "flat": "samarl_flat",
    "hierarchical": "samarl_waypoints",
    "lookahead": "cadrl",
    "squashed": "msa3cpred",
}
MAX_VALUES = 100_000  # in a YAML file with its aliases expanded; typical files have some hundred
YAML = (".yaml", ".yml")


class PathChoices(ConfigSource):
    """Choices that are named by a path instead of by a name in `conf/`.

    `agent=PATH` and `scenario=PATH` accept a YAML file in the form of the group's own files, and
    `agent=NAME` accepts a policy, as `samarl.policies.card.find_policy` does. A policy drives like
    the included agent with a policy of its kind, which for SAMARL's kinds has a shield, and with
    the right of way of its training.
    """

    @staticmethod
    def scheme() -> str:
        """Return how `hydra.searchpath` in `conf/` names this source, without `://`."""
        return "paths"

    def is_config(self, config_path: str) -> bool:
        """Return whether `GROUP/PATH` is a choice."""
        group, _, name = config_path.partition("/")
        if group not in ("agent", "scenario"):
            return False
        if Path(name).suffix in YAML:
            return Path(name).is_file()
        return group == "agent" and is_policy(name)

    def load_config(self, config_path: str) -> ConfigResult:
        """Return the content of a choice.

        Raises:
            ConfigurationError: it is a policy of a kind that no included agent drives, or a file
                with too many values.
        """
        group, _, name = config_path.partition("/")
        path = Path(name)
        header: dict[str, str | None] = {"package": None}
        if path.suffix in YAML:
            reject_alias_bomb(path)
            header = self._get_header_dict(path.read_text(encoding="utf-8"))
            config = OmegaConf.load(path)
            if isinstance(config, DictConfig) and isinstance(config.get("defaults"), ListConfig):
                config.defaults = [_absolute(group, path, base) for base in config.defaults]
        else:
            config = OmegaConf.create(_agent_of_policy(name))
        return ConfigResult(self.provider, config_path, config, header)

    def is_group(self, config_path: str) -> bool:
        """Return False: paths are not listed."""
        return False

    def list(self, config_path: str, results_filter: ObjectType | None) -> builtins.list[str]:
        """Return nothing: paths are not listed."""
        return []

    def available(self) -> bool:
        """Return True."""
        return True


def name_of(choice: str) -> str:
    """Return the name of an agent in tables: that of its file, or the folder of its training."""
    path = Path(choice)
    if path.name in (BEST, LAST):
        path = path.absolute().parent
    return path.stem if path.suffix in (*YAML, ".safetensors") else path.name


def reject_alias_bomb(path: Path) -> None:
    """Reject a YAML file whose aliases expand to more than `MAX_VALUES` values.

    Hydra expands every alias, so a few lines could exhaust the memory.

    Raises:
        ConfigurationError: it has too many values.
    """
    sizes: dict[int, int] = {}  # by node, values below it with its aliases expanded

    def size(node: yaml.Node) -> int:
        if id(node) not in sizes:
            sizes[id(node)] = MAX_VALUES  # counted if the node contains itself
            parts = node.value if isinstance(node, yaml.CollectionNode) else []
            pairs = (part if isinstance(part, tuple) else (part,) for part in parts)
            sizes[id(node)] = 1 + sum(size(value) for pair in pairs for value in pair)
        return sizes[id(node)]

    with contextlib.suppress(OSError, UnicodeError, yaml.YAMLError, RecursionError):  # as when used
        text = path.read_text(encoding="utf-8")
        if (
            "&" in text
            and (tree := yaml.compose(text, yaml.SafeLoader))
            and size(tree) > MAX_VALUES
        ):
            raise ConfigurationError(
                f"{path} has more than {MAX_VALUES} values with its aliases expanded; it must "
                "have fewer"
            )


def _absolute(group: str, path: Path, base: Any) -> Any:
    """Return an entry of the defaults list of `path`, a name in `conf/` or of a file beside it."""
    if not isinstance(base, str) or base == "_self_" or base.startswith("/"):
        return base
    neighbor = path.parent / f"{base}.yaml"
    is_included = (find_folder("conf") / group / f"{base}.yaml").is_file()
    name = base if is_included or not neighbor.is_file() else str(neighbor)
    return f"/{group}/{name}@_here_"


def _agent_of_policy(name: str) -> dict[str, Any]:
    """Return the configuration of the agent that drives a policy.

    Raises:
        ConfigurationError: there is none for policies of its kind.
    """
    checkpoint = find_policy(name, "agent")
    card = read_card(checkpoint)
    kind = card.policy
    if kind not in AGENT_OF_POLICY:
        raise ConfigurationError(
            f"agent is {name!r}, a {kind} policy; it must be a policy of the kinds "
            f"{', '.join(AGENT_OF_POLICY)}, or a YAML file of an agent with this checkpoint"
        )
    config = {
        "defaults": [f"/agent/{AGENT_OF_POLICY[kind]}@_here_"],
        "checkpoint": name if name == checkpoint.stem else str(checkpoint),
    }
    if guides := list(filter(None, card.values_in_training("guide"))):
        config["right_of_way"] = split_method(str(guides[0]))[1].get("macro_level") or RULE
    return config
