"""The compiled attention and convolution within a frame against torch's own operations."""

from collections.abc import Callable

import numba
import pytest
import torch
from torch import Tensor

from samarl.encoders import frame_attention as module
from samarl.encoders.frame_attention import (
    frame_attention,
    frame_attention_weights,
    proximity_convolution,
)

P, T, M, HEADS, WIDTH = 7, 3, 5, 2, 12


def both_forms(call: Callable[..., Tensor], *inputs: Tensor) -> list[tuple[Tensor, ...]]:
    """Results and gradients, compiled and by torch."""
    results = []
    for is_compiled in (True, False):
        leaves = [tensor.clone().requires_grad_() for tensor in inputs]
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(module, "on_cpu", lambda _, chosen=is_compiled: chosen)
            out = call(*leaves)
        (out * torch.linspace(-1, 1, out.numel()).view_as(out)).sum().backward()
        results.append((out.detach(), *(leaf.grad for leaf in leaves if leaf.grad is not None)))
    assert len(results[0]) == 1 + len(inputs)
    return results


def masks(share: float) -> Tensor:
    """Nobody, some or all are known, [P, M]; in the first frame always nobody."""
    known = torch.rand(P, M) < share
    known[0] = False
    return known


@pytest.mark.parametrize("threads", [1, 2])
@pytest.mark.parametrize("share", [0.0, 0.5, 1.0])
def test_both_forms_agree(share: float, threads: int) -> None:
    numba.set_num_threads(threads)
    torch.manual_seed(0)
    query, tokens = torch.randn(P, T, WIDTH), torch.randn(P, M, 2 * WIDTH)
    known, position = masks(share), torch.randn(P, M, 2)
    score = torch.where(known, torch.randn(P, M), -1e9).unsqueeze(-1).repeat(1, 1, HEADS)
    for results in (
        both_forms(lambda q, k: frame_attention(q, k, score), query, tokens),
        both_forms(lambda x: proximity_convolution(x, position, known, 2.5), tokens),
    ):
        for one, other in zip(*results, strict=True):
            torch.testing.assert_close(one, other, atol=1e-5, rtol=1e-5)


def test_shares_add_up_and_leave_out_who_is_not_known() -> None:
    torch.manual_seed(0)
    known = masks(0.5)
    score = torch.where(known, 0.0, -1e9).unsqueeze(-1).repeat(1, 1, HEADS)
    share = frame_attention_weights(torch.randn(P, T, WIDTH), torch.randn(P, M, 2 * WIDTH), score)
    assert share.shape == (P, HEADS, T, M)
    torch.testing.assert_close(share.sum(-1), torch.ones(P, HEADS, T))
    somebody = known.any(1)
    hidden = (~known[somebody])[:, None, None].expand_as(share[somebody])
    assert not share[somebody][hidden].any()


def test_nearer_agents_pass_on_more() -> None:
    passed = torch.eye(3).unsqueeze(0)  # so the result is the shares
    position = torch.tensor([[[0.0, 0.0], [1.0, 0.0], [3.0, 0.0]]])
    share = proximity_convolution(passed, position, torch.ones(1, 3, dtype=torch.bool), 2.0)
    expected = torch.softmax(-2.0 * torch.tensor([0.0, 1.0, 3.0]), 0)
    torch.testing.assert_close(share[0, 0], expected)
