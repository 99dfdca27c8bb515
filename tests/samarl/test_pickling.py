"""Environments, agents and scenarios can be pickled in the middle of an episode."""

import copy
import pickle
from collections.abc import Callable
from typing import Any

import gymnasium
import numpy as np
import torch
from tensordict import TensorDict

import mrsan
from mrsan import Crowd, Kinematics, Layout, Scenario, TeamPerception, World
from mrsan.gymnasium_env import GymnasiumVectorEnv
from mrsan.pettingzoo_env import PettingZooEnv
from mrsan.sb3_env import SB3VecEnv
from mrsan.torchrl_env import TorchRLEnv
from samarl.agents import build_agent
from samarl.configuration import load_agent_config

SMALL = {"robots": 2, "humans": 3}
PLANNERS = ("orca", "social_force", "perimeter", "model_predictive")
AGENTS = (*PLANNERS, "samarl", "samarl_flat", "samarl_srnn", "cadrl", "msa3cpred")


def copies(value: Any) -> list[Any]:
    return [copy.deepcopy(value), pickle.loads(pickle.dumps(value))]


def play(env: Any) -> list[np.ndarray]:
    """Return what three further steps of an environment, however it is wrapped, return."""
    seen: list[np.ndarray] = []
    for _ in range(3):
        if isinstance(env, World):
            action = np.full((env.worlds, env.scenario.robots, 3), 0.3, np.float32)
            step = env.step(action)
            seen += [step.reward, *step.observation.arrays().values()]
        elif isinstance(env, TorchRLEnv):
            action = {"agents": {"action": torch.full((2, 2, 3), 0.3)}}
            data = env.step(TensorDict(action, batch_size=env.batch_size))
            seen += [leaf.numpy() for leaf in data.flatten_keys().values()]
        elif isinstance(env, PettingZooEnv):
            env.step({agent: np.full(3, 0.3, np.float32) for agent in env.agents})
            seen.append(env.state())
        elif isinstance(env, SB3VecEnv):
            observation, reward, *_ = env.step(np.full((env.num_envs, 3), 0.3, np.float32))
            seen += [reward, *observation.values()]
        else:
            observation, reward, *_ = env.step(np.full(env.action_space.shape, 0.3, np.float32))
            seen += [np.asarray(reward), *observation.values()]
    return seen


def test_environments_continue_identically() -> None:
    makers: list[Callable[[], Any]] = [
        lambda: World(Scenario(**SMALL), 2),
        lambda: World(Scenario(layout=Layout.rooms, lidar_rays=12, **SMALL), 2, auto_reset=True),
        lambda: World(Scenario(team_perception=TeamPerception.tracks, **SMALL), 2),
        lambda: World(Scenario(crowd=Crowd.recorded, robots=2, humans=20), 2),
        lambda: gymnasium.make("mrsan/SocialNavigation-v0", humans=3),
        lambda: GymnasiumVectorEnv(2, humans=3),
        lambda: PettingZooEnv(**SMALL),
        lambda: SB3VecEnv(worlds=2, **SMALL),
        lambda: TorchRLEnv(worlds=2, seed=3, **SMALL),
    ]
    for make in makers:
        env = make()
        if isinstance(env, World):
            env.reset([1, 2])
        elif isinstance(env, SB3VecEnv | TorchRLEnv):
            env.reset()
        else:
            env.reset(seed=3)
        play(env)
        twins = copies(env)
        expected = play(env)
        for twin in twins:
            for here, there in zip(expected, play(twin), strict=True):
                np.testing.assert_array_equal(here, there, err_msg=repr(env))


def test_agents_continue_identically() -> None:
    """One agent of each kind, in the scenario that suits it."""
    usual = Scenario(**SMALL)
    holonomic = Scenario(kinematics=Kinematics.holonomic, robot_radius=0.6, **SMALL)
    for name in AGENTS:
        config, scenario = load_agent_config(name), usual
        try:
            agent = build_agent(config, scenario)
        except mrsan.ConfigurationError:
            scenario = holonomic
            agent = build_agent(config, scenario)
        world = World(scenario, 2)
        observation = world.reset([0, 1])
        agent.reset(np.ones(2, np.bool_))
        for _ in range(2):
            observation = world.step(agent.act(observation)).observation
        twins = copies(agent)
        action = agent.act(observation)
        for twin in twins:
            np.testing.assert_array_equal(action, twin.act(observation), err_msg=name)
