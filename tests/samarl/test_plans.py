"""The sampling planner's pruning never changes which plan is the cheapest."""

import math
from typing import Any

import numba
import numpy as np
import pytest

from mrsan import Kinematics, Scenario, World
from mrsan.features import GOAL_X, GOAL_Y
from mrsan.kernels.walls import WALL_ROWS
from mrsan.parameters import kernel_parameters
from samarl.agents.planners.model_predictive import ModelPredictive
from samarl.planning.sampling import PlanParameters, _cost, plan_parameters
from samarl.planning.velocity_control import gather_rows, track_velocity

PLANS = {
    "horizon": 2.0,
    "directions": 7,
    "speeds": 2,
    "holds": 2,
    "human_margin": 0.05,
    "robot_margin": 0.15,
    "comfort": 1.0,
    "comfort_weight": 12.0,
    "collision_weight": 100.0,
    "collision_discount": 0.6561,
}
TWO_PI = np.float32(2.0 * math.pi)


@pytest.mark.parametrize("kinematics", list(Kinematics))
@pytest.mark.parametrize(
    "numbers", [{}, {"collision_discount": 0.0}, {"collision_weight": 2.0, "comfort_weight": 120.0}]
)
def test_pruning_keeps_the_cheapest_plan(kinematics: Kinematics, numbers: dict[str, float]) -> None:
    """In a dense crowd, against an exhaustive search that simulates every plan to its end."""
    scenario = Scenario(kinematics=kinematics, humans=12, robots=3, circle_radius=4.0)
    settings: dict[str, Any] = {**PLANS, **numbers}
    planner = ModelPredictive(scenario, **settings)
    p, best = kernel_parameters(scenario), np.empty(scenario.action_size, np.float32)
    plans = plan_parameters(planner, scenario)
    assert plans == PlanParameters(  # 2 s are 8 steps of 0.25 s
        8,
        7,
        2,
        2,
        *(
            np.float32(value)
            for value in (
                0.05,
                0.15,
                1.0,
                settings["comfort_weight"] / 4,
                settings["collision_weight"],
                settings["collision_discount"] ** 0.25,
            )
        ),
    )
    world = World(scenario, 4, auto_reset=True)
    observation = world.reset(range(4))
    for _ in range(25):
        action = planner.act(observation)
        for e in range(4):
            for i in range(3):
                visible = tuple(array[e, i] for array in observation.agents)
                cheapest_action(visible, p, plans, best)
                np.testing.assert_array_equal(action[e, i], best)
        observation = world.step(action).observation


@numba.njit(error_model="numpy")  # type: ignore[untyped-decorator]
def cheapest_action(visible, p, plans, best):  # type: ignore[no-untyped-def]
    """Write the first action of the cheapest plan; each plan is simulated to its end."""
    ego, humans, humans_visible, robots, robots_visible = visible
    horizon, directions, speeds, holds = plans[:4]
    rows = np.empty((1 + len(humans) + len(robots), 5), np.float32)
    count = gather_rows(
        ego,
        humans,
        humans_visible,
        robots,
        robots_visible,
        plans.human_margin,
        plans.robot_margin,
        rows,
    )
    speed = math.sqrt(rows[0, 2] * rows[0, 2] + rows[0, 3] * rows[0, 3])
    goal_x, goal_y = ego[GOAL_X], ego[GOAL_Y]
    goal_angle, cheapest = math.atan2(goal_y, goal_x), np.float32(np.inf)
    scratch = np.empty_like(best)
    zero_offset = np.zeros((len(rows), 1, 2), np.float32)
    no_walls = np.zeros((WALL_ROWS, 0), np.float32)
    for plan in range(directions * speeds * holds + 1):
        angle = goal_angle + TWO_PI * (np.float32(plan % directions) / np.float32(directions))
        velocity = p.robot_speed * np.float32(plan // directions % speeds + 1) / np.float32(speeds)
        hold = max(horizon // (plan // (directions * speeds) + 1), 1)
        if plan == directions * speeds * holds:
            velocity, hold = np.float32(0.0), horizon
        vx, vy = velocity * math.cos(angle), velocity * math.sin(angle)
        cost = _cost(
            rows,
            zero_offset,
            count,
            no_walls,
            0,
            goal_x,
            goal_y,
            vx,
            vy,
            hold,
            plans,
            np.float32(np.inf),
            scratch,
            p,
        )
        if cost < cheapest:
            cheapest = cost
            track_velocity(vx, vy, speed, best, p)
