"""Compiled kernels lie in one folder of the user and are used while their code is the same."""

import os
import re
import subprocess
import sys
import time
from pathlib import Path

import pytest

from mrsan import Scenario, World, compile_ahead, compile_cache, compile_progress
from mrsan.kernels import Version

HELPER = "from mrsan.kernels import function\n\n@function\ndef helper(x):\n    return x + {}\n"
MIDDLE = "from mrsan.kernels import function\nfrom helper import helper\n\n"
MIDDLE += "@function\ndef middle(x):\n    return helper(x)\n"
ENTRY = """
from mrsan.kernels import kernel
from middle import middle

@kernel
def entry(first, last, out):
    out[0] = middle(out[0])

if __name__ == "__main__":
    import numpy as np
    out = np.zeros(1)
    entry(1, out)
    print(int(out[0]), entry._cache.hits)
"""


def run_entry(folder: Path, cache: Path, added: int) -> str:
    """Run a kernel whose helper, two imports away, adds a number; return it and the cache hits."""
    folder.mkdir(exist_ok=True)
    (folder / "entry.py").write_text(ENTRY)
    (folder / "middle.py").write_text(MIDDLE)
    (folder / "helper.py").write_text(HELPER.format(added))
    return subprocess.run(
        [sys.executable, "-B", "entry.py"],
        cwd=folder,
        capture_output=True,
        text=True,
        check=True,
        env=os.environ | {"MRSAN_CACHE": str(cache)},
    ).stdout


def test_a_kernel_is_compiled_once_for_the_same_code_wherever_it_lies(tmp_path: Path) -> None:
    cache = tmp_path / "cache"
    assert run_entry(tmp_path / "one", cache, 1) == "1 0\n"
    assert run_entry(tmp_path / "two", cache, 25) == "25 0\n"
    assert run_entry(tmp_path / "two", cache, 1) == "1 1\n"
    for file in cache.glob("*entry-*"):
        file.write_bytes(file.read_bytes()[:-1])  # as after a loss of power
    assert run_entry(tmp_path / "one", cache, 1) == "1 0\n"


def test_the_digest_covers_constants_of_other_modules_and_the_fields_of_named_tuples() -> None:
    from mrsan.kernels import orca, rng

    def user() -> object:
        return rng.START, orca.Scratch, rng.uniform

    digests = []
    for module, name, other in ((rng, "START", 99), (orca, "Scratch", World), (rng, "_mix", max)):
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(compile_cache, "_DIGESTS", {})
            digests.append(compile_cache._function_digest(user))
            patch.setattr(compile_cache, "_DIGESTS", {})
            patch.setattr(module, name, other)
            digests.append(compile_cache._function_digest(user))
    same, changed = set(digests[::2]), set(digests[1::2])
    assert len(same) == 1
    assert len(changed) == 3
    assert not same & changed


@pytest.mark.parametrize("obstacle", ["nothing can be written", "others can write"])
def test_compiled_code_that_others_could_have_written_is_not_used(
    obstacle: str, tmp_path: Path
) -> None:
    if obstacle == "nothing can be written":
        (tmp_path / "home").write_text("")
    else:
        for folder in ("home/mrsan", f"mrsan-kernels-{os.getuid()}"):
            (tmp_path / folder).mkdir(parents=True)
            (tmp_path / folder).chmod(0o777)
    done = subprocess.run(
        [sys.executable, "-c", "from mrsan.compile_cache import cache_folder as f; print(f())"],
        capture_output=True,
        text=True,
        check=True,
        env={k: v for k, v in os.environ.items() if k not in ("MRSAN_CACHE", "NUMBA_CACHE_DIR")}
        | {"TMPDIR": str(tmp_path), "XDG_CACHE_HOME": str(tmp_path / "home")},
    )
    used = Path(done.stdout.strip())
    assert used.parent == tmp_path
    assert used.stat().st_mode & 0o77 == 0
    assert done.stderr.count(str(used)) == len(done.stderr.splitlines()) == 1


def test_kernels_are_compiled_side_by_side_before_the_first_episode(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    compiled: list[str] = []

    def start(scenario: Scenario, names: list[str]) -> subprocess.Popen[bytes]:
        compiled.extend(names)
        return subprocess.Popen([sys.executable, "-c", "import time; time.sleep(0.6)"])

    monkeypatch.setenv("MRSAN_COMPILE_NOTICE_PRINTED", "1")
    monkeypatch.setattr(os, "sched_getaffinity", lambda process: {0, 1}, raising=False)
    monkeypatch.setattr(compile_ahead, "_start", start)
    monkeypatch.setattr(compile_progress, "_LINE_SECONDS", 0.25)
    monkeypatch.setattr(compile_progress, "_CLOCK", compile_progress._Clock())
    monkeypatch.setattr(Version, "load", lambda version: compiled.append(version.name))
    monkeypatch.setattr(Version, "is_cached", lambda version: version.name in compiled)
    world = World(Scenario())
    with compile_ahead.compile_ahead(world) as compiles:
        assert compiles
    kernels = ["spawn.begin_episodes", "sensing.observe", "step.advance_orca"]
    assert compiled == [f"mrsan.kernels.{name}" for name in kernels]
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) > 1
    assert all(re.fullmatch(r"compiling: \d+ s, 3 of 3 kernels", line) for line in lines)
    with compile_ahead.compile_ahead(world) as compiles:
        assert not compiles
    assert capsys.readouterr().err == ""
    compiled.clear()
    compile_ahead.compile_missing(world)  # this process has a share
    assert sorted(compiled) == sorted(f"mrsan.kernels.{name}" for name in kernels)


def test_files_that_were_not_used_for_long_are_removed_first(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(compile_cache, "_MOST_BYTES", 25)
    for name, days in (("ancient", 100), ("old", 3), ("recent", 2), ("new", 1)):
        (tmp_path / name).write_bytes(b"0123456789")
        used = time.time() - days * 24 * 3600
        os.utime(tmp_path / name, (used, used))
    compile_cache._remove_old_files(tmp_path)
    assert {path.name for path in tmp_path.iterdir()} == {"recent", "new"}
