"""Means and ranges over training seeds, by hand."""

import pytest

from samarl.evaluation.seeds import across_seeds, probability_of_improvement
from samarl.evaluation.table import rows_as_cells
from tests.samarl.test_summary import row


def test_mean_and_range_of_three_seeds_by_hand() -> None:
    rows = [row(success_rate=s, social_score=s - 10.0) for s in (96.0, 90.0, 99.0)]
    assert across_seeds(rows) == {
        "training_seeds": 3,
        "success_of_seeds": [96.0, 90.0, 99.0],
        "success_seed_mean": 95.0,
        "success_seed_min": 90.0,
        "success_seed_max": 99.0,
        "social_of_seeds": [86.0, 80.0, 89.0],
        "social_seed_mean": 85.0,
        "social_seed_min": 80.0,
        "social_seed_max": 89.0,
    }


def test_the_probability_of_improvement_by_hand() -> None:
    # One of our three seeds is worse: of 27 samples one, 3.7 %, is three times that seed.
    assert probability_of_improvement([3.0, 5.0, 1.0], [2.0]) == pytest.approx([2 / 3, 0.0, 1.0])
    share, _, _ = probability_of_improvement([1.0, 3.0], [1.0, 2.0])  # worse, equal, better twice
    assert share == pytest.approx(2.5 / 4)
    assert probability_of_improvement([2.0], [1.0]) == [1.0, 1.0, 1.0]


def test_tables_show_mean_and_range_if_there_are_several_seeds() -> None:
    one, other = row(), row(method="other")
    assert "seeds" not in rows_as_cells([one, other])[0]
    seeds = [other, other | {"success_rate": 35.0}]
    header, lines = rows_as_cells([one, other | across_seeds(seeds)])
    assert header[-3:] == ("seeds", "mean success % [range]", "mean social score [range]")
    assert lines[0][-3:] == ["", "", ""]
    assert lines[1][-3:] == ["2", "30.0 [25.0, 35.0]", "30.2 [30.2, 30.2]"]
