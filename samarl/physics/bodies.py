"""Robots, people and walls of one case as bodies in MuJoCo."""

from __future__ import annotations

import mujoco
import numpy as np
from numpy.typing import NDArray

from mrsan import LidarTargets, Scenario
from mrsan.se2 import rotate
from mrsan.sensors.walls import ray_angles
from mrsan.state import State
from samarl.physics.drives import Drive
from samarl.physics.engine import MujocoEngine
from samarl.physics.model import AGENTS, WALLS, case_xml, chassis_extent, hidden

_SETTLING_TIME = 0.1  # for which robots come to rest on the floor before the episode, s


class Bodies:
    """The bodies of one case. Arrays [N, ...] are those of the robots, in the world frame."""

    def __init__(
        self, scenario: Scenario, engine: MujocoEngine, drive: Drive, state: State
    ) -> None:
        """Build the bodies at their starts."""
        period = engine.control_period(scenario)
        self._steps = max(1, int(np.ceil(period / engine.physics_step - 1e-9)))
        text = case_xml(scenario, engine, drive, state, period / self._steps)
        self.model = mujoco.MjModel.from_xml_string(text)
        self.data = mujoco.MjData(self.model)
        self._scenario, self._wheel_speeds = scenario, drive.wheel_speeds
        self._lidar_height = chassis_extent(drive)[1] - drive.wheel_radius / 2
        joints = [self.model.joint(f"robot{i}") for i in range(scenario.robots)]
        first_position = np.array([joint.qposadr[0] for joint in joints])
        first_velocity = np.array([joint.dofadr[0] for joint in joints])
        self._position = first_position[:, None] + np.arange(2)
        self._quaternion = first_position[:, None] + np.arange(3, 7)
        self._velocity = first_velocity[:, None] + np.arange(6)
        self._people = [self.model.geom(f"person{j}").id for j in range(scenario.humans)]
        self._settle()

    def _settle(self) -> None:
        """Let the robots come to rest, exactly at their starts."""
        start = self.data.qpos.copy()
        mujoco.mj_step(self.model, self.data, round(_SETTLING_TIME / self.model.opt.timestep))
        self.data.qpos[self._position] = start[self._position]
        self.data.qpos[self._quaternion] = start[self._quaternion]
        self.data.qvel[:] = 0.0
        self.data.time = 0.0
        mujoco.mj_forward(self.model, self.data)

    def place_people(
        self,
        positions: NDArray[np.float32],
        present: NDArray[np.bool_],
        radii: NDArray[np.float32],
    ) -> None:
        """Move people to positions [M, 2], m.

        Args:
            positions: [M, 2] m.
            present: [M]; the others are put out of the way.
            radii: [M] m; a slot may hold somebody else later.
        """
        self.data.mocap_pos[: len(positions)] = hidden(positions, present)
        self.model.geom_size[self._people, 0] = radii

    def drive(self, velocities: NDArray[np.float64]) -> None:
        """Set the speeds of all wheels for one control period and move all bodies.

        They are [N, 3]: ahead and to the left (m/s), turning (rad/s).
        """
        self.data.ctrl[:] = (velocities @ self._wheel_speeds.T).ravel()
        mujoco.mj_step(self.model, self.data, self._steps)

    def update_geometry(self) -> None:
        """Move all geometries, which a step leaves where it began, to the current state."""
        mujoco.mj_kinematics(self.model, self.data)

    @property
    def position(self) -> NDArray[np.float64]:
        """Return the positions of the robots, [N, 2] m."""
        return self.data.qpos[self._position]

    @property
    def velocity(self) -> NDArray[np.float64]:
        """Return the velocities of the robots, [N, 2] m/s."""
        return self.data.qvel[self._velocity[:, :2]]

    @property
    def yaw(self) -> NDArray[np.float64]:
        """Return the angles of the robots' chassis, [N] rad."""
        w, x, y, z = self.data.qpos[self._quaternion].T
        return np.arctan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))

    def scan(self, robot: int, heading: float) -> NDArray[np.float64]:
        """Return the ranges of a robot's lidar by casting rays, [L] m; the greatest if none hits.

        The geometry must be up to date.

        Angles are measured from `heading`, rad.
        """
        s = self._scenario
        angles = ray_angles(s.lidar_rays, s.lidar_fov_degrees).astype(np.float64)
        rays = np.zeros((s.lidar_rays, 3))
        rays[:, 0], rays[:, 1] = rotate(
            np.cos(heading), np.sin(heading), np.cos(angles), np.sin(angles)
        )
        groups = np.zeros(mujoco.mjNGROUP, np.uint8)
        groups[WALLS] = 1
        groups[AGENTS] = s.lidar_targets is LidarTargets.all
        distance, geometry = np.empty(s.lidar_rays), np.empty(s.lidar_rays, np.int32)
        mujoco.mj_multiRay(
            m=self.model,
            d=self.data,
            pnt=np.array([*self.position[robot], self._lidar_height]),
            vec=rays.ravel(),
            geomgroup=groups,
            flg_static=True,
            bodyexclude=self.model.body(f"robot{robot}").id,
            geomid=geometry,
            dist=distance,
            normal=None,
            nray=s.lidar_rays,
            cutoff=s.lidar_range,
        )
        return np.where(distance < 0.0, s.lidar_range, np.minimum(distance, s.lidar_range))
