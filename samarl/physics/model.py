"""The MuJoCo model of one case: robots with wheels, people as capsules, walls as boxes."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from mrsan import Scenario
from mrsan.place_shapes import walls_of
from mrsan.rendering import ROBOT_COLOURS
from mrsan.state import State
from samarl.physics.drives import Drive, Wheel
from samarl.physics.engine import MujocoEngine

FLOOR, WALLS, AGENTS = range(3)  # groups of geometries
PERSON_HEIGHT = 1.7  # m
_WHEEL_MASS = 0.05  # of each wheel, as a share of the robot's
_CASTER_TIME = 0.02  # time constant of the springs of casters, s
_SERVO_TIME = 0.01  # time constant with which motors correct the speed of the robot, s
_ROTOR_INERTIA = 0.05  # of a motor behind its gearbox, as a share of mass times radius squared
_WALL_HEIGHT, _WALL_THICKNESS = 0.6, 0.02  # m
_THIN_WALL = 0.002  # thickness of walls with floor on both sides, m
_HIDDEN = -10.0  # height of people who are not present, m
_PERSON_COLOUR = "0.55 0.55 0.55 1"


def chassis_extent(drive: Drive) -> tuple[float, float]:
    """Return the heights of the lower and the upper side of a robot's chassis, m."""
    return 0.3 * drive.wheel_radius, 3.0 * drive.wheel_radius


def case_xml(
    scenario: Scenario, engine: MujocoEngine, drive: Drive, state: State, step: float
) -> str:
    """Return the MJCF model of the case of a world, the only one of `state`.

    `step` is the time step of the physics, s.
    """
    half = scenario.half_extent + 3.0
    robots = [_robot(i, scenario, engine, drive, state) for i in range(scenario.robots)]
    motors = [
        _motor(i, k, wheel, engine, drive.wheel_radius)
        for i in range(scenario.robots)
        for k, wheel in enumerate(drive.wheels)
    ]
    people = [_person(j, float(r)) for j, r in enumerate(state.human_radius[0])]
    return f"""<mujoco model="case {state.case[0]}">
  <option timestep="{step}" integrator="implicitfast" cone="elliptic" impratio="10"/>
  <visual>
    <global offwidth="960" offheight="720"/>
    <headlight ambient="0.45 0.45 0.45" diffuse="0.4 0.4 0.4" specular="0 0 0"/>
  </visual>
  <asset>
    <texture name="sky" type="skybox" builtin="flat" rgb1="1 1 1" rgb2="1 1 1" width="8"
     height="8"/>
    <texture name="grid" type="2d" builtin="checker" rgb1=".93 .93 .93" rgb2=".88 .88 .88"
     width="64" height="64"/>
    <material name="grid" texture="grid" texrepeat="{half} {half}"/>
  </asset>
  <default>
    <geom solref="{2 * step} 1" friction="0.01 0 0"/>
  </default>
  <worldbody>
    <light directional="true" dir="-0.3 0.4 -1" diffuse="0.4 0.4 0.4" castshadow="true"/>
    <geom name="floor" type="plane" pos="0 0 0" size="{half} {half} 1" material="grid"
     group="{FLOOR}"/>
    {_lines(_walls(state))}
    {_lines(people)}
    {_lines(robots)}
    {_lines(_goals(scenario, state))}
  </worldbody>
  <actuator>
    {_lines(motors)}
  </actuator>
</mujoco>"""


def _lines(elements: list[str]) -> str:
    return "\n    ".join(elements)


def _robot(i: int, scenario: Scenario, engine: MujocoEngine, drive: Drive, state: State) -> str:
    x, y = state.robot_position[0, i]
    angle, radius = float(state.robot_heading[0, i]) / 2, drive.wheel_radius
    low, high = chassis_extent(drive)
    colour = _rgba(ROBOT_COLOURS[i % len(ROBOT_COLOURS)])
    mass = engine.mass * (1.0 - len(drive.wheels) * _WHEEL_MASS)
    caster = radius / 3
    height = caster - radius  # in the frame of the chassis: its origin is level with the axles
    parts = [
        f'<geom name="chassis{i}" type="cylinder" pos="0 0 {(low + high) / 2 - radius}" '
        f'size="{scenario.robot_radius} {(high - low) / 2}" mass="{mass}" rgba="{colour}" '
        f'group="{AGENTS}"/>',
        f'<geom type="box" pos="{0.6 * scenario.robot_radius} 0 {high - radius}" '
        f'size="{0.35 * scenario.robot_radius} 0.02 0.01" rgba="0 0 0 1" contype="0" '
        f'conaffinity="0" mass="0" group="{AGENTS}"/>',
        *(
            f'<geom type="sphere" pos="{ahead} 0 {height}" size="{caster}" mass="0" condim="1" '
            f'solref="{_CASTER_TIME} 1" priority="1" group="{AGENTS}"/>'
            for ahead in drive.casters
        ),
        *(_wheel(i, k, wheel, engine, radius) for k, wheel in enumerate(drive.wheels)),
    ]
    return (
        f'<body name="robot{i}" pos="{x} {y} {radius}" quat="{math.cos(angle)} 0 0 '
        f'{math.sin(angle)}"><freejoint name="robot{i}"/>{"".join(parts)}</body>'
    )


def _wheel(i: int, k: int, wheel: Wheel, engine: MujocoEngine, radius: float) -> str:
    axis = f"{wheel.axis[0]} {wheel.axis[1]} 0"
    joint = 'type="ball"' if wheel.is_free else f'type="hinge" axis="{axis}"'
    return (
        f'<body pos="{wheel.x} {wheel.y} 0"><joint name="wheel{i}_{k}" {joint} '
        f'armature="{_ROTOR_INERTIA * engine.mass * radius**2}"/>'
        f'<geom type="sphere" size="{radius}" mass="{engine.mass * _WHEEL_MASS}" '
        f'friction="{engine.friction} 0 0" priority="1" rgba="0.1 0.1 0.1 1" '
        f'group="{AGENTS}"/></body>'
    )


def _motor(i: int, k: int, wheel: Wheel, engine: MujocoEngine, radius: float) -> str:
    torque = engine.motor_torque * wheel.gearing
    transmission = f'joint="wheel{i}_{k}"'
    if wheel.is_free:
        axis = f"{wheel.axis[0]} {wheel.axis[1]} 0 0 0 0"
        transmission = f'jointinparent="wheel{i}_{k}" gear="{axis}"'
    gain = engine.mass * radius**2 / (2.0 * _SERVO_TIME)  # two wheels share the mass ahead
    return f'<velocity {transmission} kv="{gain}" forcerange="{-torque} {torque}"/>'


def _person(j: int, radius: float) -> str:
    """Return a capsule, whose lower half-sphere is below the floor, that is moved from outside."""
    half = (PERSON_HEIGHT - radius) / 2
    return (
        f'<body name="person{j}" mocap="true" pos="0 0 {_HIDDEN}"><geom name="person{j}" '
        f'type="capsule" pos="0 0 {half}" size="{radius} {half}" rgba="{_PERSON_COLOUR}" '
        f'group="{AGENTS}"/></body>'
    )


def _walls(state: State) -> list[str]:
    """Return boxes on the solid, left side of the wall segments, or on both sides of thin ones."""
    segments = walls_of(state, 0).astype(np.float64)
    directed = {tuple(segment) for segment in segments.tolist()}
    boxes = []
    for x0, y0, x1, y1 in segments.tolist():
        length, angle = math.hypot(x1 - x0, y1 - y0), math.atan2(y1 - y0, x1 - x0)
        is_thin = (x1, y1, x0, y0) in directed
        thickness = _THIN_WALL if is_thin else _WALL_THICKNESS
        aside = 0.0 if is_thin else thickness / 2
        x = (x0 + x1) / 2 - aside * math.sin(angle)
        y = (y0 + y1) / 2 + aside * math.cos(angle)
        boxes.append(
            f'<geom type="box" pos="{x} {y} {_WALL_HEIGHT / 2}" size="{length / 2} '
            f'{thickness / 2} {_WALL_HEIGHT / 2}" euler="0 0 {math.degrees(angle)}" '
            f'group="{WALLS}" rgba="0.3 0.3 0.3 1"/>'
        )
    return boxes


def _goals(scenario: Scenario, state: State) -> list[str]:
    return [
        f'<site type="cylinder" pos="{x} {y} 0" size="{scenario.robot_radius} 0.002" '
        f'rgba="{_rgba(ROBOT_COLOURS[i % len(ROBOT_COLOURS)], 0.4)}"/>'
        for i, (x, y) in enumerate(state.robot_goal[0])
    ]


def _rgba(colour: str, opacity: float = 1.0) -> str:
    """Return a colour such as `#0072B2` as MuJoCo writes it."""
    parts = (int(colour[k : k + 2], 16) / 255 for k in (1, 3, 5))
    return " ".join(f"{part:.3f}" for part in (*parts, opacity))


def hidden(positions: NDArray[np.float32], present: NDArray[np.bool_]) -> NDArray[np.float64]:
    """Return the places of people [M, 3]: those who are not present are below the floor."""
    height = np.where(present, 0.0, _HIDDEN)
    return np.concatenate([positions, height[:, None]], axis=1).astype(np.float64)
