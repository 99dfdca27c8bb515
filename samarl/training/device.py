"""The torch device that the networks are trained on."""

from __future__ import annotations

import warnings

import torch

from mrsan import ConfigurationError


def usable_device(name: str) -> torch.device:
    """Return the torch device of a name, after a computation on it.

    Args:
        name: the setting `trainer.device`.

    Raises:
        ConfigurationError: there is no such device on this machine, or it cannot compute.
    """
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # about names that are no longer devices
            device = torch.device(name)
            torch.zeros(1, device=device).add(1.0).cpu()
    except Exception as error:  # each backend raises its own
        reason = (str(error).splitlines() or [type(error).__name__])[0]
        raise ConfigurationError(
            f"trainer.device is {name!r}; it must be a torch device of this machine ({reason})"
        ) from error
    return device
