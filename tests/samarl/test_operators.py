"""The kernels of the encoders as operators of torch: registered correctly, opaque to compilers."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest
import torch
from torch import Tensor
from torch.library import opcheck

from samarl.encoders.frame_attention import frame_attention, proximity_convolution
from samarl.encoders.windowed_attention import windowed_attention

P, T, M, H, HEADS, WIDTH, FRAMES = 5, 2, 3, 4, 2, 8, 6  # letters of `windowed_attention`
PUBLIC: dict[str, Callable[..., Tensor]] = {
    "frame_attention": frame_attention,
    "proximity_convolution": proximity_convolution,
    "windowed_attention": windowed_attention,
}


def arguments(name: str) -> tuple[Any, ...]:
    torch.manual_seed(0)
    query, key_value = (torch.randn(P, m, d) for m, d in ((T, WIDTH), (M, 2 * WIDTH)))
    if name == "frame_attention":
        return query.requires_grad_(), key_value.requires_grad_(), torch.randn(P, M, HEADS)
    if name == "proximity_convolution":
        return key_value.requires_grad_(), torch.randn(P, M, 2), torch.rand(P, M) < 0.5, 2.5
    return (
        torch.randn(P, M, WIDTH, requires_grad=True),
        torch.randn(FRAMES, M, 2 * WIDTH, requires_grad=True),
        torch.randint(0, FRAMES, (P, H)),
        torch.rand(P, H, M) < 0.5,
        torch.randn(HEADS, H),
    )


@pytest.mark.parametrize("name", PUBLIC)
def test_schema_fake_results_and_gradients_are_consistent(name: str) -> None:
    opcheck(getattr(torch.ops.samarl, name).default, arguments(name))


@pytest.mark.parametrize("name", PUBLIC)
def test_a_call_without_gradients_gives_the_same_bits(name: str) -> None:
    inputs = arguments(name)
    with torch.no_grad():
        direct = PUBLIC[name](*inputs)
    assert not direct.requires_grad
    through_torch = PUBLIC[name](*inputs)
    assert through_torch.requires_grad
    torch.testing.assert_close(direct, through_torch.detach(), rtol=0, atol=0)
