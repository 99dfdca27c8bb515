"""Aggregation of results over training seeds."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from samarl.evaluation.summary import Column, Row, column_of
from samarl.files import find_folder

_RESAMPLES = 10_000


def without_seed(name: str) -> str:
    """Return the name of a policy or curve without its training seed: `NAME` for `NAME_seedK`."""
    return re.sub(r"_seed\d+$", "", name)


def other_seeds(name: str) -> list[str]:
    """Return the shipped policies that differ from `name` in their training seed only."""
    shipped = (find_folder("results") / "checkpoints").glob("*.safetensors")
    return sorted(path.stem for path in shipped if without_seed(path.stem) == name != path.stem)


def across_seeds(rows: Sequence[Row]) -> Row:
    """Aggregate the rows of one method in one column, one row per training seed.

    Returns:
        The number of seeds, and for success rate and social score the value of each seed, their
        mean and their range. Two or three seeds are too few for an interquartile mean.
    """
    result: Row = {"training_seeds": len(rows)}
    for name, field in (("success", "success_rate"), ("social", "social_score")):
        values = np.array([row[field] for row in rows])
        result[f"{name}_of_seeds"] = values.tolist()
        for key, value in (("mean", values.mean()), ("min", values.min()), ("max", values.max())):
            result[f"{name}_seed_{key}"] = round(float(value), 2)
    return result


def probability_of_improvement(ours: Sequence[float], theirs: Sequence[float]) -> list[float]:
    """Return how likely a training seed of ours is better than one of theirs.

    Source: Agarwal et al., 2021.

    Returns:
        The share of pairs of seeds in which ours is better, ties counting one half, and its 95 %
        interval over bootstrap samples of the seeds of both methods.
    """
    difference = np.subtract.outer(np.array(ours), np.array(theirs))
    share = (difference > 0) + 0.5 * (difference == 0)
    generator = np.random.default_rng(0)
    our_sample, their_sample = (generator.integers(n, size=(_RESAMPLES, n)) for n in share.shape)
    samples = share[our_sample[:, :, None], their_sample[:, None, :]].mean(axis=(1, 2))
    return [float(share.mean()), *map(float, np.percentile(samples, [2.5, 97.5]))]


class Improvements(NamedTuple):
    """How likely seeds of some methods are better than seeds of others in one quantity."""

    quantity: str
    others: list[str]  # the other methods with their numbers of seeds, [M]
    columns: list[tuple[str, Column]]  # method and column of a table, [C]
    estimates: NDArray[np.float64]  # [M, C, 3] probability and its interval; NaN: not comparable


def improvements(rows: Sequence[Row], methods: Sequence[str]) -> list[Improvements]:
    """Return the probabilities of improvement in success and in social score.

    `methods` are compared with all others in the columns both have played.

    Returns:
        Nothing if no rows of several seeds can be compared.
    """
    with_seeds = [row for row in rows if "success_of_seeds" in row]
    ours = [row for method in methods for row in with_seeds if row["method"] == method]
    matrices = []
    for quantity, key in (("Success", "success_of_seeds"), ("Social score", "social_of_seeds")):
        lines: dict[str, NDArray[np.float64]] = {}
        for theirs in with_seeds:
            for i, row in enumerate(ours):
                same_cases = all(row[field] == theirs[field] for field in ("episodes", "seed"))
                if same_cases and column_of(row) == column_of(theirs) and row is not theirs:
                    name = f"{theirs['method']} ({theirs['training_seeds']} seeds)"
                    line = lines.setdefault(name, np.full((len(ours), 3), np.nan))
                    line[i] = probability_of_improvement(row[key], theirs[key])
        if lines:
            columns = [(row["method"], column_of(row)) for row in ours]
            matrices.append(
                Improvements(quantity, list(lines), columns, np.stack(list(lines.values())))
            )
    return matrices
