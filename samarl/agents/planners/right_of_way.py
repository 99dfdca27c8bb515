"""Planner among walls that knows who goes first through doors and corridors."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray

from mrsan import Observation
from mrsan.features import GOAL
from mrsan.fields import setting
from mrsan.observation import KnownMap
from mrsan.parameters import kernel_parameters
from mrsan.passages import Passages, find_passages, open_width
from mrsan.sensors.team import MESSAGE_FEATURES
from samarl.agents.agent import Agent
from samarl.macro_level.network import load_macro_level
from samarl.observations.features import to_body
from samarl.planning.passage_driving import direct, drive
from samarl.planning.passage_features import MATE, OWN, TRUTH, write_features
from samarl.planning.passage_memory import empty_memory, mouths_of_worlds, open_floor
from samarl.planning.right_of_way import BY_RULE, ENTER, QUEUE, Memory
from samarl.planning.team_beliefs import perceive
from samarl.policies.explanation import Explanation

RANDOM, ALL_ENTER = "random", "enter"  # of `RightOfWay.macro_level`, for ablations


Robots = tuple[NDArray[np.int64], ...]  # worlds and numbers of robots, [B] each
Chooser = Callable[[Robots], NDArray[np.int64]]  # returns `QUEUE` or `ENTER` for each


@dataclass
class RightOfWay(Agent):
    """Follows routes by rollouts, passes doors in one direction at a time, and queues beside them.

    The rule is that of `samarl.planning.right_of_way`. Robots know the map
    (`Scenario.map_known`) and what team-mates tell (`Scenario.team_messages`).

    Attributes:
        chooser: called for the robots that have to choose whether they enter a passage or queue;
            None: they follow the rule.
    """

    central: bool = setting(
        False,
        help="privileged: robots know goals and plans of all team-mates, wherever they are",
    )
    macro_level: str | None = setting(
        None,
        help="who chooses who enters a passage: a trained macro level (a file, the folder of its "
        "training, or the name of an included one), random, or enter: everybody; null: the rule",
    )
    sampled: bool = setting(
        False, help="draw the choices of the macro level instead of the likeliest"
    )

    def __post_init__(self) -> None:
        """Start without memory.

        Raises:
            ConfigurationError: a number is out of range.
        """
        super().__post_init__()
        self._random = np.random.default_rng(0)
        self.use(self.macro_level, self.sampled)
        self._passages: list[Passages | None] = []  # of each world
        self._is_init = np.zeros(0, np.bool_)

    def use(self, macro_level: str | None, sampled: bool = False) -> None:
        """Let a macro level choose; the arguments are the fields of these names.

        Raises:
            ConfigurationError: there is no such macro level.
        """
        self.macro_level, self.sampled, self._network = macro_level, sampled, None
        self.chooser: Chooser | None = None if macro_level is None else self._choices
        if macro_level not in (None, RANDOM, ALL_ENTER):
            self._network = load_macro_level(macro_level, "agent.macro_level")

    def scope_warning(self) -> str | None:
        """Return whether robots do not hear of each other."""
        if self.central or self.scenario.team_messages or self.scenario.robots == 1:
            return None
        return "it is made for scenario.team_messages=true; here robots do not tell who goes first"

    def reset(self, worlds: NDArray[np.bool_]) -> None:
        """Clear the memory of the worlds [E] in which an episode begins."""
        if len(self._is_init) != len(worlds):
            self._is_init = np.ones(len(worlds), np.bool_)
            self._passages = [None] * len(worlds)
            self._memory = empty_memory(len(worlds), self.scenario.robots)
        self._is_init |= worlds

    def act(self, observation: Observation) -> NDArray[np.float32]:
        """Return the actions, after robots have chosen who goes first."""
        self.decide(observation)
        return self.drive()

    def decide(self, observation: Observation) -> None:
        """Choose who goes first, by the rule or the macro level; then call `drive` or `direct`."""
        self.perceive(observation)
        if self.chooser is not None and self._memory.due.any():
            due = np.nonzero(self._memory.due)
            self._memory.choice[due] = self.chooser(due)

    def _choices(self, due: Robots) -> NDArray[np.int64]:
        """Return whether robots (world and number [B]) queue or enter, `QUEUE` or `ENTER` [B]."""
        if self._network is None:
            chance = np.full(len(due[0]), 1.0 if self.macro_level == ALL_ENTER else 0.5)
            return self._draw(chance)
        own, mates, _ = self.features()
        with torch.no_grad():
            logits = self._network(torch.from_numpy(own[due]), torch.from_numpy(mates[due]))
        if self.sampled:
            return self._draw(torch.softmax(logits, -1)[:, ENTER].numpy())
        choices: NDArray[np.int64] = logits.argmax(-1).numpy()
        return choices

    def _draw(self, chance: NDArray[np.floating]) -> NDArray[np.int64]:
        """Return `ENTER` with these chances [B], and `QUEUE` otherwise."""
        return np.where(self._random.random(len(chance)) < chance, ENTER, QUEUE)

    def perceive(self, observation: Observation) -> None:
        """Update beliefs, passages, and whose choice is due."""
        e, n = observation.ego.shape[:2]
        if len(self._is_init) != e:
            self.reset(np.ones(e, np.bool_))
        self._map = observation.map or open_floor(e)
        if self._is_init.any():
            self._begin(self._map)
        self._observation = observation
        if "messages" in observation.entities:
            messages, received = observation.entities["messages"]
            priority = observation.sensors["priority"]
        else:
            messages = np.zeros((e, n, n - 1, len(MESSAGE_FEATURES)), np.float32)
            received, priority = np.zeros((e, n, n - 1), np.bool_), np.zeros((e, n, 1), np.float32)
        ego, _, _, robots, robots_visible = observation.agents
        perceive(
            e,
            ego,
            robots,
            robots_visible,
            messages,
            received,
            priority,
            self._map,
            *self._mouths,
            self._memory,
            self.central,
            kernel_parameters(self.scenario),
        )

    def features(self) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.float32]]:
        """Return what robots whose choice is due know, as `write_features` describes it.

        Returns:
            [E, N, OWN], [E, N, N - 1, MATE], and what is true [E, N, N - 1, MATE + TRUTH]; other
            rows are 0.
        """
        e, n = self._memory.due.shape
        own = np.zeros((e, n, OWN), np.float32)
        mates = np.zeros((e, n, n - 1, MATE), np.float32)
        truth = np.zeros((e, n, n - 1, MATE + TRUTH), np.float32)
        ego, humans, humans_visible, _, _ = self._observation.agents
        write_features(
            e, ego, humans, humans_visible, *self._mouths, self._memory, own, mates, truth
        )
        return own, mates, truth

    def drive(self) -> NDArray[np.float32]:
        """Return the actions of rollouts along the path, after `decide`."""
        ego, humans, humans_visible, _, _ = self._observation.agents
        action = np.zeros((*ego.shape[:2], self.scenario.action_size), np.float32)
        drive(
            len(ego),
            ego,
            humans,
            humans_visible,
            self._map,
            *self._mouths,
            self._memory,
            self.central,
            kernel_parameters(self.scenario),
            action,
        )
        return action

    def direct(self) -> Observation:
        """Return the observation of a policy that is sent to its goal or to a queue place.

        Call it after `decide`. The target takes the place of the goal, and the way
        there that of the route; messages are left out.
        """
        observation = self._observation
        target = np.zeros((*observation.ego.shape[:2], 2))
        following = target.copy()
        direct(
            len(target),
            self._map,
            *self._mouths,
            self._memory,
            self.central,
            kernel_parameters(self.scenario),
            target,
            following,
        )
        ego = observation.ego.copy()
        ego[..., GOAL] = to_body(target.astype(np.float32), observation.ego)
        route = to_body(following.astype(np.float32), observation.ego)
        hidden = ("messages", "priority")
        return observation._replace(
            ego=ego,
            entities={k: v for k, v in observation.entities.items() if k not in hidden},
            sensors={
                **{k: v for k, v in observation.sensors.items() if k not in hidden},
                "route": route,
            },
        )

    @property
    def waits(self) -> NDArray[np.bool_]:
        """Which robots [E, N] are sent to a queue place."""
        waits: NDArray[np.bool_] = (self._memory.queued >= 0) | (self._memory.yields > 0)
        return waits

    @property
    def memory(self) -> Memory:
        """What robots believe and do; arrays [E, ...]."""
        return self._memory

    def restore(self, memory: Memory, observation: Observation) -> None:
        """Continue with a copy of an earlier `memory`, in the same places."""
        worlds = len(observation.ego)
        self.reset(np.ones(worlds, np.bool_))
        self._begin(observation.map or open_floor(worlds))
        for array, saved in zip(self._memory, memory, strict=True):
            array[:] = saved

    def macro_actions(self) -> NDArray[np.int32]:
        """Return what robots tell: what they do, and at which mouth they enter their passage."""
        numbers: NDArray[np.int32] = self._memory.macro_action
        return numbers

    def explain(self) -> Explanation:
        """Return what each robot does, and the queue place or goal that it drives to."""
        memory = self._memory
        waypoint = np.where(self.waits[..., None], memory.place, memory.goal)
        return Explanation(waypoint=waypoint, activity=memory.mode.astype(np.int8))

    def _begin(self, known_map: KnownMap) -> None:
        """Find the passages of the worlds in which an episode begins."""
        widest = open_width(self.scenario.robot_radius)
        for e in np.flatnonzero(self._is_init):
            walls, place = known_map.walls[e], known_map.place[e]
            self._passages[e] = find_passages(walls, place, widest)
            memory = self._memory
            memory.is_new[e], memory.queued[e], memory.stuck[e] = True, -1, 0
            memory.known[e], memory.macro_action[e] = False, 0
            memory.event[e], memory.age[e], memory.yields[e] = -1, 0, 0
            memory.choice[e] = BY_RULE
        self._is_init[:] = False
        self._mouths = mouths_of_worlds([p for p in self._passages if p is not None])
