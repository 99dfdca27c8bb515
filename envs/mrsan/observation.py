"""What robots perceive: themselves, named groups of entities around them, and other sensors."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any, Generic, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mrsan.state import Bools, Floats, Ints

if TYPE_CHECKING:
    from typing_extensions import TypeVar

    A = TypeVar("A", default=NDArray[Any])
    B = TypeVar("B", default=NDArray[Any])
else:
    from typing import TypeVar

    A, B = TypeVar("A"), TypeVar("B")


class Entities(NamedTuple, Generic[A]):
    """One group of entities; each slot belongs to one of them for the whole episode."""

    features: A  # [E, N, slots, F], zero where the mask is False
    mask: A  # [E, N, slots] bool: what the robot perceives


class KnownMap(NamedTuple):
    """The map that robots know: views of the arrays of `State`, valid until the next step."""

    place: Floats  # [E, 9]
    walls: Floats  # [E, 12, W]
    corners: Floats  # [E, 6, V]
    corner_distance: Floats  # [E, V, V]


class Observation(NamedTuple, Generic[A]):
    """What robots perceive, what they remember of it, or what their networks get of that.

    Every scenario has the groups `humans` (M slots) and `robots` (N - 1 slots, the others in the
    order of their numbers) with `OTHER_FEATURES`. `Scenario.sensors` adds further groups and
    sensors; whoever does not know them ignores them.

    With team perception, agents that team-mates report count as perceived too; `reported` marks
    those that were only reported.
    """

    ego: A  # [E, N, 11], EGO_FEATURES
    entities: dict[str, Entities[A]]
    sensors: dict[str, A]  # [E, N, ...] each
    reported: Mapping[str, A] = {}  # of `humans` and `robots`; empty without team perception
    map: KnownMap | tuple[()] = ()  # with `Scenario.map_known` in walled environments; for planners

    @property
    def humans(self) -> A:
        """Return the features of people, [E, N, M, 5]."""
        return self.entities["humans"].features

    @property
    def humans_visible(self) -> A:
        """Return which people are perceived, [E, N, M]."""
        return self.entities["humans"].mask

    @property
    def robots(self) -> A:
        """Return the features of the other robots, [E, N, N - 1, 5]."""
        return self.entities["robots"].features

    @property
    def robots_visible(self) -> A:
        """Return which other robots are perceived, [E, N, N - 1]."""
        return self.entities["robots"].mask

    @property
    def humans_known(self) -> A:
        """Return which people are perceived or remembered, [E, N, M]."""
        return self.entities["humans"].mask

    @property
    def robots_known(self) -> A:
        """Return which other robots are perceived or remembered, [E, N, N - 1]."""
        return self.entities["robots"].mask

    @property
    def humans_reported(self) -> A | Bools:
        """Return which people were only reported, [E, N, M]."""
        return self.reported.get("humans", np.zeros_like(self.humans_visible))

    @property
    def robots_reported(self) -> A | Bools:
        """Return which other robots were only reported, [E, N, N - 1]."""
        return self.reported.get("robots", np.zeros_like(self.robots_visible))

    @property
    def agents(self) -> tuple[A, A, A, A, A]:
        """Return the arrays that compiled planners take: ego, then people, then other robots."""
        return self.ego, *self.entities["humans"], *self.entities["robots"]

    def arrays(self, mask: str = "visible") -> dict[str, A]:
        """Return all arrays by flat names, by default those of the wrappers.

        These are `ego`; `GROUP` and `GROUP_visible` of each group; `GROUP_reported`; and the names
        of the sensors. With another `mask`, such as `known`, masks are called `GROUP_known`.
        """
        arrays = {"ego": self.ego}
        for name, group in self.entities.items():
            arrays[name], arrays[f"{name}_{mask}"] = group
        reported = {f"{group}_reported": values for group, values in self.reported.items()}
        return {**arrays, **reported, **self.sensors}

    @staticmethod
    def from_arrays(arrays: Mapping[str, B]) -> Observation[B]:
        """Return the observation, without reports, whose `arrays` these are, visible or known."""
        rest = dict(arrays.items())  # a TensorDict would iterate over its rows
        masks = [name for name in rest if name.endswith(("_visible", "_known"))]
        entities = {
            (group := name.rpartition("_")[0]): Entities(rest.pop(group), rest.pop(name))
            for name in masks
        }
        return Observation(rest.pop("ego"), entities, rest)

    def apply(self, function: Callable[[A], B]) -> Observation[B]:
        """Apply a function to every array but those of the map, which is left out."""
        return Observation(
            function(self.ego),
            {
                name: Entities(function(features), function(mask))
                for name, (features, mask) in self.entities.items()
            },
            {name: function(values) for name, values in self.sensors.items()},
            {name: function(mask) for name, mask in self.reported.items()},
        )

    def select(self, rows: Any) -> Observation[A]:
        """Return some rows of every array, without the map."""
        return self.apply(lambda array: array[rows])  # type: ignore[index]

    def of_worlds(self, worlds: Ints | Bools | slice) -> Observation[A]:
        """Return the rows of some worlds, with the map; not copied for a slice."""
        copied = [array[worlds] for array in self.map]
        return self.select(worlds)._replace(map=KnownMap(*copied) if copied else ())

    def of_robots(self, robots: Bools) -> Observation[A]:
        """Return what some robots [E, N] perceive, R of them, as [R, 1, ...]."""
        return self.apply(lambda array: array[robots][:, None])  # type: ignore[index]
