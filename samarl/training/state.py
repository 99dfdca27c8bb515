"""The state of a training run as named tensors, which safetensors stores without pickle."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import torch
from torch import Tensor
from torch.optim import Optimizer
from torch.utils._pytree import (
    GetAttrKey,
    MappingKey,
    SequenceKey,
    tree_flatten_with_path,
    tree_unflatten,
)

from samarl.distributed import gather_to_rank0
from samarl.launch import rank


def flatten_state(state: Any) -> dict[str, Tensor]:
    """Return copies of all tensors, arrays and numbers of a nested structure, named by their paths.

    For example, `optimisers/adam/3/exp_avg` is a moment of parameter 3.
    """
    leaves, _ = tree_flatten_with_path(state)
    return {
        _name(path): torch.as_tensor(leaf).detach().clone()
        for path, leaf in leaves
        if leaf is not None
    }


def gather_state(state: dict[str, Any]) -> dict[str, Tensor]:
    """Flatten the states of all processes on rank 0.

    It is equal in all processes, except its part `rankR`, which only process R has.

    Returns:
        The named tensors, on rank 0 with those of the other processes.
    """
    tensors = flatten_state(state)
    prefix = f"rank{rank()}/"
    own_tensors = {name: value for name, value in tensors.items() if name.startswith(prefix)}
    for process_tensors in gather_to_rank0(own_tensors):
        tensors |= process_tensors
    return tensors


def unflatten_state(
    example: dict[str, Any],
    tensors: Mapping[str, Tensor],
    optimisers: Mapping[str, Optimizer],
) -> dict[str, Any]:
    """Invert `flatten_state`.

    Args:
        example: a state with the same structure, shapes and types, except its `optimisers`.
        tensors: the named tensors; additional ones are ignored.
        optimisers: whose moments are returned as the part `optimisers`. An optimiser creates its
            moments in its first step, so there is no example for them.

    Raises:
        ValueError: a tensor is missing, or its shape or type is wrong.
    """
    leaves, structure = tree_flatten_with_path(example | {"optimisers": {}})
    values = [_restored(_name(path), leaf, tensors) for path, leaf in leaves]
    state: dict[str, Any] = tree_unflatten(values, structure)
    for name, optimiser in optimisers.items():
        state["optimisers"][name] = _moments(f"optimisers/{name}/", optimiser, tensors)
    return state


def _moments(
    prefix: str, optimiser: Optimizer, tensors: Mapping[str, Tensor]
) -> dict[int, dict[str, Tensor]]:
    """Return the moments of an optimiser, whose names are `prefix`, parameter, `/` and moment."""
    parameters = [p for group in optimiser.param_groups for p in group["params"]]
    moments: dict[int, dict[str, Tensor]] = {}
    for name, value in tensors.items():
        if name.startswith(prefix):
            index, moment = name.removeprefix(prefix).split("/")
            if value.dim() and value.shape != parameters[int(index)].shape:
                raise ValueError(f"{name} has shape {list(value.shape)}")
            moments.setdefault(int(index), {})[moment] = value.clone()
    return moments


def _name(path: tuple[Any, ...]) -> str:
    """Return the keys, indices and field names of a path, joined by slashes."""
    parts = []
    for key in path:
        match key:
            case MappingKey():
                parts.append(str(key.key))
            case SequenceKey():
                parts.append(str(key.idx))
            case GetAttrKey():
                parts.append(key.name)
            case _:
                raise TypeError(f"a state cannot contain a {type(key).__name__}")
    return "/".join(parts)


def _restored(name: str, example: Any, tensors: Mapping[str, Tensor]) -> Any:
    """Return the tensor of a name as a leaf of the same kind as `example`."""
    if example is None:
        return None
    expected, value = torch.as_tensor(example), tensors.get(name)
    if value is None or (value.shape, value.dtype) != (expected.shape, expected.dtype):
        raise ValueError(f"{name} must be a tensor {list(expected.shape)} of {expected.dtype}")
    # Copied, because the alignment of a file's buffer differs, and with it the rounding of sums.
    if isinstance(example, Tensor):
        return value.to(example.device).clone()
    return value.numpy().copy()
