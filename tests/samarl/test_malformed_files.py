"""A sample of `benchmarks.malformed`: malformed inputs are refused in one line, or accepted."""

import json
from pathlib import Path

import pytest
import torch

from benchmarks.malformed import ACCEPTED, REFUSED, make_input, outcome
from benchmarks.malformed_kinds import COMMAND_KINDS, KINDS, POLICY, ValidInputs
from mrsan import ConfigurationError
from samarl.configuration import scenario_of
from samarl.policies.checkpoint import load_policy, make_policy, save_policy

SLOW = 22  # only the first of these items may run whole commands


def test_malformed_inputs_are_refused_in_one_line(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.chdir(tmp_path)
    valid, kinds, failures = ValidInputs(tmp_path), list(KINDS), []
    for number in range(150):
        if number >= SLOW and kinds[number % len(kinds)] in COMMAND_KINDS:
            continue
        item = make_input(number, valid, seed=1)
        result = outcome(item)
        if result not in (REFUSED, ACCEPTED):
            failures.append(f"{number} {item.kind}: {result}")
    assert not failures, "\n".join(failures)


def test_policies_with_nan_or_implausible_sizes_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "policy.safetensors"
    policy = make_policy("flat", POLICY, 3)
    with torch.no_grad():
        policy.networks[0].heads["local"].log_std[1] = float("nan")
    save_policy(path, policy, "flat", {})
    with pytest.raises(
        ConfigurationError, match=r"has networks\.0\.heads\.local\.log_std with NaN"
    ):
        load_policy(path)
    card = json.loads(path.with_suffix(".json").read_text())
    for sizes, message in (
        (
            {"hidden": 4096, "num_parameter_sets": 16},
            "policy that .* cannot hold",
        ),
        ({"hidden": 10**9}, "policy.hidden is 1000000000; it must be a whole number in"),
        ({"hidden": 10**400}, "policy.hidden is 1000"),
        ({"round_radius": 10**400}, "policy contains a number too large"),
        ({"encoder": "${nowhere}"}, "encoder is '.*'; it must map names to values"),
    ):
        spoiled = {**card, "config": {**card["config"], **sizes}}
        path.with_suffix(".json").write_text(json.dumps(spoiled))
        with pytest.raises(ConfigurationError, match=message):
            load_policy(path)


@pytest.mark.parametrize(
    ("column", "message"),
    [
        (float("inf"), "crowds has inf; it must map fields of a scenario"),
        ("0x10", "crowds: there is no scenario '0x10'"),
        ({"sensing_range": 10**400}, "crowds contains .*too large"),
        ({"scenario": [1]}, r"crowds: there is no scenario '\[1\]'; it must be one of 10p3r,"),
    ],
)
def test_invalid_columns_are_refused(column: object, message: str) -> None:
    with pytest.raises(ConfigurationError, match=message):
        scenario_of(column, "crowds")
