"""The compiled numeric core: one task per file, float32, no Python objects.

`function` marks code that only other kernels call. It does not count references to arrays, which
would take a tenth of the time, so it may not create or return arrays, nor copy one with
`a[:] = b`; `allocating` may. Both are copied into their callers; `separate` marks long functions
that are not. `kernel` marks an entry point that loops over rows, usually worlds: compiled on first
use, cached on disk, parallel from two rows on.

Compiling takes as long as there is code and as there are numbers in its arguments. Named tuples
are therefore passed by reference (`mrsan.kernels.structs`), and what only some scenarios need is
a variant of a kernel.
"""

from __future__ import annotations

import contextlib
import ctypes
import inspect
import types
from collections.abc import Callable, Iterator
from contextvars import ContextVar
from functools import partial
from typing import Any

import numba
from llvmlite import ir
from numba import config, prange
from numba.core.ccallback import CFunc
from numba.core.registry import CPUDispatcher
from numba.extending import intrinsic

from mrsan.compile_cache import KernelCache, cached
from mrsan.compile_progress import compile_progress
from mrsan.kernels.structs import Struct, StructType
from mrsan.threads import kernel_threads, parallel_kernels

# IEEE arithmetic (no fastmath): results do not depend on the number of worlds or threads.
_compiled = partial(numba.njit, error_model="numpy")


class _InlinedFunction(CPUDispatcher):
    """A function without a wrapper for Python, which would double the time of its compilation."""

    def get_call_template(self, args: Any, kws: Any) -> Any:
        """Compile one version for all constants: Numba would compile one for each."""
        args = tuple(map(numba.types.unliteral, args))
        return super().get_call_template(args, kws)

    def __call__(self, *arguments: Any) -> Any:
        """Call from Python, as tests do: compile a version with a wrapper on first use."""
        if not hasattr(self, "_for_python"):
            self._for_python = _compiled(self.py_func)
        return self._for_python(*arguments)


def _inlined(**settings: Any) -> Callable[[Callable[..., Any]], Any]:
    """Return a decorator for functions that are copied into the kernels that call them."""
    compiled = _compiled(
        forceinline=True,
        no_cpython_wrapper=True,
        no_cfunc_wrapper=True,
        **settings,
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


class kernel:
    """Compile a loop over rows, such as worlds, and run it on one thread or on several.

    The source takes the first row to work on and the one after the last, then the arguments of
    calls. A single row is computed in the calling thread, several by a team of threads, or by the
    calling thread in a process that was forked after the team had started. Any thread may call
    kernels; those that use the team take turns.
    """

    def __init__(self, source: Callable[..., Any]) -> None:
        self.__doc__ = source.__doc__
        self._source = source
        self._names = list(inspect.signature(source).parameters)[2:]
        self._versions: dict[StructType, Version] = {}
        if not config.DISABLE_JIT:
            name = f"{source.__module__}.{source.__qualname__}"
            self._entry = _copy(_entry, name, compute=allocating(source))
            self._cache = KernelCache(name, self._entry)

    def __call__(self, rows: int, *arguments: Any) -> None:
        """Run over `rows` rows, the other arguments as the kernel's source declares them."""
        if config.DISABLE_JIT:
            self._source(0, rows, *arguments)
            return
        struct = Struct(self._names, arguments)
        version = self._versions.get(struct.type)
        if version is None:
            version = Version(self._entry, self._cache, struct.type)
            self._versions[struct.type] = version
        if (stand_in := _STAND_IN.get()) is not None:
            stand_in(version)
        else:
            version.run(rows, struct)

    def variant(self, name: str, **functions: Any) -> kernel:
        """Return this kernel with other functions in the place of globals that it calls.

        Each variant is compiled and cached by itself, so choosing one costs nothing at run time.

        Args:
            name: of the variant; part of the name of its cache file.
            **functions: compiled functions by the names of the globals that they replace.
        """
        source = self._source
        return kernel(_copy(source, f"{source.__qualname__}_{name}", **functions))


class Version:
    """A kernel for one type of arguments."""

    def __init__(self, entry: Callable[..., Any], cache: KernelCache, struct_type: StructType):
        number = numba.types.intp
        signature = (number, number, struct_type), numba.types.void
        self.name = entry.__qualname__
        self._callback: Any = CFunc(entry, signature, {}, {"error_model": "numpy"})
        setattr(self._callback, "_cache", cache)  # noqa: B010
        self._cache = cache
        self._run: Callable[[int, int, int], None] | None = None

    def is_cached(self) -> bool:
        """Return whether it was compiled before, by this or another process."""
        return self._run is not None or self._cache.holds(self._callback._sig)

    def load(self) -> Callable[[int, int, int], None]:
        """Load it from the cache, or compile it."""
        if self._run is not None:
            return self._run
        progress = contextlib.nullcontext() if self.is_cached() else compile_progress()
        with progress, self._cache.lock():  # another process may compile it
            self._callback.compile()
        number = ctypes.c_ssize_t
        self._run = ctypes.PYFUNCTYPE(None, number, number, number)(self._callback.address)
        return self._run

    def run(self, rows: int, arguments: Struct) -> None:
        """Run over `rows` rows."""
        run = self.load()
        lock = None if rows == 1 else parallel_kernels()
        if lock is None or kernel_threads() == 1:
            run(0, rows, arguments.address)
            return
        with lock:
            chunks = min(rows, 8 * kernel_threads())
            _run_chunks(self._callback.address, chunks, rows, arguments.address)


_STAND_IN: ContextVar[Callable[[Version], None] | None] = ContextVar("stand_in", default=None)


@contextlib.contextmanager
def replace_runs(stand_in: Callable[[Version], None]) -> Iterator[None]:
    """Let kernels that the body calls be passed to a function instead of being run."""
    token = _STAND_IN.set(stand_in)
    try:
        yield
    finally:
        _STAND_IN.reset(token)


def _copy(source: Callable[..., Any], name: str, **replaced: Any) -> Callable[..., Any]:
    """Return a function with other values of some globals."""
    copy = types.FunctionType(source.__code__, source.__globals__ | replaced, source.__name__)
    copy.__doc__, copy.__module__, copy.__qualname__ = source.__doc__, source.__module__, name
    copy.__defaults__ = source.__defaults__
    return copy


def _entry(first, last, arguments):
    compute(first, last, *arguments.all_fields)  # noqa: F821


@cached
@numba.njit(parallel=True)
def _run_chunks(function, chunks, rows, arguments):
    """Run a compiled kernel, of which the address is given, on all threads."""
    for chunk in prange(chunks):
        _call(function, chunk * rows // chunks, (chunk + 1) * rows // chunks, arguments)


@intrinsic
def _call(typing_context, function, first, last, arguments):
    """Call the function at an address."""
    intp = numba.types.intp

    def generate(context, builder, signature, values):
        number = context.get_value_type(intp)
        kind = ir.FunctionType(ir.VoidType(), [number] * 3)
        builder.call(builder.inttoptr(values[0], kind.as_pointer()), values[1:])
        return context.get_dummy_value()

    return numba.types.void(intp, intp, intp, intp), generate
