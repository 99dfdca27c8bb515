"""The folder of compiled kernels, which all checkouts and installations of a user share.

A file is named after all that its content depends on: the code, Numba, Python, the processor and
the types of the arguments. So no file is ever out of date, and processes do not disturb each other.
"""

from __future__ import annotations

import contextlib
import hashlib
import os
import pickle
import stat
import sys
import tempfile
import time
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from types import FunctionType, ModuleType
from typing import Any

import numba
import numpy as np
from numba.core import config
from numba.core.compiler import CompileResult
from numba.core.registry import cpu_target
from numba.core.serialize import dumps
from numba.misc.appdirs import user_cache_dir

try:
    import fcntl
except ModuleNotFoundError:  # on Windows
    fcntl = None  # type: ignore[assignment]

_MOST_BYTES = 512 * 2**20
_MOST_SECONDS = 90 * 24 * 3600.0  # without use
_PACKAGE = Path(__file__).resolve().parent
# How functions are compiled, which their own code does not show.
_COMPILER = (
    (numba.__version__, np.__version__, sys.version, sys.platform),
    *((_PACKAGE / "kernels" / file).read_bytes() for file in ("__init__.py", "structs.py")),
)


@cache
def cache_folder() -> Path:
    """Return `MRSAN_CACHE`, a part of `NUMBA_CACHE_DIR`, or a part of the user's cache folder.

    If the last cannot be written to, for example because a container runs as another user, it is
    a temporary folder. A folder that the user did not name is private, as its content is executed.
    """
    for named, part in ((os.environ.get("MRSAN_CACHE"), ""), (config.CACHE_DIR, "mrsan")):
        if named:
            folder = Path(named, part).absolute()
            folder.mkdir(parents=True, exist_ok=True)
            return folder
    folder = Path(user_cache_dir("mrsan", appauthor=False))
    with contextlib.suppress(OSError):
        folder.mkdir(parents=True, mode=0o700, exist_ok=True)
        tempfile.TemporaryFile(dir=folder).close()
        if _is_private(folder):
            return folder
    folder = _temporary_folder()
    print(
        f"compiled kernels are cached in {folder}: the user's cache folder cannot be written to, "
        "or others can write to it (MRSAN_CACHE names another)",
        file=sys.stderr,
        flush=True,
    )
    return folder


def _temporary_folder() -> Path:
    user = os.getuid() if hasattr(os, "getuid") else 0
    folder = Path(tempfile.gettempdir()) / f"mrsan-kernels-{user}"
    folder.mkdir(mode=0o700, exist_ok=True)
    return folder if _is_private(folder) else Path(tempfile.mkdtemp(prefix="mrsan-kernels-"))


def _is_private(folder: Path) -> bool:
    """Return whether only this user can write to a folder."""
    if sys.platform == "win32":  # where every user has these folders
        return True
    status = folder.lstat()
    owned = status.st_uid == os.getuid() and stat.S_ISDIR(status.st_mode)
    return owned and not status.st_mode & (stat.S_IWGRP | stat.S_IWOTH)


class KernelCache:
    """The compiled versions of one function, in the form that Numba's compilers use."""

    def __init__(self, name: str, source: Any) -> None:
        """Set the name of the files, and the function whose code is compiled."""
        self._name, self._source = name, source
        self.hits = 0

    @property
    def cache_path(self) -> str:
        """The folder."""
        return str(cache_folder())

    def holds(self, signature: Any) -> bool:
        """Return whether a version for a signature was compiled before."""
        return self._file(signature).exists()

    @contextlib.contextmanager
    def lock(self) -> Iterator[None]:
        """Let one process at a time compile the function, so that others need not do it as well."""
        if fcntl is None:
            yield
            return
        with open(cache_folder() / f"{self._name}.lock", "wb") as file:
            fcntl.flock(file, fcntl.LOCK_EX)  # which ends with the process
            yield

    def load_overload(self, signature: Any, target_context: Any) -> CompileResult | None:
        """Return the version for a signature; None if it must be compiled."""
        target_context.refresh()
        file = self._file(signature)
        try:
            content = file.read_bytes()
            os.utime(file)  # its last use
        except OSError:
            return None
        checksum, data = content[:32], content[32:]
        if hashlib.sha256(data).digest() != checksum:
            return None  # damaged, for example when the machine lost power
        self.hits += 1
        return CompileResult._rebuild(target_context, *pickle.loads(data))

    def save_overload(self, signature: Any, result: CompileResult) -> None:
        """Save a version; where that fails, the next process compiles it again."""
        data = dumps(result._reduce())
        file = self._file(signature)
        with contextlib.suppress(OSError):
            _remove_old_files(file.parent)
            handle, new = tempfile.mkstemp(dir=file.parent)
            with os.fdopen(handle, "wb") as stream:
                stream.write(hashlib.sha256(data).digest() + data)
            os.replace(new, file)

    def _file(self, signature: Any) -> Path:
        machine = cpu_target.target_context.codegen().magic_tuple()
        content = repr((_COMPILER, _function_digest(self._source), signature, machine))
        return cache_folder() / f"{self._name}-{hashlib.sha256(content.encode()).hexdigest()[:32]}"


def cached(dispatcher: Any) -> Any:
    """Let a function compiled by `numba.njit` use this cache."""
    if hasattr(dispatcher, "py_func"):  # not with NUMBA_DISABLE_JIT
        source = dispatcher.py_func
        dispatcher._cache = KernelCache(f"{source.__module__}.{source.__qualname__}", source)
    return dispatcher


def _remove_old_files(folder: Path) -> None:
    """Remove the files that were not used for long, and more if they exceed the limit."""
    used = sorted(((entry.stat(), entry) for entry in os.scandir(folder)), key=_last_use)
    total = sum(status.st_size for status, _ in used)
    for status, entry in used:
        if total <= _MOST_BYTES and time.time() - status.st_mtime < _MOST_SECONDS:
            break
        total -= status.st_size
        os.unlink(entry)


def _last_use(file: tuple[os.stat_result, os.DirEntry[str]]) -> float:
    return file[0].st_mtime


_DIGESTS: dict[FunctionType, str] = {}
_OTHERS = {*sys.stdlib_module_names, "numba", "numpy"}  # their versions are in `_COMPILER`


def _function_digest(function: FunctionType) -> str:
    """Return a digest of all code and constants that a compiled function is made of.

    It is that of the loaded code: a source file may have changed since.
    """
    if function not in _DIGESTS:
        _DIGESTS[function] = function.__qualname__  # where it calls itself
        digest = hashlib.sha256()
        for part in _parts(function):
            digest.update(part)
            digest.update(b"\0")
        _DIGESTS[function] = digest.hexdigest()
    return _DIGESTS[function]


def _parts(function: FunctionType) -> Iterator[bytes]:
    code = function.__code__
    yield code.co_code
    for value in (code.co_names, code.co_varnames, code.co_consts, function.__defaults__):
        yield _description(value).encode()
    outer = [cell.cell_contents for cell in function.__closure__ or ()]
    namespace = function.__globals__ | dict(zip(code.co_freevars, outer, strict=True))
    for value in _values_of(namespace, {*code.co_names, *code.co_freevars}):
        yield _description(value).encode()
    is_plugin = not function.__module__.startswith(("mrsan.", "samarl."))
    if is_plugin and os.path.exists(code.co_filename):  # it may use other features of Numba
        yield Path(code.co_filename).read_bytes()


def _values_of(namespace: dict[str, Any], names: set[str]) -> Iterator[Any]:
    """Yield the values of names, also of those in modules such as `rng.START`."""
    for name in sorted(names & namespace.keys()):
        value = namespace[name]
        if not isinstance(value, ModuleType):
            yield value
        elif value.__name__.partition(".")[0] not in _OTHERS:
            yield from _values_of(vars(value), names - {name})


def _description(value: Any) -> str:
    """Return a description of a value that compiled code contains, the same in all processes."""
    if hasattr(value, "py_func"):
        return f"{value.targetoptions} {_function_digest(value.py_func)}"
    if isinstance(value, tuple | list):
        return f"({', '.join(map(_description, value))})"
    if isinstance(value, np.ndarray):
        return f"{value.dtype} {value.shape} {value.tobytes()!r}"
    if isinstance(value, int | float | str | bytes | np.generic | None):
        return repr(value)
    if isinstance(value, FunctionType) and value.__module__.partition(".")[0] not in _OTHERS:
        return _function_digest(value)
    name = getattr(value, "__qualname__", type(value).__qualname__)
    return f"{value.__module__}.{name} {getattr(value, '_fields', '')}"
