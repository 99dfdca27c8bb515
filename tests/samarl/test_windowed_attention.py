"""The compiled attention over windows against that of torch's own operations."""

import numba
import pytest
import torch
from torch import Tensor

from samarl.encoders.windowed_attention import by_torch, windowed_attention


def inputs(share: float, p: int = 7, m: int = 5) -> tuple[Tensor, ...]:
    torch.manual_seed(0)
    h, heads, d, frames = 4, 2, 6, 9
    return (
        torch.randn(p, m, d),
        torch.randn(frames, m, 2 * d),
        torch.randint(0, frames, (p, h)),
        torch.rand(p, h, m) < share,
        torch.randn(heads, h),
    )


@pytest.mark.parametrize("threads", [1, 2])
@pytest.mark.parametrize("share", [0.0, 0.3, 1.0])
def test_it_is_torchs_in_value_and_gradient(share: float, threads: int) -> None:
    numba.set_num_threads(threads)
    query, key_value, window, allowed, bias = inputs(share)
    results = []
    for attend in (windowed_attention, by_torch):
        q, k = query.clone().requires_grad_(), key_value.clone().requires_grad_()
        out = attend(q, k, window, allowed, bias)
        (out * torch.linspace(-1, 1, out.numel()).view_as(out)).sum().backward()
        results.append((out, q.grad, k.grad))
    for one, other in zip(*results, strict=True):
        torch.testing.assert_close(one, other, atol=1e-5, rtol=1e-5)
    nobody = ~allowed.any(1)
    assert nobody.any() == (share < 1.0)
    assert not results[0][0][nobody].any()
    if share == 0.0:
        assert not any(gradient.any() for gradient in results[0][1:])
