"""Warnings about training runs that are likely to fail."""

from __future__ import annotations

from collections.abc import Mapping

# Norms before clipping. The included policies were trained with at most 135.
LARGEST_GRADIENT_NORM = 1e3
# nats, of the actions of one level. Below: the standard deviation of three numbers is less than
# 0.005, so nothing is explored; above: it is more than 1.8, beyond the range [-1, 1] of actions.
# The included policies were trained with -6 to 1.5.
ENTROPIES = (-12.0, 6.0)


class Health:
    """Watch the learning curve; each warning is given once."""

    def __init__(self) -> None:
        """Start without warnings."""
        self.warnings: dict[str, str] = {}  # by the statistic that causes them
        self._succeeded = False

    def update(self, row: Mapping[str, float], progress: float) -> list[str]:
        """Return the new warnings after a round."""
        new: dict[str, str] = {}
        for name, value in row.items():
            if name.endswith("gradient_norm") and value > LARGEST_GRADIENT_NORM:
                new[name] = (
                    f"{name} is {value:.3g}, above {LARGEST_GRADIENT_NORM:g}: the training "
                    "diverges; a smaller algorithm.learning_rate may help"
                )
            if name.endswith("entropy") and not ENTROPIES[0] <= value <= ENTROPIES[1]:
                new[name] = (
                    f"{name} is {value:.3g}, outside {ENTROPIES[0]:g} to {ENTROPIES[1]:g}: the "
                    "policy explores nothing or acts at random; check "
                    "algorithm.entropy_coefficient and the scale of the reward"
                )
        self._succeeded |= any(
            value > 0.0 for name, value in row.items() if "success" in name and "score" not in name
        )
        if progress >= 0.5 and not self._succeeded:
            new["charts/success"] = (
                "no episode has succeeded in the first half of the steps; check the scenario with "
                "a planner (samarl-evaluate agent=model_predictive), or train for longer"
            )
        new = {name: text for name, text in new.items() if name not in self.warnings}
        self.warnings |= new
        return list(new.values())
