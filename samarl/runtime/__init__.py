"""Trained policies outside of the lab: NumPy, Numba and onnxruntime, no torch."""

from samarl.runtime.driver import Command, Driver
from samarl.runtime.inputs import Detection, InputError, OwnState
from samarl.runtime.walls import KnownMap, walls_of_scan

__all__ = [
    "Command",
    "Detection",
    "Driver",
    "InputError",
    "KnownMap",
    "OwnState",
    "walls_of_scan",
]
