"""Recorded pedestrians, read from files of many formats and resampled to the time step.

`formats` reads files, `plausibility` measures and checks them, and `resample` interpolates.
Recorded people do not react to robots. The origin is moved to the centre of the floor.
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
