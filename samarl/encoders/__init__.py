"""From what a robot knows to the features its networks read."""

from samarl.encoders import (  # noqa: F401 (makes them known)
    gru,
    pairwise,
    set_pool,
    social_attention,
    spatio_temporal,
    structural_rnn,
    temporal_spatial_graph,
)
from samarl.encoders.encoder import ENCODERS, Encoder

__all__ = ["ENCODERS", "Encoder"]
