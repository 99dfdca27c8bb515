"""Warnings about training runs that are likely to fail."""

from samarl.training.health import Health


def test_each_warning_is_given_once() -> None:
    health = Health()
    fine = {"losses/actor_gradient_norm": 20.0, "losses/local_entropy": -5.0, "charts/success": 0.0}
    assert health.update(fine, 0.4) == []
    (diverges,) = health.update(fine | {"losses/actor_gradient_norm": 2000.0}, 0.45)
    assert "losses/actor_gradient_norm is 2e+03" in diverges
    (entropy,) = health.update(fine | {"losses/local_entropy": -20.0}, 0.46)
    assert "losses/local_entropy is -20" in entropy
    (failing,) = health.update(fine, 0.5)
    assert "no episode has succeeded" in failing
    assert health.update(fine | {"losses/local_entropy": 9.0}, 0.6) == []
    assert list(health.warnings.values()) == [diverges, entropy, failing]


def test_one_success_is_enough() -> None:
    health = Health()
    assert health.update({"validation/success_90_10h_3r": 0.1}, 0.2) == []
    assert health.update({"charts/success": 0.0}, 0.9) == []
