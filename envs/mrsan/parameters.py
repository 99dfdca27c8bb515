"""A scenario as the kernels take it."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np


class Parameters(NamedTuple):
    """A scenario in the kernels' units: float32, radians, steps. See `Scenario` for meanings."""

    humans_min: int
    layout: int
    circle_radius: np.float32
    goal_turn: np.float32
    goal_turn_spread: np.float32
    floor_size: np.float32
    crossing_width: np.float32
    opposite_width: np.float32
    robot_way_min: np.float32
    robot_way_max: np.float32
    spawn_jitter: np.float32
    spawn_clearance: np.float32
    arena_radius: np.float32
    time_step: np.float32
    time_limit_steps: int
    collisions_end: bool
    kinematics: int
    instant_velocity: bool
    robot_radius: np.float32
    robot_speed: np.float32
    max_acceleration: np.float32
    max_turn: np.float32
    min_turning_radius: np.float32
    turn_in_place: bool
    cos_half_fov: np.float32
    sensing_range: np.float32
    occlusion: bool
    position_noise: np.float32
    velocity_noise: np.float32
    radius_noise: np.float32
    missed_detection: np.float32
    team_tracks: bool
    team_range: np.float32
    team_delay_steps: int
    team_loss: np.float32
    crowd: int
    robots_visible: bool
    human_radius_min: np.float32
    human_radius_max: np.float32
    human_speed_min: np.float32
    human_speed_max: np.float32
    human_safety_space: np.float32
    goal_distance: np.float32
    recorded_start_clear_steps: int
    recorded_slot_rest_steps: int
    goal_change_steps: int
    goal_change_probability: np.float32
    goal_change_probability_max: np.float32
    stand_probability: np.float32
    hurry_probability: np.float32
    hurry_speed_min: np.float32
    hurry_speed_max: np.float32
    pair_probability: np.float32
    late_probability: np.float32
    late_steps: int
    leave_probability: np.float32
    people_come_and_go: bool
    neighbor_distance: np.float32
    max_neighbors: int
    time_horizon: np.float32
    relaxation_time: np.float32
    force_strength: np.float32
    force_range: np.float32
    reward_none: np.float32
    reward_arrival: np.float32
    reward_team: np.float32
    reward_collision: np.float32
    reward_discomfort: np.float32
    reward_discomfort_limit: np.float32
    discomfort_distance: np.float32
    reward_progress: np.float32
    reward_goal_distance: np.float32
    reward_time: np.float32
    reward_literal: bool


class Sensor(NamedTuple):
    """What of `Parameters` decides what a robot sees: fewer numbers are handed over faster."""

    robot_radius: np.float32
    robot_speed: np.float32
    time_limit_steps: int
    cos_half_fov: np.float32
    sensing_range: np.float32
    occlusion: bool
    position_noise: np.float32
    velocity_noise: np.float32
    radius_noise: np.float32
    missed_detection: np.float32

    @classmethod
    def of(cls, parameters: Parameters) -> Sensor:
        """That of a scenario's parameters."""
        return cls(*(getattr(parameters, name) for name in cls._fields))
