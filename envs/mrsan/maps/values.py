"""Values of map files that other programs write: numbers and switches in any YAML type."""

from __future__ import annotations

import math
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


class UniqueKeyLoader(yaml.SafeLoader):
    """Refuses a key that occurs twice in a mapping, of which YAML would keep the last."""

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
    for number, key in enumerate(keys):
        if key in keys[:number]:
            raise MapError(f"has the key {key!r} twice; each key must occur once")


def number_of(value: Any, name: str, must: str = "a number") -> float:
    """Return a finite number, which may be written as text such as `'0.196'` or `5e-02`.

    Raises:
        MapError: it is not a finite number.
    """
    try:
        result = math.nan if isinstance(value, bool) else float(value)
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
