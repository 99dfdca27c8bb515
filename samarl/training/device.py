"""Device of the networks that are trained, and the memory allocator."""

from __future__ import annotations

import contextlib
import ctypes
import warnings

import torch

from mrsan import ConfigurationError

# Parameters of glibc's mallopt, from malloc.h.
_M_TRIM_THRESHOLD, _M_MMAP_THRESHOLD = -1, -3


def usable_device(name: str) -> torch.device:
    """Return a torch device by its name, after verifying that it can compute.

    Raises:
        ConfigurationError: this machine has no such device, or the device cannot compute.
    """
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # deprecated device names
            device = torch.device(name)
            torch.zeros(1, device=device).add(1.0).cpu()
    except Exception as error:  # each backend raises its own
        reason = (str(error).splitlines() or [type(error).__name__])[0]
        raise ConfigurationError(
            f"trainer.device is {name!r}; it must be a torch device of this machine ({reason})"
        ) from error
    return device


def keep_freed_memory() -> None:
    """Make glibc reuse freed memory for new tensors instead of returning it to the system.

    Requesting the pages of large tensors from the system again, which zeroes them, would take a
    third of an update. Has no effect with other C libraries.
    """
    threshold = 2**30  # bytes
    with contextlib.suppress(OSError, AttributeError):
        mallopt = ctypes.CDLL("libc.so.6").mallopt
        mallopt(_M_MMAP_THRESHOLD, threshold)
        mallopt(_M_TRIM_THRESHOLD, threshold)
