"""Recorded pedestrians, from files of many formats to the clock of the simulator.

`formats` reads files, `plausibility` measures and doubts them, `resample` interpolates. Nobody in a
recording reacts to a robot. The origin is moved to the middle of the floor.
"""

from mrsan.recording.load import SAMPLE, load_recording, read_people
from mrsan.recording.plausibility import Summary, find_problem, summarize
from mrsan.recording.resample import COAST, NOBODY, Recording
from mrsan.recording.rows import People, RecordingError

__all__ = [
    "COAST",
    "NOBODY",
    "SAMPLE",
    "People",
    "Recording",
    "RecordingError",
    "Summary",
    "find_problem",
    "load_recording",
    "read_people",
    "summarize",
]
