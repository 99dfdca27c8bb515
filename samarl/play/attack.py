"""The smallest change of one person's path that makes a policy fail.

Random search and then the cross-entropy method (Rubinstein and Kroese, 2004) over offsets from the
path that the person would walk anyway. Every path keeps to walking speed. A path that makes the
policy fail costs the size of its offset, any other one more: by how far it is from a contact.
"""

from __future__ import annotations

import time
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mrsan import ConfigurationError, Crowd, World
from mrsan.metrics import episodes_of
from samarl.agents import Agent
from samarl.agents.agent import act_and_tell
from samarl.evaluation.trajectory import record_episode
from samarl.play.scene import Scene

WALKING_SPEED = 1.4  # m/s, of attacking people
POPULATION = 24  # paths of a generation, simulated together
_ELITE = 6
_KNOTS = 4  # of a path, between which its offset is interpolated
_SPREAD = 1.5  # m, of the first offsets
_PEOPLE = 3  # who are tried, those who are there from the start and come closest to a robot
_HARMLESS = 100.0  # cost of a path that does not make the policy fail, m
_PATIENCE = 5  # generations without improvement after which the search ends
_FAILURES = {  # the properties of `Episodes` in words
    "robot_on_person": "a robot runs into a person",
    "person_on_robot": "a person runs into a robot",
    "hit_robot": "two robots collide",
    "hit_wall": "a robot hits a wall",
    "timeout": "a robot does not arrive in time",
}
Floats = NDArray[np.float64]


class Attempt(NamedTuple):
    """A path and what it does."""

    cost: float
    person: int
    path: Floats  # [T + 1, 2] m
    failure: str  # in words; empty if there is none

    @property
    def fails(self) -> bool:
        """Return whether the policy fails."""
        return self.cost < _HARMLESS


class Attack:
    """A search that is run generation by generation."""

    def __init__(self, agent: Agent, scene: Scene, folder: Path, seed: int = 0) -> None:
        """Play the scene without an attack, and prepare the search.

        Args:
            agent: who is attacked; it is not changed.
            scene: the start, and what happens anyway.
            folder: for the file of the scene.
            seed: of the random numbers.

        Raises:
            ConfigurationError: the agent fails without an attack, or nobody can be moved.
        """
        started = time.process_time()
        scenario = scene.write(folder / "attack.yaml")
        played = record_episode(agent.for_scenario(scenario), scenario, scene.case, True)
        if not played.episodes.success[0]:
            raise ConfigurationError(
                "the agent fails in this case by itself; choose another case to attack it"
            )
        candidates = np.flatnonzero(played.human_present[0])
        if scene.scenario.crowd == Crowd.recorded or not len(candidates):
            raise ConfigurationError("there are no simulated people who could be moved")
        self.scene = scene
        self._scenario = scenario
        self._world = World(scenario, POPULATION)
        self._agent = agent.for_scenario(scenario)
        self._random = np.random.default_rng(seed)
        self._nominal = played.human_position.astype(np.float64)  # [T + 1, M, 2]
        gaps = np.linalg.norm(
            played.human_position[:, :, None] - played.robot_position[:, None], axis=-1
        )
        closest = np.where(played.human_present.T, gaps.min(2).T, np.inf)  # [M, T + 1]
        self._people = candidates[np.argsort(closest[candidates].min(1))[:_PEOPLE]]
        self._moment = closest.argmin(1)  # when each comes closest
        self._means = {int(j): np.zeros((_KNOTS, 2)) for j in self._people}
        self._spreads = {int(j): np.full((_KNOTS, 2), _SPREAD) for j in self._people}
        self.best: Attempt | None = None
        self.tried = self._stale = 0
        self.seconds = time.process_time() - started  # of processor time

    @property
    def is_over(self) -> bool:
        """Return whether more generations are not expected to find anything better."""
        return self.best is not None and self.best.fails and self._stale >= _PATIENCE

    def run_generation(self) -> None:
        """Try one population of paths."""
        started = time.process_time()
        people = np.resize(self._people, POPULATION)
        if self.best is not None and self.best.fails:
            people[:] = self.best.person  # the others are harder to reach
        noise = self._random.standard_normal((POPULATION, _KNOTS, 2))
        # Some small changes and some large ones.
        noise *= self._random.uniform(0.2, 1.0, (POPULATION, 1, 1))
        offsets = np.stack(
            [
                self._means[int(j)] + self._spreads[int(j)] * sample
                for j, sample in zip(people, noise, strict=True)
            ]
        )
        paths = [self._path(int(j), offset) for j, offset in zip(people, offsets, strict=True)]
        attempts = self._play(people, paths)
        self.tried += POPULATION
        self._stale += 1
        for attempt in attempts:
            if self.best is None or attempt.cost < self.best.cost - 0.01:
                self.best, self._stale = attempt, 0
        for j in self._means:
            of_person = np.flatnonzero(people == j)
            if len(of_person) < 2:
                continue
            order = of_person[np.argsort([attempts[k].cost for k in of_person])]
            elite = offsets[order[: max(2, _ELITE * len(of_person) // POPULATION)]]
            self._means[j] = elite.mean(0)
            self._spreads[j] = elite.std(0) + 0.05
        self.seconds += time.process_time() - started

    def attacked_scene(self) -> Scene:
        """Return the scene with the best path."""
        assert self.best is not None
        scene = self.scene.copy()
        humans, j = scene.scenario.humans, self.best.person
        scene.people = scene.people or [None] * humans
        step, walked = self._scenario.time_step, self.best.path[1:].tolist()
        path = [[round((k + 1) * step, 6), x, y] for k, (x, y) in enumerate(walked)]
        scene.people[j] = {**(scene.people[j] or {}), "path": path}
        return scene

    def _path(self, j: int, offset: Floats) -> Floats:
        """Return the positions [T + 1, 2] of a person whose path is changed by offsets [K, 2].

        The offset grows from zero at the start to its last knot, shortly after the person would
        come closest to a robot.
        """
        nominal = self._nominal[:, j]
        last = min(int(self._moment[j]) + self._scenario.steps(2.0), len(nominal) - 1)
        knots = np.linspace(0, max(last, 1), _KNOTS + 1)
        step = np.arange(last + 1)
        changed = nominal[: last + 1] + np.stack(
            [np.interp(step, knots, [0.0, *offset[:, axis]]) for axis in range(2)], -1
        )
        path = [nominal[0]]
        reach = WALKING_SPEED * self._scenario.time_step - 0.0015  # below: rounded to millimetres
        for target in changed[1:]:
            way = target - path[-1]
            path.append(path[-1] + way * min(1.0, reach / max(float(np.hypot(*way)), 1e-9)))
        return np.round(path, 3)

    def _play(self, people: NDArray[np.intp], paths: list[Floats]) -> list[Attempt]:
        """Play every path in a world of its own."""
        world, agent = self._world, self._agent
        assert world.script is not None
        world.script.paths[:] = np.nan
        for e, (j, path) in enumerate(zip(people, paths, strict=True)):
            world.script.paths[e, j, 1 : len(path)] = path[1:]
        observation = world.reset(np.full(POPULATION, self.scene.case))
        agent.reset(np.ones(POPULATION, np.bool_))
        while not world.state.done.all():
            agent.focus(~world.state.done[:, None] & ~world.state.arrived)
            observation = world.step(act_and_tell(agent, observation, world)).observation
        episodes = episodes_of(world.state, self._scenario, np.ones(POPULATION, np.bool_))
        kinds = {kind: getattr(episodes, kind) for kind in _FAILURES}
        attempts = []
        for e, (j, path) in enumerate(zip(people, paths, strict=True)):
            change = path - self._nominal[: len(path), j]
            cost = float(np.linalg.norm(change, axis=1).max())
            if episodes.success[e]:
                cost = _HARMLESS + float(episodes.closest_human[e].min())
            failure = next((words for kind, words in _FAILURES.items() if kinds[kind][e]), "")
            attempts.append(Attempt(cost, int(j), path, failure))
        return attempts
