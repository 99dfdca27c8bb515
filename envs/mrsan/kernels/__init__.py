"""The compiled numeric core: one task per file, float32, no Python objects.

`function` marks code that only other kernels call. It does not count references to arrays, which
would take a tenth of the time, so it may not create or return arrays, nor copy one with
`a[:] = b`; `allocating` may. Both are copied into their callers; `separate` marks long functions
that are not. `kernel` marks an entry point that loops over worlds with `prange`: compiled on first
use, cached on disk, parallel from two worlds on.

Two pitfalls of Numba shape these files. An array updated in place (`state.clock[e] += 1`) in the
body of a `prange` loop is mistaken for a reduction and the update is lost: put it into a
`function`. And a tuple of arrays is copied wherever it is passed: take the arrays that a hot loop
needs out of it first.
"""

from __future__ import annotations

import hashlib
import types
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numba
from numba.core.registry import CPUDispatcher

from mrsan.threads import kernel_threads, parallel_kernels

# IEEE arithmetic (no fastmath): results do not depend on the number of worlds or threads.
_compiled = partial(numba.njit, error_model="numpy")


class _InlinedFunction(CPUDispatcher):
    """A function without a wrapper for Python, which would double the time of its compilation."""

    def __call__(self, *arguments: Any) -> Any:
        """Call from Python, as tests do: compile a version with a wrapper on first use."""
        if not hasattr(self, "_for_python"):
            self._for_python = _compiled(self.py_func)
        return self._for_python(*arguments)


def _inlined(**settings: Any) -> Callable[[Callable[..., Any]], Any]:
    """Return a decorator for functions that are copied into the kernels that call them."""
    compiled = _compiled(
        forceinline=True, no_cpython_wrapper=True, no_cfunc_wrapper=True, **settings
    )

    def decorate(source: Callable[..., Any]) -> Any:
        dispatcher = compiled(source)
        if isinstance(dispatcher, CPUDispatcher):  # not with NUMBA_DISABLE_JIT
            dispatcher.__class__ = _InlinedFunction
        return dispatcher

    return decorate


allocating = _inlined()
function = _inlined(_nrt=False)
separate = _compiled(_nrt=False)

_PACKAGE = Path(__file__).resolve().parent.parent
_CORE_SOURCES = [
    *sorted(_PACKAGE.glob("kernels/*.py")),
    *(_PACKAGE / f"{name}.py" for name in ("features", "reward", "se2")),
    # The order of the fields of named tuples is part of compiled code.
    *(_PACKAGE / f"{name}.py" for name in ("parameters", "scenario", "state")),
]


class kernel:
    """Compile a loop over worlds in a serial and a parallel version and pick by the batch.

    One world runs serially, which is faster, unless `always_parallel` is set: programs that
    simulate both one and many worlds then compile one version only. All worlds run serially in a
    process that was forked after parallel kernels had run; elsewhere any thread may call kernels,
    and they take turns. The first argument of a kernel is the number of pieces its parallel loop
    is cut into.
    """

    always_parallel = False

    def __init__(self, source: Callable[..., Any]) -> None:
        self.__doc__ = source.__doc__
        self._source = source
        self.serial = _compile(source, "serial", parallel=False)
        self.parallel = _compile(source, "parallel", parallel=True)

    def __call__(self, worlds: int, *arguments: Any) -> Any:
        """Run over `worlds` worlds, the other arguments as the kernel's source declares them."""
        lock = parallel_kernels()
        if lock is None or (worlds == 1 and not kernel.always_parallel):
            return self.serial(1, *arguments)
        with lock:
            return self.parallel(min(worlds, 8 * kernel_threads()), *arguments)

    @property
    def is_cached(self) -> bool:
        """Whether the parallel version was compiled before, by this or an earlier process."""
        cache = getattr(self.parallel, "_cache", None)
        return bool(self.parallel.signatures) or bool(cache and cache._cache_file._load_index())

    def variant(self, name: str, **functions: Any) -> kernel:
        """Return this kernel with other functions in the place of globals that it calls.

        Each variant is compiled and cached by itself, so choosing one costs nothing at run time.

        Args:
            name: of the variant; part of the name of its cache file.
            **functions: compiled functions by the names of the globals that they replace.
        """
        source = self._source
        copy = types.FunctionType(
            source.__code__, {**source.__globals__, **functions}, source.__name__
        )
        copy.__doc__, copy.__qualname__ = source.__doc__, f"{source.__qualname__}_{name}"
        return kernel(copy)


def _compile(source: Callable[..., Any], variant: str, parallel: bool) -> Any:
    copy = types.FunctionType(source.__code__, source.__globals__, source.__name__)
    copy.__module__ = source.__module__
    copy.__qualname__ = f"{source.__qualname__}_{variant}"  # Numba names its cache file by this.
    dispatcher = numba.njit(cache=True, parallel=parallel, error_model="numpy")(copy)
    # Numba considers only the entry point's own file when it decides whether a cached kernel is
    # up to date; the stamp covers every file that the kernel may be built from.
    if hasattr(dispatcher, "_cache"):  # not with NUMBA_DISABLE_JIT
        dispatcher._cache._cache_file._source_stamp = _stamp(source)
    return dispatcher


def _stamp(source: Callable[..., Any]) -> str:
    """Return a digest of the core and of all files that the kernel's functions come from."""
    files, queue = set(_CORE_SOURCES), [source]
    visited = {source.__code__}
    while queue:
        globals_ = queue.pop().__globals__.values()
        called = [value.py_func for value in globals_ if hasattr(value, "py_func")]
        queue += [caller for caller in called if caller.__code__ not in visited]
        visited |= {caller.__code__ for caller in called}
    digest = hashlib.sha256()
    for code in visited:
        if Path(code.co_filename).is_file():
            files.add(Path(code.co_filename))
        else:  # in a notebook
            digest.update(repr((code.co_code, code.co_consts)).encode())
    for file in sorted(files):
        digest.update(file.read_bytes())
    return digest.hexdigest()
