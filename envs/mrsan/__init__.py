"""Multi-robot socially-aware navigation: a batched simulator with three standard faces."""

import gymnasium

from mrsan.cases import Split
from mrsan.metrics import Episodes, Outcome, social_score
from mrsan.scenario import ConfigurationError, Crowd, Kinematics, Reward, Scenario
from mrsan.world import (
    EGO_FEATURES,
    OTHER_FEATURES,
    ActionError,
    Observation,
    State,
    Step,
    World,
)

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
