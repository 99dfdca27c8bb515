"""What robots perceive: themselves, named groups of entities around them, and other sensors."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mrsan.state import Bools, Floats, Ints


class Entities(NamedTuple):
    """One group of entities; each slot belongs to one of them for the whole episode."""

    features: Floats  # [E, N, slots, F], zero where the mask is False
    mask: Bools  # [E, N, slots] what the robot perceives


class KnownMap(NamedTuple):
    """The map that robots know: views of the arrays of `State`, valid until the next step."""

    place: Floats  # [E, 9]
    walls: Floats  # [E, 12, W]
    corners: Floats  # [E, 6, V]
    corner_distance: Floats  # [E, V, V]


class Observation(NamedTuple):
    """The observations of all robots.

    Every scenario has the groups `humans` (M slots) and `robots` (N - 1 slots, the others in the
    order of their numbers) with `OTHER_FEATURES`. `Scenario.sensors` adds further groups and
    sensors; whoever does not know them ignores them.

    With team perception, agents that team-mates report count as perceived too; `reported` marks
    those that were only reported.
    """

    ego: Floats  # [E, N, 11], EGO_FEATURES
    entities: dict[str, Entities]
    sensors: dict[str, Floats]  # [E, N, ...] each
    reported: dict[str, Bools]  # of `humans` and `robots`; empty without team perception
    map: KnownMap | None = None  # of places with walls, with `Scenario.map_known`; for planners

    @property
    def humans(self) -> Floats:
        """Return the features of people, [E, N, M, 5]."""
        return self.entities["humans"].features

    @property
    def humans_visible(self) -> Bools:
        """Return which people are perceived, [E, N, M]."""
        return self.entities["humans"].mask

    @property
    def robots(self) -> Floats:
        """Return the features of the other robots, [E, N, N - 1, 5]."""
        return self.entities["robots"].features

    @property
    def robots_visible(self) -> Bools:
        """Return which other robots are perceived, [E, N, N - 1]."""
        return self.entities["robots"].mask

    @property
    def humans_reported(self) -> Bools:
        """Return which people were only reported, [E, N, M]."""
        return self.reported.get("humans", np.zeros_like(self.humans_visible))

    @property
    def robots_reported(self) -> Bools:
        """Return which other robots were only reported, [E, N, N - 1]."""
        return self.reported.get("robots", np.zeros_like(self.robots_visible))

    @property
    def agents(self) -> tuple[Floats, Floats, Bools, Floats, Bools]:
        """Return the arrays that compiled planners take: ego, then people, then other robots."""
        return self.ego, *self.entities["humans"], *self.entities["robots"]

    def arrays(self) -> dict[str, NDArray[Any]]:
        """Return all arrays by flat names, the keys of the wrappers.

        These are `ego`; `GROUP` and `GROUP_visible` of each group; `GROUP_reported`; and the names
        of the sensors.
        """
        return {
            **named_arrays(self.ego, self.entities, "visible"),
            **{f"{group}_reported": mask for group, mask in self.reported.items()},
            **self.sensors,
        }

    def of_worlds(self, worlds: Ints | Bools) -> Observation:
        """Return a copy of the rows of some worlds."""
        return Observation(
            self.ego[worlds],
            {
                name: Entities(group.features[worlds], group.mask[worlds])
                for name, group in self.entities.items()
            },
            {name: values[worlds] for name, values in self.sensors.items()},
            {name: mask[worlds] for name, mask in self.reported.items()},
            None if self.map is None else KnownMap(*(array[worlds] for array in self.map)),
        )


def parts_of_named(arrays: Mapping[str, Any], mask: str) -> tuple[Any, dict[str, Any], dict]:
    """Return the ego, the pairs of features and mask of each group, and the rest by name.

    The inverse of `named_arrays`.
    """
    rest = dict(arrays.items())  # a TensorDict would iterate over its rows
    ending = f"_{mask}"
    groups = [name.removesuffix(ending) for name in rest if name.endswith(ending)]
    entities = {name: (rest.pop(name), rest.pop(f"{name}{ending}")) for name in groups}
    return rest.pop("ego"), entities, rest


def named_arrays(ego: Any, entities: dict[str, Any], mask: str) -> dict[str, Any]:
    """Return `ego`, and the features and the mask of each group as `GROUP` and `GROUP_mask`."""
    arrays = {"ego": ego}
    for name, group in entities.items():
        arrays[name], arrays[f"{name}_{mask}"] = group
    return arrays
