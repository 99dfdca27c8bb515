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
    from samarl.agents import Agent
    from samarl.algorithms import ALGORITHMS
    from samarl.algorithms.algorithm import Algorithm
    from samarl.api import evaluate, load_agent, load_scenario, record, render
    from samarl.encoders import ENCODERS, Encoder
    from samarl.evaluation.metrics import metric
    from samarl.policies.policy import POLICIES, Policy
    from samarl.run import Run, train

# Set before torch is loaded: how its threads wait, see `mrsan.threads`. Networks consist of many
# small operations, between which threads should not sleep: training is then 2.5 times as fast.
if "torch" not in sys.modules:
    os.environ.setdefault("GOMP_SPINCOUNT", "20000")

__version__ = version("samarl")

__all__ = [
    "ALGORITHMS",
    "ENCODERS",
    "POLICIES",
    "Agent",
    "Algorithm",
    "Encoder",
    "Policy",
    "Run",
    "evaluate",
    "load_agent",
    "load_scenario",
    "metric",
    "record",
    "render",
    "train",
]
_MODULES = {
    "ALGORITHMS": "samarl.algorithms",
    "ENCODERS": "samarl.encoders",
    "POLICIES": "samarl.policies.checkpoint",
    "Agent": "samarl.agents",
    "Algorithm": "samarl.algorithms.algorithm",
    "Encoder": "samarl.encoders",
    "Policy": "samarl.policies.policy",
    "Run": "samarl.run",
    "metric": "samarl.evaluation.metrics",
    "train": "samarl.run",
}


def __getattr__(name: str) -> Any:
    """Import a part of the Python API on first use, because some of it loads torch."""
    if name not in __all__:
        raise AttributeError(f"module 'samarl' has no attribute {name!r}")
    return getattr(import_module(_MODULES.get(name, "samarl.api")), name)


def __dir__() -> list[str]:
    """Return the names for completion."""
    return sorted([*globals(), *__all__])
