"""The social score and the splits, in numbers."""

import numpy as np
import pytest

from mrsan import Episodes, Outcome, social_score


def episode(**fields) -> Episodes:
    """One episode of one robot that drove straight to its goal and met nobody."""
    values = {
        "case": [0],
        "episode": [0],
        "duration": [10.0],
        "outcome": [[Outcome.arrived]],
        "path_length": [[10.0]],
        "straight_line": [[10.0]],
        "shortest_path": [[10.0]],
        "time": [[10.0]],
        "closest_human": [[np.inf]],
        "close_share": [[0.0]],
        "personal_share": [[0.0]],
        "social_share": [[0.0]],
        "standing_share": [[0.0]],
        "jerk": [[0.0]],
        "heading_change": [[0.0]],
        "min_time_to_collision": [[np.inf]],
        "robot_at_fault": [[False]],
        "steps": [40],
        "arrived": [[True]],
        "contacts": [[0.0]],
        "comfort_share": [[0.0]],
        "deadlock": [False],
        "intrusion_share": [[np.nan]],
    }
    return Episodes(**{key: np.array(value) for key, value in (values | fields).items()})


@pytest.mark.parametrize(
    ("fields", "score"),
    [
        ({}, 100),
        ({"path_length": [[20.0]]}, 75),  # P = 1/2, C = 1
        ({"path_length": [[9.7]]}, 100),  # it stops a radius before the goal: P is at most 1
        ({"closest_human": [[0.225]]}, 87.5),  # C = 1/2 * 1/2 + 1/2
        ({"closest_human": [[-0.1]]}, 75),
        ({"close_share": [[0.4]]}, 90),  # C = 1/2 + 1/2 * 0.6
        ({"path_length": [[25.0]], "closest_human": [[0.09]], "close_share": [[0.5]]}, 37.5),
        ({"outcome": [[Outcome.timeout]]}, 0),
        ({"outcome": [[Outcome.hit_human]]}, 0),
        ({"outcome": [[Outcome.interrupted]]}, 0),
    ],
)
def test_social_score_by_hand(fields: dict, score: float) -> None:
    assert social_score(episode(**fields))[0, 0] == pytest.approx(score)


def test_success_is_joint() -> None:
    arrived, parted = Outcome.arrived, Outcome.interrupted
    outcomes = [[arrived, arrived], [arrived, Outcome.timeout], [Outcome.hit_robot, parted]]
    record = episode(outcome=outcomes)
    assert record.success.tolist() == [True, False, False]
    assert record.timeout.tolist() == [False, True, False]
    assert record.hit_robot.tolist() == [False, False, True]
    assert record.hit_human.tolist() == [False, False, False]
