"""From what a robot knows to the features its networks read."""

from samarl.encoders import gru, pairwise, spatio_temporal  # noqa: F401 (makes them known)
from samarl.encoders.encoder import ENCODERS, Encoder

__all__ = ["ENCODERS", "Encoder"]
