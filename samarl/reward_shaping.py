"""Reward shaping: the rewards of each level of a policy in training.

Rewards are shaped here, while experience is collected.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mrsan import Observation, Scenario, Step
from mrsan.features import GOAL
from samarl.observations.features import speed_of, to_world
from samarl.policies.hierarchical import HierarchicalPolicy
from samarl.policies.macro_actions import HierarchicalConfig
from samarl.policies.policy import LOCAL, MACRO, Policy, PolicyState

Floats = NDArray[np.float32]


@dataclass(frozen=True)
class RewardShaping:
    """The shaping that an algorithm asks for, which is the same for all policies."""

    path_penalty: float = 0.0  # per metre driven
    team_bonus: bool = True  # include the reward for the arrival of the whole team
    shared: bool = False  # each robot receives the sum over its team (MSA3C, Eq. 5)


def level_rewards(
    policy: Policy,
    shaping: RewardShaping,
    scenario: Scenario,
    before: Observation,
    step: Step,
    state: PolicyState,
    active: NDArray[np.bool_],
    penalty: Floats | float = 0.0,
    is_directed: bool = False,
) -> dict[str, Floats]:
    """Return the reward of each level for one step, [E, N] each.

    The top level receives the task's reward. A local level below it is rewarded for following its
    waypoint.

    Args:
        policy: which decided.
        shaping: what the algorithm asks for.
        scenario: the task.
        before: the observation from which the decision was made.
        step: the outcome, whose observation is from before any reset.
        state: the policy's memory after the decision.
        active: [E, N] the robots that had not arrived when the step began.
        penalty: [E, N] of robots that have stood for too long, see `CurriculumStage`.
        is_directed: robots are rewarded for progress to the next point of the way in `before`.
    """
    task = _task_reward(policy, shaping, scenario, before, step, is_directed)
    rewards = {LOCAL: task}
    if isinstance(policy, HierarchicalPolicy):
        waypoint = state["waypoint"].view(*task.shape, 2).cpu().numpy()
        rewards = {MACRO: task, LOCAL: _waypoint_reward(policy.config, waypoint, before, step)}
    if shaping.path_penalty > 0.0:
        per_speed = np.float32(shaping.path_penalty * scenario.time_step)
        penalty = penalty + per_speed * speed_of(step.observation.ego) * active
    return {level: reward - penalty for level, reward in rewards.items()}


def _task_reward(
    policy: Policy,
    shaping: RewardShaping,
    scenario: Scenario,
    before: Observation,
    step: Step,
    is_directed: bool,
) -> Floats:
    """Return the task's reward [E, N], with progress along the route instead of to the goal."""
    reward, parts = step.reward, step.reward_parts
    goes_round = scenario.fov_degrees < policy.config.perimeter_below_fov
    if is_directed or (goes_round and not scenario.has_walls):
        target = to_world(policy.route(before, scenario), before.ego)
        progress = np.float32(scenario.reward.progress) * progress_to(target, before, step)
        reward = np.where(parts.progress != 0.0, reward - parts.progress + progress, reward)
    if not shaping.team_bonus:
        reward = reward - parts.team
    if shaping.shared:
        reward = np.repeat(reward.sum(1, keepdims=True), reward.shape[1], 1)
    return reward


def _waypoint_reward(
    config: HierarchicalConfig, waypoint: Floats, before: Observation, step: Step
) -> Floats:
    """Return the reward [E, N] of a local level, with progress to waypoints [E, N, 2].

    Without an arrival bonus endless waypoint following would pay more than arriving, and a robot
    that does not know its goal would circle its waypoint.
    """
    parts = step.reward_parts
    progress = np.float32(config.waypoint_progress) * progress_to(waypoint, before, step)
    reward = parts.collision + parts.discomfort + parts.lookahead + parts.time
    reward += np.where(parts.progress != 0.0, progress, np.float32(0.0))
    reward += parts.arrival + np.float32(config.arrival_bonus) * (parts.arrival > 0.0)
    return reward


def progress_to(target: Floats, before: Observation, step: Step) -> Floats:
    """Return by how many metres each robot came nearer to a target in the world frame, [E, N]."""
    return distance_to(target, before) - distance_to(target, step.observation)


def distance_to(target: Floats, observation: Observation) -> Floats:
    """Return the distance of each robot from a target in the world frame, [E, N], m."""
    position = to_world(np.zeros_like(observation.ego[..., GOAL]), observation.ego)
    distance: Floats = np.linalg.norm(position - target, axis=-1)
    return distance
