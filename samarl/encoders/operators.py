"""Kernels compiled by Numba as operators of torch, which `torch.compile` does not look into."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial
from typing import Any

import numba
import torch
from numpy.typing import NDArray
from torch import Tensor

from mrsan.compile_cache import cached

Tensors = tuple[Tensor, ...]

# Sums may be reordered here (vector units), unlike in the simulator; the result is still the same
# every time on one machine, whatever the number of threads.
FASTMATH = {"reassoc", "contract", "nsz"}
_njit = partial(numba.njit, error_model="numpy", fastmath=FASTMATH)


def compiled(source: Callable[..., Any]) -> Any:
    """Return a kernel: compiled on first use, cached, its `prange` loops on several threads."""
    return cached(_njit(parallel=True)(source))


def serial(source: Callable[..., Any]) -> Any:
    """Return a kernel on one thread: to start others can take longer than a decision's work."""
    return cached(_njit()(source))


def on_cpu(tensor: Tensor) -> bool:
    """Whether the compiled kernels can be used; an exported policy consists of torch operations."""
    exported = torch.onnx.is_in_onnx_export()
    return tensor.device.type == "cpu" and tensor.dtype == torch.float32 and not exported


class Operator:
    """A kernel as an operator of torch, `torch.ops.samarl.<name>`.

    Where no gradient is needed and nothing is compiled, a call goes straight to the kernel: torch's
    dispatcher would make a decision for one robot 8 % slower.
    """

    def __init__(
        self,
        name: str,
        schema: str,
        empty_outputs: Callable[..., Any],
        launch: Callable[..., None],
    ) -> None:
        """Register the operator.

        Args:
            name: Name of the operator.
            schema: Types of its inputs and outputs, `(Tensor query, float slope) -> Tensor`.
            empty_outputs: Allocates the outputs, contiguous, for the inputs.
            launch: Runs the kernel on the arrays of the inputs, followed by those of the outputs.
        """

        def run(*inputs: Any) -> Any:
            outputs = empty_outputs(*inputs)
            filled = outputs if isinstance(outputs, tuple) else (outputs,)
            launch(*map(_as_array, inputs), *map(_as_array, filled))
            return outputs

        self._run = run
        self._definition = torch.library.custom_op(
            f"samarl::{name}", run, mutates_args=(), device_types="cpu", schema=schema
        )
        self._definition.register_fake(empty_outputs)
        self.op = getattr(torch.ops.samarl, name).default

    def register_gradient(
        self,
        saved: Callable[[Tensors, Tensors], Tensors],
        gradient: Callable[..., tuple[Tensor | None, ...]],
    ) -> None:
        """Make the operator differentiable, as far as its first output is concerned.

        Args:
            saved: Selects the tensors that the gradient depends on, from inputs and outputs.
            gradient: Computes the gradients of the inputs from these tensors and the gradient of
                the first output.
        """

        def setup_context(ctx: Any, inputs: Tensors, output: Tensors) -> None:
            ctx.save_for_backward(*saved(inputs, output))
            ctx.set_materialize_grads(False)

        def backward(ctx: Any, of_first: Tensor, *_: Tensor | None) -> tuple[Tensor | None, ...]:
            return gradient(*ctx.saved_tensors, of_first)

        self._definition.register_autograd(backward, setup_context=setup_context)

    def __call__(self, *inputs: Any) -> Any:
        """Compute the outputs for the inputs."""
        if torch.is_grad_enabled() or torch.compiler.is_compiling():
            return self.op(*inputs)
        return self._run(*inputs)


def unflatten(array: NDArray, *sizes: int) -> NDArray:
    """A view of an array with its last axis split into `sizes` and what remains."""
    return array.reshape(*array.shape[:-1], *sizes, array.shape[-1] // math.prod(sizes))


def _as_array(value: Any) -> NDArray | float:
    return value.detach().contiguous().numpy() if isinstance(value, Tensor) else value
