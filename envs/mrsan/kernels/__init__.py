"""The compiled numeric core: one job a file, float32, no Python objects.

`function` marks code that only other kernels call. It does not count who refers to an array, which
would take a tenth of the time, and so may not make or return any, nor copy one with `a[:] = b`:
`allocating` may. `kernel` marks an entry point that loops over worlds with `prange`: compiled on
first use, cached on disk, parallel from two worlds on.

Two traps of Numba shape these files. An array updated in place (`state.clock[e] += 1`) in the body
of a `prange` loop is taken for a reduction and silently lost: update it in a `function`. And a
tuple of arrays is copied wherever it is passed: take what a hot loop needs out of it first.
"""

from __future__ import annotations

import hashlib
import types
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numba

from mrsan.threads import kernel_threads, parallel_kernels

# IEEE arithmetic (no fastmath): a case gives the same bits on any number of worlds or threads.
_inlined = partial(numba.njit, error_model="numpy", forceinline=True)
allocating = _inlined()
function = _inlined(_nrt=False)

_PACKAGE = Path(__file__).resolve().parent.parent
_CORE_SOURCES = [
    *sorted(_PACKAGE.glob("kernels/*.py")),
    *(_PACKAGE / f"{name}.py" for name in ("features", "reward", "se2")),
    # The order of the fields of named tuples is part of compiled code.
    *(_PACKAGE / f"{name}.py" for name in ("parameters", "scenario", "state")),
]


class kernel:
    """Compile a loop over worlds in a serial and a parallel version and pick by the batch.

    One world runs serially, which is faster. So do all worlds in a process that was forked after
    parallel kernels had run; elsewhere any thread may call kernels, and they take turns. The first
    argument of a kernel is the number of pieces its parallel loop is cut into.
    """

    def __init__(self, source: Callable[..., Any]) -> None:
        self.__doc__ = source.__doc__
        self.serial = _compile(source, "serial", parallel=False)
        self.parallel = _compile(source, "parallel", parallel=True)

    def __call__(self, worlds: int, *arguments: Any) -> Any:
        """Run over `worlds` worlds, the other arguments as the kernel's source declares them."""
        lock = parallel_kernels()
        if worlds == 1 or lock is None:
            return self.serial(1, *arguments)
        with lock:
            return self.parallel(min(worlds, 8 * kernel_threads()), *arguments)


def _compile(source: Callable[..., Any], variant: str, parallel: bool) -> Any:
    copy = types.FunctionType(source.__code__, source.__globals__, source.__name__)
    copy.__module__ = source.__module__
    copy.__qualname__ = f"{source.__qualname__}_{variant}"  # Numba names its cache file by this.
    dispatcher = numba.njit(cache=True, parallel=parallel, error_model="numpy")(copy)
    # Numba looks only at the entry point's own file when it decides whether a cached kernel is
    # still good; the stamp below covers every file the kernel may be built from.
    if hasattr(dispatcher, "_cache"):  # not with NUMBA_DISABLE_JIT
        dispatcher._cache._cache_file._source_stamp = _stamp(source)
    return dispatcher


def _stamp(source: Callable[..., Any]) -> str:
    """A digest of the core, the kernel's file and those that its functions are imported from."""
    files, queue = set(_CORE_SOURCES), [source]
    while queue:
        found = queue.pop()
        file = Path(found.__code__.co_filename)
        if file not in files:
            files.add(file)
            queue += [v.py_func for v in found.__globals__.values() if hasattr(v, "py_func")]
    digest = hashlib.sha256()
    for file in sorted(files):
        digest.update(file.read_bytes())
    return digest.hexdigest()
