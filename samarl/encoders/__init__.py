"""From what a robot knows to the features its actors and critics read."""

from samarl.encoders.encoder import ENCODERS, Encoder, Frames, encoder_named
from samarl.encoders.spatio_temporal import SpatioTemporalEncoder

__all__ = ["ENCODERS", "Encoder", "Frames", "SpatioTemporalEncoder", "encoder_named"]
