"""Trained policies outside of the lab: NumPy, Numba and onnxruntime, no torch."""

from samarl.runtime.driver import Command, Driver
from samarl.runtime.inputs import Detection, InputError, OwnState
from samarl.runtime.right_of_way import RightOfWayDriver
from samarl.runtime.robot_shield import ShieldReason
from samarl.runtime.scan import measured_ranges, walls_of_scan
from samarl.runtime.team import Message
from samarl.runtime.walls import KnownMap

__all__ = [
    "Command",
    "Detection",
    "Driver",
    "InputError",
    "KnownMap",
    "Message",
    "OwnState",
    "RightOfWayDriver",
    "ShieldReason",
    "measured_ranges",
    "walls_of_scan",
]
