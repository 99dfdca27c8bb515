"""Over training seeds: the interquartile mean with a bootstrap interval (Agarwal et al., 2021)."""

from __future__ import annotations

import re
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from samarl.evaluation.summary import Row
from samarl.files import find_folder

_RESAMPLES = 10_000


def without_seed(name: str) -> str:
    """What a policy or a curve is called whatever its training seed: `NAME_seedK` is NAME."""
    return re.sub(r"_seed\d+$", "", name)


def other_seeds(name: str) -> list[str]:
    """The shipped policies that differ from the one of this name by their training seed alone."""
    shipped = (find_folder("results") / "checkpoints").glob("*.safetensors")
    return sorted(path.stem for path in shipped if without_seed(path.stem) == name != path.stem)


def interquartile_mean(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """The mean of [..., S] without the lowest and the highest quarter; of all, if S < 4."""
    cut = values.shape[-1] // 4
    kept: NDArray[np.float64] = np.sort(values)[..., cut : values.shape[-1] - cut].mean(axis=-1)
    return kept


def across_seeds(rows: Sequence[Row]) -> Row:
    """What the rows of one method in one column, each of another training seed, say together.

    Args:
        rows: one for each training seed.

    Returns:
        The number of seeds, and of success rate and social score those of each seed and the
        interquartile mean with its 95 % interval, seeds drawn with replacement.
    """
    drawn = np.random.default_rng(0).integers(len(rows), size=(_RESAMPLES, len(rows)))
    found: Row = {"training_seeds": len(rows)}
    for name, field in (("success", "success_rate"), ("social", "social_score")):
        values = np.array([row[field] for row in rows])
        low, high = np.percentile(interquartile_mean(values[drawn]), [2.5, 97.5])
        of_all = (("iqm", interquartile_mean(values)), ("iqm_low", low), ("iqm_high", high))
        found[f"{name}_of_seeds"] = values.tolist()
        found |= {f"{name}_{key}": round(float(value), 2) for key, value in of_all}
    return found


def probability_of_improvement(ours: Sequence[float], theirs: Sequence[float]) -> list[float]:
    """How likely a training seed of ours is better than one of theirs (Agarwal et al., 2021).

    Args:
        ours: what each seed reaches.
        theirs: likewise, of another method in the same column.

    Returns:
        The share of the pairs of seeds in which ours is better, equals counting half, and its 95 %
        interval, seeds of both drawn with replacement.
    """
    better = np.subtract.outer(np.array(ours), np.array(theirs))
    share = (better > 0) + 0.5 * (better == 0)
    generator = np.random.default_rng(0)
    mine, others = (generator.integers(n, size=(_RESAMPLES, n)) for n in share.shape)
    drawn = share[mine[:, :, None], others[:, None, :]].mean(axis=(1, 2))
    return [float(share.mean()), *map(float, np.percentile(drawn, [2.5, 97.5]))]
