"""MuJoCo's offscreen renderer, which must be chosen before MuJoCo is imported."""

from __future__ import annotations

import importlib
import os
import sys

from mrsan import ConfigurationError


def prepare_renderer() -> None:
    """Import MuJoCo with a renderer that needs no screen, unless MUJOCO_GL names one.

    Raises:
        ConfigurationError: the renderer is not installed.
    """
    if sys.platform == "linux" and not os.environ.get("DISPLAY"):
        os.environ.setdefault("MUJOCO_GL", "egl")
    try:
        importlib.import_module("mujoco")
    except Exception as error:  # whatever the bindings of OpenGL raise
        raise cannot_render(error) from error


def cannot_render(error: Exception) -> ConfigurationError:
    """Return the error to raise where MuJoCo fails to render."""
    reason = str(error).splitlines()[0] if str(error) else type(error).__name__
    return ConfigurationError(
        f"engine is mujoco, which cannot render on this machine ({reason}); the environment "
        "variable MUJOCO_GL must name one of egl, osmesa and glfw that is installed"
    )
