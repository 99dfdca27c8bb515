"""What people in groups and near robots choose, against a slow float64 twin.

The twin is written from docs/people.md and shares no code with the kernels.
"""

import math
from typing import Any

import numpy as np
import oracle
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from test_step_against_oracle import NOISE, SEEDS, THRESHOLD_MARGIN, TOLERANCE, scatter

from mrsan import Crowd, Groups, Reaction, Reactions, Scenario, World

REACTION, ELAPSED, GROUP = range(3)
SCENARIOS = st.builds(
    Scenario,
    robots=st.sampled_from([1, 3]),
    humans=st.sampled_from([4, 7]),
    crowd=st.sampled_from([Crowd.orca, Crowd.orca, Crowd.social_force]),
    crowd_reaction=st.just("mixed"),
    human_safety_space=st.sampled_from([0.0, 0.25]),
    goal_change_probability=st.just(0.0),
    terminate_on_collision=st.just(False),
    reactions=st.builds(
        Reactions,
        notice_distance=st.sampled_from([2.0, 4.0]),
        notice_fov_degrees=st.sampled_from([90.0, 180.0, 360.0]),
    ),
    groups=st.builds(
        Groups,
        share=st.sampled_from([0.0, 0.5, 1.0]),
        standing_share=st.sampled_from([0.0, 1.0]),  # then the twin knows who talks
        gaze=st.sampled_from([0.0, 4.0]),
        repulsion=st.sampled_from([0.0, 1.0]),
    ),
)


def unit(vector: np.ndarray) -> np.ndarray:
    return vector / max(float(np.hypot(*vector)), 1e-12)


def in_group(
    s: dict[str, Any],
    goal: np.ndarray,
    j: int,
    preferred: np.ndarray,
    scenario: Scenario,
    margin: oracle.Margin,
) -> np.ndarray:
    """The preferred velocity of a member: Moussaid et al. (2010), but stepping aside."""
    g, tau, position = scenario.groups, scenario.relaxation_time, s["human_position"]
    group = s["human_social"][:, GROUP]
    members = np.flatnonzero((group == group[j]) & s["human_present"])
    if group[j] < 0 or len(members) < 2:
        return preferred
    centre = position[members].mean(0)
    if g.standing_share == 1.0:
        side = 2 * scenario.human_radius_max + max(g.gap, scenario.human_safety_space)
        radius = max(g.talk_radius, side / (2 * math.sin(math.pi / len(members))))
        return (centre + radius * unit(position[j] - centre) - position[j]) / tau
    leader = members[0]
    preferred = s["human_speed"][j] * unit(goal[leader] - position[leader])
    left = unit(np.array([-preferred[1], preferred[0]]))
    aside = 0.0
    for k in members[members != j]:
        across = float((position[j] - position[k]) @ left)
        reach = s["human_radius"][j] + s["human_radius"][k] + g.gap
        margin.below(across, 0.0)
        if margin.below(abs(across), reach):
            aside += math.copysign(tau * g.repulsion, across)
    turn = math.acos(np.clip(unit(preferred) @ unit(centre - position[j]), -1, 1))
    turn = max(turn - math.radians(g.gaze_fov_degrees / 2), 0.0)
    velocity = preferred / (1 + tau * g.gaze * turn) + aside * left
    if not margin.below(float(np.hypot(*(centre - position[j]))), g.spread * (len(members) - 1)):
        velocity = velocity + tau * g.attraction * unit(centre - position[j])
    return velocity


def near_robots(
    s: dict[str, Any], j: int, preferred: np.ndarray, scenario: Scenario, margin: oracle.Margin
) -> tuple[np.ndarray, float, bool]:
    """The preferred velocity and the speed limit of a person, and whether it avoids robots."""
    r, kind = scenario.reactions, Reaction(s["human_social"][j, REACTION])
    elapsed, speed = s["human_social"][j, ELAPSED] * scenario.time_step, s["human_speed"][j]
    as_others = preferred, speed, kind is not Reaction.blind
    if kind in (Reaction.blind, Reaction.regular, Reaction.impassive):
        return as_others
    to_robots = s["robot_position"] - s["human_position"][j]
    distances = np.sort(np.hypot(*to_robots.T))
    if len(distances) > 1:
        margin.below(distances[0], distances[1])
    i = int(np.argmin(np.hypot(*to_robots.T)))
    away, reach = to_robots[i], s["human_radius"][j] + scenario.robot_radius
    gap = float(np.hypot(*away)) - reach
    notices = margin.below(gap, r.notice_distance)
    if elapsed == 0 and not margin.below(float(np.hypot(*preferred)), 0.05):
        angle = math.acos(np.clip(unit(preferred) @ unit(away), -1, 1))
        half = math.radians(r.notice_fov_degrees / 2)
        notices = notices and (half == math.pi or bool(margin.below(angle, half)))
    if not notices:
        return as_others
    if kind is Reaction.scared:
        push = r.scared_push * math.exp(-max(gap, 0.0) / r.scared_range)
        slowed = preferred * min(r.scared_speed / speed, 1.0)
        return slowed - push * unit(away), speed, True
    if kind is Reaction.surprised and elapsed < r.surprised_time:
        return np.zeros(2), speed, False
    if kind is Reaction.curious and elapsed < r.curious_time:
        pace = min(speed, r.curious_speed, max(gap - r.curious_gap, 0.0) / scenario.time_step)
        return pace * unit(away), speed, False
    if kind is Reaction.threatening and elapsed < r.threatening_time:
        heading = float(s["robot_heading"][i])
        bearing = math.atan2(-away[1], -away[0])
        turn = oracle.wrap(heading - bearing)
        margin.below(abs(turn), math.pi - 1e-3)
        bearing += np.clip(turn, -math.pi / 3, math.pi / 3)
        front = (reach + r.threatening_gap) * np.array([math.cos(bearing), math.sin(bearing)])
        velocity = (away + front) / scenario.time_step + s["robot_velocity"][i]
        return velocity, max(speed, r.threatening_speed), False
    return as_others


def choose(
    s: dict[str, Any], goal: np.ndarray, scenario: Scenario
) -> tuple[np.ndarray, oracle.Margin]:
    """The velocities of the people of snapshot `s`, [M, 2], given their goals in this step."""
    margin, space = oracle.Margin(), scenario.human_safety_space
    here, group = np.flatnonzero(s["human_present"]), s["human_social"][:, GROUP]
    chosen = s["human_velocity"].copy()
    for row, j in enumerate(here):
        preferred = s["human_speed"][j] * unit(goal[j] - s["human_position"][j])
        preferred = in_group(s, goal, j, preferred, scenario, margin)
        preferred, top, avoids = near_robots(s, j, preferred, scenario, margin)
        together = (group == group[j]) & (group >= 0)
        together[j] = False
        radii = s["human_radius"] + np.where(together, -space, space)
        agents = np.column_stack([s["human_position"], s["human_velocity"], radii])[here]
        if avoids:
            robot_velocity = s["robot_velocity"].copy()
            if s["human_social"][j, REACTION] == Reaction.impassive.value:
                robot_velocity[:] = 0.0
            size = np.full(len(robot_velocity), scenario.robot_radius + space)
            robots = np.column_stack([s["robot_position"], robot_velocity, size])
            agents = np.vstack([agents, robots])
        if scenario.crowd == Crowd.social_force:
            chosen[j] = oracle.social_force(agents, row, preferred, top, scenario)
        else:
            chosen[j] = oracle.orca(
                agents,
                row,
                preferred,
                top,
                scenario.neighbor_distance,
                scenario.max_neighbors,
                scenario.time_horizon,
                scenario.time_step,
            )
    return chosen, margin


def well_conditioned(before: dict[str, Any], goal: np.ndarray, scenario: Scenario) -> bool:
    """Whether the choices hardly change when the state changes by its rounding."""
    rng = np.random.default_rng(0)
    exact, _ = choose(before, goal, scenario)
    for _ in range(2):
        noisy = dict(before)
        for key in ("human_position", "human_velocity"):
            noisy[key] = before[key] + NOISE * rng.uniform(-1, 1, before[key].shape)
        if np.abs(choose(noisy, goal, scenario)[0] - exact).max(initial=0) > 5e-5:
            return False
    return True


@given(SCENARIOS, SEEDS, st.sampled_from([1.5, 3.0, 5.5]))
@settings(max_examples=200)
def test_people_choose_what_the_twin_chooses(scenario: Scenario, seed: int, room: float) -> None:
    world = World(scenario)
    actions = scatter(world, seed, room)
    world.state.human_social[0, :, ELAPSED] = np.random.default_rng(seed).choice(
        [0, 0, 5, 19, 20, 39, 40], scenario.humans
    )
    before = oracle.snapshot(world.state)
    world.step(actions)
    after = oracle.snapshot(world.state)
    assume(well_conditioned(before, after["human_goal"], scenario))
    expected, margin = choose(before, after["human_goal"], scenario)
    assume(margin.smallest > THRESHOLD_MARGIN)
    np.testing.assert_allclose(after["human_velocity"], expected, rtol=0, atol=TOLERANCE)
