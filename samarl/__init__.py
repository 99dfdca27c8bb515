"""SAMARL: a benchmark suite for multi-robot socially-aware navigation.

Examples:
    >>> import samarl
    >>> samarl.evaluate("orca", cases=2).row["episodes"]
    2
"""

import os
import sys
from importlib import import_module
from importlib.metadata import version
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from samarl.api import evaluate, load_agent, load_scenario, record, render, train

# Set before torch is loaded: how its threads wait, see `mrsan.threads`. Networks consist of many
# small operations, between which threads should not sleep: training is then 2.5 times as fast.
if "torch" not in sys.modules:
    os.environ.setdefault("GOMP_SPINCOUNT", "20000")

__version__ = version("samarl")

__all__ = ["evaluate", "load_agent", "load_scenario", "record", "render", "train"]


def __getattr__(name: str) -> Any:
    """Import the Python API on first use, because it loads torch."""
    if name not in __all__:
        raise AttributeError(f"module 'samarl' has no attribute {name!r}")
    return getattr(import_module("samarl.api"), name)
