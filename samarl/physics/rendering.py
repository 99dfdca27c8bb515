"""Pictures of a case in MuJoCo, from its offscreen renderer."""

from __future__ import annotations

from collections.abc import Iterator

import mujoco
import numpy as np
from numpy.typing import NDArray

from samarl.physics.controllers import Controller
from samarl.physics.offscreen import cannot_render
from samarl.physics.runner import decide_and_step
from samarl.physics.world import PhysicsWorld

_WIDTH, _HEIGHT = 640, 480  # pixels
_ELEVATION = -50.0  # of the camera above the floor, degrees below the horizon
_DISTANCE = 2.1  # of the camera, as a share of the size of the place


def rendered_frames(
    world: PhysicsWorld, controller: Controller, case: int
) -> Iterator[NDArray[np.uint8]]:
    """Run a case and yield a picture [H, W, 3] of its start and after each decision.

    Raises:
        ConfigurationError: MuJoCo cannot render on this machine.
    """
    observation = world.reset(case)
    controller.reset()
    picture = _Picture(world)
    yield picture.draw()
    while not world.done:
        observation = decide_and_step(world, controller, observation)
        yield picture.draw()


class _Picture:
    """The offscreen renderer of a case."""

    def __init__(self, world: PhysicsWorld) -> None:
        self._bodies = world.bodies
        try:
            self._renderer = mujoco.Renderer(world.bodies.model, _HEIGHT, _WIDTH)
        except Exception as error:  # whatever the OpenGL of the machine raises
            raise cannot_render(error) from error
        self._camera = mujoco.MjvCamera()
        self._camera.azimuth, self._camera.elevation = 90.0, _ELEVATION
        self._camera.lookat[:2] = 0.0
        self._camera.distance = _DISTANCE * world.scenario.half_extent

    def draw(self) -> NDArray[np.uint8]:
        self._renderer.update_scene(self._bodies.data, self._camera)
        pixels: NDArray[np.uint8] = self._renderer.render()
        return pixels
