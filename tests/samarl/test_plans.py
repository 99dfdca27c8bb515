"""Plans that are given up early are never the cheapest."""

import math
from typing import Any

import numba
import numpy as np
import pytest

from mrsan import Kinematics, Scenario, World
from mrsan.features import GOAL_X, GOAL_Y
from mrsan.parameters import kernel_parameters
from samarl.agents.planners.model_predictive import ModelPredictive
from samarl.planning.sampling import _cost
from samarl.planning.tracking import gather, track_velocity

PLANS = {
    "horizon": 2.0, "directions": 7, "speeds": 2, "holds": 2, "human_margin": 0.05,
    "robot_margin": 0.15, "comfort": 1.0, "comfort_weight": 12.0, "collision_weight": 100.0,
    "collision_discount": 0.6561,
}  # fmt: skip
TWO_PI = np.float32(2.0 * math.pi)


@pytest.mark.parametrize("kinematics", list(Kinematics))
@pytest.mark.parametrize("numbers", [
    {}, {"collision_discount": 0.0}, {"collision_discount": 1.0},
    {"collision_weight": 2.0, "comfort_weight": 120.0}, {"collision_weight": 0.0},
])  # fmt: skip
def test_the_cheapest_plan_is_the_cheapest_of_all(
    kinematics: Kinematics, numbers: dict[str, float]
) -> None:
    """Among many people, against plans that are all simulated to their ends."""
    scenario = Scenario(kinematics=kinematics, humans=12, robots=3, circle_radius=4.0)
    plans: dict[str, Any] = {**PLANS, **numbers}
    planner = ModelPredictive(scenario, **plans)
    p, best = kernel_parameters(scenario), np.empty(scenario.action_size, np.float32)
    sizes = (8, *(plans[name] for name in ("directions", "speeds", "holds")))  # 2 s: 8 steps
    per_step = {
        **plans, "comfort_weight": plans["comfort_weight"] / 4,
        "collision_discount": plans["collision_discount"] ** 0.25,
    }  # fmt: skip
    costs = tuple(np.float32(value) for value in list(per_step.values())[4:])
    world = World(scenario, 4, auto_reset=True)
    observation = world.reset(range(4))
    for _ in range(25):
        action = planner.act(observation)
        for e in range(4):
            for i in range(3):
                known = tuple(rows[e, i] for rows in observation.perception)
                every_plan(known, p, sizes, costs[:2], costs[2:], best)
                np.testing.assert_array_equal(action[e, i], best)
        observation = world.step(action).observation


@numba.njit(error_model="numpy")  # type: ignore[untyped-decorator]
def every_plan(known, p, numbers, margins, costs, best):  # type: ignore[no-untyped-def]
    """Writes the first action of the cheapest plan; each is simulated to its end."""
    ego, humans, humans_visible, robots, robots_visible = known
    horizon, directions, speeds, holds = numbers
    rows = np.empty((1 + len(humans) + len(robots), 5), np.float32)
    count = gather(
        ego, humans, humans_visible, robots, robots_visible, margins[0], margins[1], rows
    )
    speed = math.sqrt(rows[0, 2] * rows[0, 2] + rows[0, 3] * rows[0, 3])
    goal_x, goal_y = ego[GOAL_X], ego[GOAL_Y]
    ahead, cheapest = math.atan2(goal_y, goal_x), np.float32(np.inf)
    attempt = np.empty_like(best)
    for plan in range(directions * speeds * holds + 1):
        angle = ahead + TWO_PI * (np.float32(plan % directions) / np.float32(directions))
        wanted = p.robot_speed * np.float32(plan // directions % speeds + 1) / np.float32(speeds)
        hold = max(horizon // (plan // (directions * speeds) + 1), 1)
        if plan == directions * speeds * holds:
            wanted, hold = np.float32(0.0), horizon
        vx, vy = wanted * math.cos(angle), wanted * math.sin(angle)
        straight = np.zeros((len(rows), 1, 2), np.float32)
        cost = _cost(
            rows, straight, count, goal_x, goal_y, vx, vy, horizon, hold, *costs,
            np.float32(np.inf), attempt, p,
        )  # fmt: skip
        if cost < cheapest:
            cheapest = cost
            track_velocity(vx, vy, speed, best, p)
