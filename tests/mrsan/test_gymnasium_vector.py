"""The vector environment against Gymnasium's own vector of single environments."""

import numpy as np
import pytest
from gymnasium.vector import AutoresetMode, SyncVectorEnv

from mrsan.gymnasium_env import GymnasiumEnv, GymnasiumVectorEnv

E, STEPS = 6, 60
FIELDS = {"humans": 6, "time_limit": 5.0, "circle_radius": 2.5, "goal_distance": 2.0}
WALLED = {"humans": 2, "time_limit": 5.0, "layout": "doorway", "lidar_rays": 12}


def assert_same(vector_data: dict, theirs: dict) -> None:
    assert vector_data.keys() == theirs.keys()
    for key, value in theirs.items():
        if isinstance(value, dict):
            assert_same(vector_data[key], value)
            continue
        np.testing.assert_array_equal(vector_data[key], value, err_msg=key)


def both(mode: AutoresetMode, fields: dict = FIELDS) -> tuple[GymnasiumVectorEnv, SyncVectorEnv]:
    sync = SyncVectorEnv([lambda: GymnasiumEnv(**fields)] * E, autoreset_mode=mode)
    return GymnasiumVectorEnv(E, autoreset_mode=mode, **fields), sync


@pytest.mark.parametrize("fields", [FIELDS, WALLED], ids=["open", "walled"])
@pytest.mark.parametrize("mode", AutoresetMode)
def test_step_by_step_like_a_vector_of_single_environments(
    mode: AutoresetMode, fields: dict
) -> None:
    vector, sync = both(mode, fields)
    assert vector.metadata["autoreset_mode"] is mode
    assert vector.single_observation_space == sync.single_observation_space
    assert vector.action_space == sync.action_space
    rng = np.random.default_rng(0)
    observation, theirs = vector.reset(seed=11)[0], sync.reset(seed=11)[0]
    assert_same(observation, theirs)
    ends = 0
    for _ in range(STEPS):
        actions = rng.uniform(-1, 1, (E, 3)).astype(np.float32)
        actions[:, 0] = 1
        observation, reward, terminated, truncated, info = vector.step(actions)
        theirs, reward2, terminated2, truncated2, info2 = sync.step(actions)
        assert_same(observation, theirs)
        np.testing.assert_array_equal(reward, reward2)
        np.testing.assert_array_equal(terminated, terminated2)
        np.testing.assert_array_equal(truncated, truncated2)
        for key in ("arrived", "_arrived", "_reward_parts"):
            assert (key in info) == (key in info2)
            np.testing.assert_array_equal(info.get(key), info2.get(key), err_msg=key)
        assert_same(info.get("reward_parts", {}), info2.get("reward_parts", {}))
        done = terminated | truncated
        ends += int(done.sum())
        if done.any() and mode is AutoresetMode.SAME_STEP:
            np.testing.assert_array_equal(info["_final_obs"], info2["_final_obs"])
            for e in np.flatnonzero(done):
                assert_same(info["final_obs"][e], info2["final_obs"][e])
            assert_same(info["final_info"], info2["final_info"])
        elif done.any():
            for key in ("outcome", "_outcome", "social_score", "_social_score"):
                np.testing.assert_array_equal(info[key], info2[key])
        if done.any() and mode is AutoresetMode.DISABLED:
            with pytest.raises(RuntimeError, match="has ended; reset it"):
                vector.step(actions)
            observation = vector.reset(options={"reset_mask": done})[0]
            theirs = sync.reset(options={"reset_mask": done})[0]
            assert_same(observation, theirs)
    assert ends > E


def test_seeds_can_be_given_one_by_one() -> None:
    vector, sync = both(AutoresetMode.NEXT_STEP)
    seeds = [5, 5, 900, 0, 1, 2]
    assert_same(vector.reset(seed=seeds)[0], sync.reset(seed=seeds)[0])
    seeds = [7, None, None, 8, None, 1]
    assert_same(vector.reset(seed=seeds)[0], sync.reset(seed=seeds)[0])
    with pytest.raises(ValueError, match="seed has 2 numbers; it must have 6"):
        vector.reset(seed=[1, 2])
