"""Trained policies outside of the lab: NumPy, Numba and onnxruntime, no torch."""

from samarl.runtime.driver import Command, Driver
from samarl.runtime.inputs import Detection, InputError, OwnState

__all__ = ["Command", "Detection", "Driver", "InputError", "OwnState"]
