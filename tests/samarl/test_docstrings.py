"""The examples in docstrings run."""

import doctest
import importlib

MODULES = (
    "mrsan.world",
    "mrsan.pettingzoo_env",
    "mrsan.reward_terms",
    "mrsan.sb3_env",
    "mrsan.torchrl_env",
    "samarl",
    "samarl.api",
    "samarl.evaluation.metrics",
)


def test_the_examples_run() -> None:
    for name in MODULES:
        result = doctest.testmod(importlib.import_module(name), optionflags=doctest.ELLIPSIS)
        assert result.attempted > 0, name
        assert result.failed == 0, name
