"""A compiled kernel that lies on disk is used again only while its sources are the same."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from mrsan import Scenario, compile_ahead
from mrsan.kernels import kernel

HELPER = "from mrsan.kernels import function\n\n@function\ndef helper(x):\n    return x + {}\n"
MIDDLE = "from mrsan.kernels import function\nfrom helper import helper\n\n"
MIDDLE += "@function\ndef middle(x):\n    return helper(x)\n"
ENTRY = """
from mrsan.kernels import kernel
from middle import middle

@kernel
def entry(chunks, out):
    out[0] = middle(out[0])

if __name__ == "__main__":
    import numpy as np
    out = np.zeros(1)
    entry(1, out)
    loaded = sum(entry.serial.stats.cache_hits.values())
    print(int(out[0]), loaded)
"""


def test_a_change_two_imports_away_compiles_a_kernel_anew(tmp_path: Path) -> None:
    (tmp_path / "entry.py").write_text(ENTRY)
    (tmp_path / "middle.py").write_text(MIDDLE)

    def played(added: int) -> str:
        (tmp_path / "helper.py").write_text(HELPER.format(added))
        command = [sys.executable, "-B", "entry.py"]
        return subprocess.run(
            command, cwd=tmp_path, capture_output=True, text=True, check=True
        ).stdout

    assert played(1) == "1 0\n"
    assert played(1) == "1 1\n"
    assert played(25) == "25 0\n"


NOWHERE = """
import os, sys
from numba.core.caching import _CacheLocator

allowed, ensure = sys.argv[1], _CacheLocator.ensure_cache_path

def refuse(self):
    if not self.get_cache_path().startswith(allowed):
        raise PermissionError(self.get_cache_path())
    ensure(self)

_CacheLocator.ensure_cache_path = refuse
import mrsan
from mrsan.kernels.step import advance
print(advance.serial._cache.cache_path)
"""


@pytest.mark.parametrize("folder_exists", [False, True])
def test_where_nothing_can_be_written_kernels_lie_in_a_private_temporary_folder(
    folder_exists: bool, tmp_path: Path
) -> None:
    if folder_exists:  # somebody else may have put code there
        folder = tmp_path / f"mrsan-kernels-{os.getuid()}"
        folder.mkdir()
        folder.chmod(0o777)
    done = subprocess.run(
        [sys.executable, "-c", NOWHERE, str(tmp_path)],
        capture_output=True,
        text=True,
        check=True,
        env={**os.environ, "TMPDIR": str(tmp_path), "NUMBA_CACHE_DIR": ""},
    )
    (used,) = {path for path in tmp_path.glob("mrsan-kernels-*") if path.stat().st_mode & 0o77 == 0}
    assert done.stdout.startswith(str(used))
    assert done.stderr.count("compiled kernels are cached in") == 1
    assert len(done.stderr.splitlines()) == 1


def test_an_inlined_function_can_be_called_from_python() -> None:
    """It has no wrapper of its own: without a version that has one, the process would crash."""
    run = "from mrsan.kernels.contact import closest_approach as f; print(f(1.0, 0.0, 0.0, 1.0))"
    done = subprocess.run([sys.executable, "-c", run], capture_output=True, text=True, check=True)
    assert float(done.stdout) == pytest.approx(0.5**0.5)


def test_progress_is_printed_while_kernels_are_compiled(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def start(part: str, scenario: Scenario) -> subprocess.Popen[bytes]:
        return subprocess.Popen([sys.executable, "-c", "import time; time.sleep(1.5)"])

    monkeypatch.setenv("MRSAN_COMPILE_NOTICE_PRINTED", "1")
    monkeypatch.setattr(compile_ahead, "_start", start)
    monkeypatch.setattr(compile_ahead, "_PROGRESS_SECONDS", 0.25)
    monkeypatch.setattr(compile_ahead, "_USUAL_SECONDS", 0.5)
    monkeypatch.setattr(kernel, "is_cached", False)
    with compile_ahead.compile_ahead(Scenario()) as compiles:
        assert compiles
    assert capsys.readouterr().err.splitlines()[:2] == [
        "compiling: 0.25 s of about 0.5 s",
        "compiling: 0.5 s (about 0.5 s on an idle machine)",
    ]
    monkeypatch.setattr(kernel, "is_cached", True)
    with compile_ahead.compile_ahead(Scenario()) as compiles:
        assert not compiles
    assert capsys.readouterr().err == ""
