"""Collective operations of the processes of one training.

Each process collects experience from its share of the worlds. All processes take the same optimiser
steps with the mean of their gradients, so their weights stay equal. With a single process every
operation returns its input unchanged.
"""

from __future__ import annotations

import atexit
import contextlib
import re
import signal
import sys
import threading
from collections.abc import Iterable, Iterator
from datetime import timedelta
from typing import Any, TypeVar

import torch
import torch.distributed as dist
from safetensors.torch import load, save
from torch import Tensor
from torch.nn import Parameter

from mrsan import ConfigurationError
from samarl.errors import TrainingError
from samarl.launch import rank, world_size

T = TypeVar("T")

BACKENDS = {"cpu": "gloo", "cuda": "cpu:gloo,cuda:nccl"}  # by the device of the networks
TIMEOUT = timedelta(minutes=30)  # long, since rank 0 validates alone
_STOP_SIGNALS = (signal.SIGINT, signal.SIGTERM)
_stop_requested = False


class LostProcessError(TrainingError):
    """Another process of the training run has ended."""


def init_process_group(device: str) -> None:
    """Connect to the other processes, if there are any and it has not been done yet.

    From then on SIGINT and SIGTERM only set a flag, see `stop_requested`.

    Raises:
        ConfigurationError: processes on this device cannot exchange gradients.
        LostProcessError: the other processes do not connect.
    """
    if world_size() == 1 or dist.is_initialized():
        return
    kind = device.partition(":")[0]
    if kind not in BACKENDS:
        raise ConfigurationError(
            f"trainer.device is {device!r}; with several processes it must be cpu or cuda"
        )
    with _detect_lost_process():
        dist.init_process_group(BACKENDS[kind], timeout=TIMEOUT)
    atexit.register(dist.destroy_process_group)
    for number in _STOP_SIGNALS:
        signal.signal(number, _request_stop)


def average_gradients(parameters: Iterable[Parameter]) -> None:
    """Replace all gradients by their means over the processes; a missing gradient counts as 0."""
    if world_size() == 1:
        return
    params = list(parameters)
    has_grad = torch.tensor([float(p.grad is not None) for p in params], device=params[0].device)
    gradients = [torch.zeros_like(p) if p.grad is None else p.grad for p in params]
    mean = torch.cat([has_grad, *(gradient.flatten() for gradient in gradients)]) / world_size()
    with _detect_lost_process():
        dist.all_reduce(mean)
    has_grad, *means = mean.split([len(params), *(p.numel() for p in params)])
    for parameter, any_grad, gradient in zip(params, has_grad.tolist(), means, strict=True):
        parameter.grad = gradient.view_as(parameter) if any_grad else None


def all_gather_object(value: T) -> list[T]:
    """Return the values of all processes, in the order of their ranks."""
    if world_size() == 1:
        return [value]
    values: list[Any] = [None] * world_size()
    with _detect_lost_process():
        dist.all_gather_object(values, value)
    return values


def all_gather_cat(values: Tensor) -> Tensor:
    """Concatenate the values [R] of all processes in the order of their ranks; R may differ."""
    if world_size() == 1:
        return values
    return torch.cat(all_gather_object(values.cpu())).to(values.device)


def gather_to_rank0(tensors: dict[str, Tensor]) -> list[dict[str, Tensor]]:
    """Return the named tensors of all processes on rank 0, and an empty list on the others."""
    if world_size() == 1:
        return [tensors]
    content = save({key: value.contiguous().cpu() for key, value in tensors.items()})
    contents: list[Any] = [None] * world_size() if rank() == 0 else []
    with _detect_lost_process():
        dist.gather_object(content, contents or None)
    return [load(content) for content in contents]


def broadcast_from_rank0(tensors: Iterable[Tensor]) -> None:
    """Overwrite tensors with those of rank 0."""
    if world_size() > 1:
        with _detect_lost_process():
            for tensor in tensors:
                dist.broadcast(tensor, 0)


def stop_requested() -> bool:
    """Return whether any process received SIGINT or SIGTERM.

    All processes get the same answer, so they stop after the same round.
    """
    return any(all_gather_object(_stop_requested))


@contextlib.contextmanager
def defer_stop_signals() -> Iterator[None]:
    """Let SIGINT and SIGTERM only set a flag, see `stop_requested`.

    A run saved in the middle of a round could not be resumed bit for bit. With a single process a
    second signal interrupts immediately.
    """
    global _stop_requested
    if world_size() > 1 or threading.current_thread() is not threading.main_thread():
        yield
        return
    _stop_requested = False
    previous = {number: signal.signal(number, _request_stop) for number in _STOP_SIGNALS}
    try:
        yield
    finally:
        for number, handler in previous.items():
            signal.signal(number, handler)


def _request_stop(number: int, frame: Any) -> None:
    global _stop_requested
    if world_size() == 1:
        if _stop_requested:
            raise KeyboardInterrupt
        if sys.stderr.isatty():
            print("\nstopping after this round (again: stop now without saving)", file=sys.stderr)
    _stop_requested = True


@contextlib.contextmanager
def _detect_lost_process() -> Iterator[None]:
    """Report failures of collective operations, which mean that another process has ended.

    Raises:
        LostProcessError: a collective operation failed.
    """
    try:
        yield
    except RuntimeError as error:
        message = re.sub(r"^\[.*?\] ", "", str(error).splitlines()[0])  # without source location
        reason = message.partition(". ")[0]
        raise LostProcessError(f"another process of the run has ended ({reason})") from None
