"""What the processes of one training tell each other.

Each collects from its share of the worlds. All of them take the same steps of the optimiser with
the mean of their gradients, so their weights stay the same. A process that is alone gets back what
it gave, bit for bit.
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
from samarl.launch import processes, rank

T = TypeVar("T")

BACKENDS = {"cpu": "gloo", "cuda": "cpu:gloo,cuda:nccl"}  # by the device of the networks
PATIENCE = timedelta(minutes=30)  # with a process that says nothing: the first validates alone
_STOPS = (signal.SIGINT, signal.SIGTERM)
_asked_to_stop = False


class LostProcessError(ConfigurationError):
    """Another process of the training has ended."""


def begin(device: str) -> None:
    """Join the other processes, if there are any, unless it is done.

    From then on Ctrl-C and SIGTERM are noted and not obeyed, see `asked_to_stop`.

    Args:
        device: torch device of the networks.

    Raises:
        ConfigurationError: processes on this device cannot exchange gradients.
        LostProcessError: the others do not come.
    """
    if processes() == 1 or dist.is_initialized():
        return
    kind = device.partition(":")[0]
    if kind not in BACKENDS:
        raise ConfigurationError(
            f"trainer.device is {device!r}; with several processes it must be cpu or cuda"
        )
    with _together():
        dist.init_process_group(BACKENDS[kind], timeout=PATIENCE)
    atexit.register(dist.destroy_process_group)
    for number in _STOPS:
        signal.signal(number, _note)


def average_gradients(parameters: Iterable[Parameter]) -> None:
    """Replace all gradients by their means over the processes; who has none counts as zero."""
    if processes() == 1:
        return
    every = list(parameters)
    given = torch.tensor([float(p.grad is not None) for p in every], device=every[0].device)
    gradients = [torch.zeros_like(p) if p.grad is None else p.grad for p in every]
    mean = torch.cat([given, *(gradient.flatten() for gradient in gradients)]) / processes()
    with _together():
        dist.all_reduce(mean)
    given, *means = mean.split([len(every), *(p.numel() for p in every)])
    for parameter, anywhere, gradient in zip(every, given.tolist(), means, strict=True):
        parameter.grad = gradient.view_as(parameter) if anywhere else None


def exchanged(value: T) -> list[T]:
    """What each process gives, in the order of their numbers."""
    if processes() == 1:
        return [value]
    found: list[Any] = [None] * processes()
    with _together():
        dist.all_gather_object(found, value)
    return found


def joined(values: Tensor) -> Tensor:
    """The values [R] of all processes, one after another; each may have another R."""
    if processes() == 1:
        return values
    return torch.cat(exchanged(values.cpu())).to(values.device)


def given_to_first(tensors: dict[str, Tensor]) -> list[dict[str, Tensor]]:
    """The named tensors that each process gives, for the first of them; the others get nothing."""
    if processes() == 1:
        return [tensors]
    content = save({key: value.contiguous().cpu() for key, value in tensors.items()})
    found: list[Any] = [None] * processes() if rank() == 0 else []
    with _together():
        dist.gather_object(content, found or None)
    return [load(of_process) for of_process in found]


def copy_from_first(tensors: Iterable[Tensor]) -> None:
    """Overwrite tensors with those of the first process."""
    if processes() > 1:
        with _together():
            for tensor in tensors:
                dist.broadcast(tensor, 0)


def asked_to_stop() -> bool:
    """Whether any process was, by Ctrl-C or SIGTERM; so all of them stop after the same round."""
    return any(exchanged(_asked_to_stop))


@contextlib.contextmanager
def stopping_between_rounds() -> Iterator[None]:
    """In here Ctrl-C and SIGTERM are noted, see `asked_to_stop`; of one process a second is obeyed.

    What is saved in the middle of a round could not be gone on with bit for bit.
    """
    global _asked_to_stop
    if processes() > 1 or threading.current_thread() is not threading.main_thread():
        yield
        return
    _asked_to_stop = False
    before = {number: signal.signal(number, _note) for number in _STOPS}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def _note(number: int, frame: Any) -> None:
    global _asked_to_stop
    if processes() == 1:
        if _asked_to_stop:
            raise KeyboardInterrupt
        if sys.stderr.isatty():
            print("\nstops after this round (once more: now, without saving)", file=sys.stderr)
    _asked_to_stop = True


@contextlib.contextmanager
def _together() -> Iterator[None]:
    """What fails in here fails because another process is gone."""
    try:
        yield
    except RuntimeError as error:
        said = re.sub(r"^\[.*?\] ", "", str(error).splitlines()[0])  # without the place in torch
        reason = said.partition(". ")[0]
        raise LostProcessError(f"another process of the training has ended ({reason})") from None
