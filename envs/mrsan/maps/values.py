"""Values of map files that other programs write: numbers and switches in any YAML type."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Hashable
from typing import Any

import yaml

from mrsan.maps.polygons import MapError

_SWITCHES = {"0": False, "false": False, "no": False, "off": False} | {
    "1": True,
    "true": True,
    "yes": True,
    "on": True,
}


class TextLoader(yaml.SafeLoader):
    """Reads scalars as text: YAML 1.1 would take `010` for 8 and `1:30` for 90.

    Refuses a key that occurs twice, of which YAML would keep the last, and aliases, which can make
    a small file enormous.
    """

    yaml_implicit_resolvers = {  # noqa: RUF012 (declared in the base class)
        first: [(tag, pattern) for tag, pattern in resolvers if tag.endswith(":null")]
        for first, resolvers in yaml.SafeLoader.yaml_implicit_resolvers.items()
    }

    def compose_node(self, parent: yaml.Node | None, index: int) -> yaml.Node | None:
        """Return the next node.

        Raises:
            MapError: it is an alias.
        """
        if self.check_event(yaml.AliasEvent):
            raise MapError(f"has the alias *{self.peek_event().anchor:.60}; it must have none")
        return super().compose_node(parent, index)

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Hashable, Any]:
        """Return a mapping.

        Raises:
            MapError: a key occurs twice.
        """
        check_unique([self.construct_object(key, deep=True) for key, _ in node.value])
        return super().construct_mapping(node, deep)


def unique_keys(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    """Return a mapping of JSON: the `object_pairs_hook` of `json.loads`.

    Raises:
        MapError: a key occurs twice.
    """
    check_unique([key for key, _ in pairs])
    return dict(pairs)


def check_unique(keys: list[Any]) -> None:
    """Check that no key occurs twice.

    Raises:
        MapError: names the key.
    """
    for key, count in Counter(map(repr, keys)).items():
        if count > 1:
            raise MapError(f"has the key {key:.60} {count} times; each key must occur once")


def number_of(value: Any, name: str, must: str = "a number") -> float:
    """Return a finite number, which may be written as text such as `0.196` or `5e-02`.

    Raises:
        MapError: it is not a finite number.
    """
    try:
        result = math.nan if isinstance(value, bool) or "_" in str(value) else float(value)
    except (TypeError, ValueError, OverflowError):
        result = math.nan
    if not math.isfinite(result):
        raise MapError(f"{name} is {value!r:.60}; it must be {must}")
    return result


def switch_of(value: Any, name: str) -> bool:
    """Return a switch: 0 or 1, true or false, also written as text.

    Raises:
        MapError: it is something else.
    """
    text = str(value).strip().lower().removesuffix(".0")
    if text not in _SWITCHES:
        raise MapError(f"{name} is {value!r:.60}; it must be 0 or 1")
    return _SWITCHES[text]
