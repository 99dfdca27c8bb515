"""What the policy is taught besides its own experience, and how much each level's own counts."""

from collections import defaultdict

import numpy as np
import torch

from samarl.algorithms.advantages import streams
from samarl.planning.shield import Shield, apply_shield
from samarl.policies.policy import LOCAL
from samarl.training.collector import RolloutCollector
from samarl.training.curriculum import CurriculumStage
from samarl.training.setup import build_teacher
from tests import learning


def test_the_shield_is_asked_about_what_the_policy_would_do_without_noise() -> None:
    policy, scenario = learning.policy("flat", gain=30.0), learning.crowded()
    going = RolloutCollector(
        CurriculumStage(16, scenario=scenario),
        policy,
        1,
        0,
        uses_shield_targets=True,
        uses_global_state=True,
    )
    for _ in range(20):
        decision = going.decision
        wanted = decision.step.mean.clamp(-1.0, 1.0).numpy()
        steps = going.collect().steps
        safe = steps["agents", "safe_action"][:, 0].numpy()
        np.testing.assert_array_equal(
            safe, apply_shield(decision.tracks, wanted, scenario, Shield())
        )
        unsafe = steps["agents", "unsafe"][:, 0].numpy()
        np.testing.assert_array_equal(safe[~unsafe], wanted[~unsafe])
        if unsafe.any():
            break
    assert unsafe.any()
    assert (safe[unsafe] != wanted[unsafe]).any(-1).all()


def test_the_policy_learns_what_the_shield_would_do_where_it_is_unsafe() -> None:
    policy, scenario = learning.policy("flat"), learning.crowded()
    learner = learning.algorithm(
        policy,
        learning_rate=3e-3,
        epochs=10,
        shield_coefficient=30.0,
        advantage_filter_fraction=0.25,
    )
    going = RolloutCollector(
        CurriculumStage(16, scenario=scenario),
        policy,
        16,
        0,
        uses_shield_targets=True,
        uses_global_state=True,
    )
    rollout = going.collect()
    unsafe = rollout.steps["agents", "unsafe"][:, :-1]
    assert unsafe.any()
    assert not (unsafe & ~rollout.steps["agents", "active_mask"][:, :-1]).any()

    def error() -> float:
        choice, _, _ = learning.choices(policy, rollout)[LOCAL]
        acts = streams(rollout.steps).acts.transpose(1, 2)
        safe = rollout.steps["agents", "safe_action"][:, :-1].transpose(1, 2)[acts]
        wrong = (choice.mean - safe)[unsafe.transpose(1, 2)[acts]]
        return float(wrong.square().sum(-1).mean())

    before = error()
    learner.update([rollout])
    assert error() < 0.7 * before


def test_every_decision_counts_the_same_whatever_its_level() -> None:
    policy = learning.policy("hierarchical")
    learner = learning.algorithm(
        policy,
        minibatches=1,
        critic_coefficient=0.0,
        action_limit_penalty=0.0,
        entropy_coefficient=0.0,
        macro_entropy_coefficient=0.0,
        clip_epsilon=0.5,
    )
    rollout = learning.collector(policy, 6, 12).collect()
    statistics: dict[str, list[float]] = defaultdict(list)
    (data,) = learner.prepare([rollout], statistics)
    acts = data.levels[LOCAL]["decides"]
    selected = acts & (torch.rand(acts.shape) < 0.3)  # of all, the advantages add up to zero
    loss = learner._policy_loss(data._replace(selected=selected), statistics, [])
    # Before anything has moved all ratios are 1: the objective is minus the advantage.
    total = sum(
        float(level["advantage"][level["decides"] & selected].sum())
        for level in data.levels.values()
    )
    assert abs(float(loss.detach()) + total / int(selected.sum())) < 1e-4
    assert abs(total) > 1.0


def test_the_teacher_acts_on_what_the_policy_observes() -> None:
    policy, scenario = learning.policy("flat"), learning.crowded()
    teacher = build_teacher("orca", scenario)
    collector = RolloutCollector(
        CurriculumStage(4, scenario=scenario), policy, 3, 0, teacher=teacher
    )
    expected = teacher.act(collector.observation)
    steps = collector.collect().steps
    np.testing.assert_array_equal(steps["agents", "teacher_action"][:, 0], expected)


def test_a_teacher_says_its_action_in_a_share_of_the_worlds() -> None:
    policy, scenario = learning.policy("flat"), learning.crowded()
    stage = CurriculumStage(4, scenario=scenario, teacher="orca", teacher_share=0.5)
    teacher = build_teacher(stage.teacher, scenario)
    collector = RolloutCollector(stage, policy, 3, 0, teacher=teacher)
    expected = build_teacher("orca", scenario).act(collector.observation)
    steps = collector.collect().steps["agents"]
    np.testing.assert_array_equal(steps["has_teacher"][:, 0, 0], [True, True, False, False])
    np.testing.assert_array_equal(steps["teacher_action"][:2, 0], expected[:2])


def test_what_no_teacher_says_has_no_effect() -> None:
    """Two stages, one of which has a teacher, are learned from together."""
    policy, scenario = learning.policy("flat"), learning.crowded()
    learner = learning.algorithm(policy, teacher_coefficient=30.0)
    rollouts = [
        RolloutCollector(
            CurriculumStage(4, scenario=scenario),
            policy,
            16,
            first,
            uses_global_state=True,
            teacher=build_teacher(name, scenario),
        )
        for first, name in ((0, "orca"), (8, None))
    ]
    data = [collector.collect(imitates=True) for collector in rollouts]
    data[1].steps["agents", "teacher_action"][:] = 1e3
    assert learner.update(data)["losses/teacher_error"] < 10.0


def test_the_policy_learns_what_the_teacher_would_do() -> None:
    policy, scenario = learning.policy("flat"), learning.crowded()
    learner = learning.algorithm(
        policy, learning_rate=3e-3, epochs=10, teacher="orca", teacher_coefficient=30.0
    )
    collector = RolloutCollector(
        CurriculumStage(16, scenario=scenario),
        policy,
        16,
        0,
        uses_global_state=True,
        teacher=build_teacher("orca", scenario),
    )
    rollout = collector.collect()
    errors = [learner.update([rollout])["losses/teacher_error"] for _ in range(5)]
    assert errors[-1] < 0.5 * errors[0]
