"""Multi-robot socially-aware navigation: a batched simulator with three standard wrappers."""

import os

# Before anything loads OpenMP: threads that wait for work would otherwise spin for long, which on
# a machine that others use as well costs ten times the work itself.
os.environ.setdefault("GOMP_SPINCOUNT", "1000")

from importlib.metadata import version

import gymnasium

from mrsan.compile_cache import ensure_compile_cache

ensure_compile_cache()  # before anything is compiled

from mrsan.cases import Split
from mrsan.features import EGO_FEATURES, OTHER_FEATURES
from mrsan.metrics import Episodes, Outcome, social_score
from mrsan.reward import RewardParts
from mrsan.scenario import ConfigurationError, Crowd, Kinematics, Reward, Scenario
from mrsan.world import (
    ActionError,
    Observation,
    State,
    Step,
    World,
)

__version__ = version("samarl")  # one distribution holds both packages

__all__ = [
    "EGO_FEATURES",
    "OTHER_FEATURES",
    "ActionError",
    "ConfigurationError",
    "Crowd",
    "Episodes",
    "Kinematics",
    "Observation",
    "Outcome",
    "Reward",
    "RewardParts",
    "Scenario",
    "Split",
    "State",
    "Step",
    "World",
    "social_score",
]

gymnasium.register(
    "mrsan/SocialNavigation-v0",
    entry_point="mrsan.gymnasium_env:GymnasiumEnv",
    vector_entry_point="mrsan.gymnasium_env:GymnasiumVectorEnv",
)
