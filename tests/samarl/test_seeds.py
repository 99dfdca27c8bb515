"""Interquartile means over training seeds, by hand."""

import numpy as np
import pytest

from samarl.evaluation.seeds import across_seeds, interquartile_mean, probability_of_improvement
from samarl.evaluation.table import rows_as_cells
from tests.samarl.test_summary import row


@pytest.mark.parametrize(
    ("values", "mean"),
    [([7.0], 7.0), ([3.0, 9.0], 6.0), ([1.0, 9.0, 5.0], 5.0), ([0.0, 1, 3, 100], 2.0),
     ([9.0, 0, 1, 2, 3, 100, 4, 5], 3.5)],
)  # fmt: skip
def test_the_lowest_and_the_highest_quarter_do_not_count(values: list[float], mean: float) -> None:
    assert interquartile_mean(np.array(values)) == pytest.approx(mean)


def test_three_seeds_by_hand() -> None:
    rows = [row(success_rate=s, social_score=s - 10.0) for s in (90.0, 96.0, 99.0)]
    found = across_seeds(rows)
    assert found["training_seeds"] == 3
    assert found["success_iqm"] == 95.0
    # Of 27 equally likely draws one is three times the worst seed, one three times the best:
    # 1 / 27 is more than 2.5 %, so these are the ends of the interval.
    assert (found["success_iqm_low"], found["success_iqm_high"]) == (90.0, 99.0)
    assert [found[f"social_{key}"] for key in ("iqm", "iqm_low", "iqm_high")] == [85.0, 80.0, 89.0]
    assert found["success_of_seeds"] == [90.0, 96.0, 99.0]
    assert found == across_seeds(rows)


def test_the_probability_of_improvement_by_hand() -> None:
    # One of our three seeds is worse: of 27 draws one, 3.7 %, is three times that seed.
    assert probability_of_improvement([3.0, 5.0, 1.0], [2.0]) == pytest.approx([2 / 3, 0.0, 1.0])
    share, _, _ = probability_of_improvement([1.0, 3.0], [1.0, 2.0])  # worse, equal, better twice
    assert share == pytest.approx(2.5 / 4)
    assert probability_of_improvement([2.0], [1.0]) == [1.0, 1.0, 1.0]


def test_the_tables_show_them_where_there_are_seeds() -> None:
    one, other = row(), row(method="other")
    assert "seeds" not in rows_as_cells([one, other])[0]
    header, lines = rows_as_cells([one, other | across_seeds([other, other])])
    assert header[-3:] == ("seeds", "success % over seeds", "social score over seeds")
    assert lines[0][-3:] == ["", "", ""]
    assert lines[1][-3:] == ["2", "25.0 [25.0, 25.0]", "30.2 [30.2, 30.2]"]
