"""The examples in docstrings run."""

import doctest
import importlib

import pytest

EXAMPLES = {
    "mrsan.world": 4,
    "mrsan.pettingzoo_env": 4,
    "mrsan.reward_terms": 1,
    "mrsan.sb3_env": 2,
    "mrsan.torchrl_env": 2,
    "samarl": 2,
    "samarl.api": 7,
    "samarl.evaluation.metrics": 2,
}


@pytest.mark.parametrize("name", EXAMPLES)
def test_the_examples_of(name: str) -> None:
    module = importlib.import_module(name)
    result = doctest.testmod(module, optionflags=doctest.ELLIPSIS)
    assert result.failed == 0
    assert result.attempted >= min(EXAMPLES[name], 1)
