"""Multi-robot socially-aware navigation: a batched simulator with three standard wrappers."""

from importlib.metadata import version

from mrsan.threads import let_threads_sleep

let_threads_sleep()  # before anything loads OpenMP

from mrsan.cases import Split
from mrsan.choices import (
    Crowd,
    CrowdReaction,
    Kinematics,
    Layout,
    LidarTargets,
    Reaction,
    TeamPerception,
)
from mrsan.crowds import register_crowd
from mrsan.features import EGO_FEATURES, OTHER_FEATURES
from mrsan.fields import ConfigurationError
from mrsan.groups import Groups
from mrsan.metrics import Episodes, Outcome, social_score
from mrsan.observation import Entities, Observation
from mrsan.place import Place
from mrsan.plugin_values import PluginError
from mrsan.reactions import Reactions
from mrsan.reward import Reward, RewardParts
from mrsan.reward_terms import register_reward_term
from mrsan.scenario import Scenario
from mrsan.sensors.sensor import EntitySensor, ValueSensor, register_sensor
from mrsan.state import State
from mrsan.tasks import TASKS, Task
from mrsan.world import ActionError, Step, World

__version__ = version("samarl")  # one distribution holds both packages

__all__ = [
    "EGO_FEATURES",
    "OTHER_FEATURES",
    "TASKS",
    "ActionError",
    "ConfigurationError",
    "Crowd",
    "CrowdReaction",
    "Entities",
    "EntitySensor",
    "Episodes",
    "Groups",
    "Kinematics",
    "Layout",
    "LidarTargets",
    "Observation",
    "Outcome",
    "Place",
    "PluginError",
    "Reaction",
    "Reactions",
    "Reward",
    "RewardParts",
    "Scenario",
    "Split",
    "State",
    "Step",
    "Task",
    "TeamPerception",
    "ValueSensor",
    "World",
    "register_crowd",
    "register_reward_term",
    "register_sensor",
    "social_score",
]

try:
    import gymnasium
except ModuleNotFoundError:  # a robot that only drives (samarl.runtime) does without
    pass
else:
    from functools import partial

    _register = partial(
        gymnasium.register,
        entry_point="mrsan.gymnasium_env:GymnasiumEnv",
        vector_entry_point="mrsan.gymnasium_env:GymnasiumVectorEnv",
    )
    _register("mrsan/SocialNavigation-v0")
    for _task in TASKS.values():
        _register(_task.id, kwargs={"scenario": _task.id})
