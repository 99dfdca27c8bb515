"""The compiled maximum over agents against torch's own operations."""

import pytest
import torch
from torch import Tensor

from mrsan.threads import use_threads
from samarl.encoders import set_pooling as module
from samarl.encoders.set_pooling import set_pooling

ROWS, AGENTS, FEATURES, WIDTH = 21, 5, 4, 12


def inputs(share: float) -> tuple[list[Tensor], Tensor, Tensor]:
    """Return own, first, second and bias, which are learned, the features, and who is known."""
    torch.manual_seed(0)
    known = torch.rand(ROWS, AGENTS) < share
    features = torch.randn(ROWS, AGENTS, FEATURES) * known.unsqueeze(-1)
    shapes = ((ROWS, WIDTH), (WIDTH, FEATURES), (WIDTH, WIDTH), (WIDTH,))
    return [torch.randn(shape) for shape in shapes], features, known


@pytest.mark.parametrize("threads", [1, 2])
@pytest.mark.parametrize("share", [0.0, 0.5, 1.0])
def test_both_forms_and_their_gradients_agree(share: float, threads: int) -> None:
    use_threads(threads)
    learned, features, known = inputs(share)
    results = []
    for is_compiled in (True, False):
        own, first, second, bias = leaves = [x.clone().requires_grad_() for x in learned]
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(module, "on_cpu", lambda _, chosen=is_compiled: chosen)
            pooled = set_pooling(own, features, known, first, second, bias)
        (pooled * torch.linspace(-1, 1, pooled.numel()).view_as(pooled)).sum().backward()
        results.append([pooled.detach(), *(leaf.grad for leaf in leaves)])
    for compiled, expected in zip(*results, strict=True):
        torch.testing.assert_close(compiled, expected, atol=1e-5, rtol=1e-5)


def test_the_maximum_in_plain_python() -> None:
    (own, first, second, bias), features, known = inputs(0.6)
    pooled = set_pooling(own, features, known, first, second, bias)
    for row in range(ROWS):
        expected = torch.zeros(WIDTH)
        for agent in range(AGENTS):
            if known[row, agent]:
                hidden = (own[row] + first @ features[row, agent]).clamp_min(0.0)
                expected = torch.maximum(expected, second @ hidden + bias)
        torch.testing.assert_close(pooled[row], expected, atol=1e-5, rtol=1e-5)
