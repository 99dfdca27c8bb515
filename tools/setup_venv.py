"""Install the project and its pinned dependencies into `.venv`: `python -m tools.setup_venv`.

The interpreter that runs this script is the one that `.venv` uses. Whether `.venv` is up to date is
decided by content, not by date: a stamp file records the folder, the Python version,
`pyproject.toml` and `constraints.txt`. A `.venv` from an earlier checkout of the same folder and
Python version is reused, and only missing packages are installed.

Runs before `.venv` exists, so it uses the standard library only, and any Python from 3.7 on can
report that it is too old.
"""

from __future__ import annotations

import re
import subprocess
import sys
import time
from pathlib import Path

from tools.process import pip_install, run

OLDEST, NEWEST = (3, 11), (3, 13)
VENV = ".venv"
STAMP = f"{VENV}/.installed"
_PRINT_VERSION = "import sys; print('%d.%d' % sys.version_info[:2])"


def version_error(version: tuple[int, int], interpreter: str) -> str | None:
    """Return why a Python version cannot be used, or None if it can."""
    if OLDEST <= version <= NEWEST:
        return None
    oldest, newest, actual = ("{}.{}".format(*v) for v in (OLDEST, NEWEST, version))
    return (
        f"PYTHON is {interpreter}, which is Python {actual}; it must be Python {oldest} to "
        f"{newest}: make PYTHON=python3.13"
    )


def pinned_requirement(constraints: str, package: str) -> str:
    """Return the line of a constraints file that pins a package, such as `torch==2.13.0`.

    Raises:
        ValueError: no line pins the package.
    """
    match = re.search(rf"^{re.escape(package)}==\S+", constraints, re.MULTILINE)
    if match is None:
        raise ValueError(f"constraints.txt does not pin {package}; it must have {package}==VERSION")
    return match[0]


def stamp_text(root: Path, version: str) -> str:
    """Return what identifies an up-to-date `.venv`; the first line tells whether to keep it."""
    files = [
        (root / name).read_text(encoding="utf-8") for name in ("pyproject.toml", "constraints.txt")
    ]
    return "\n".join([f"{root} Python {version}", *files])


def installed_stamp(root: Path) -> str | None:
    """Return the stamp of the last complete setup, or None if there is none."""
    stamp = root / STAMP
    return stamp.read_text(encoding="utf-8") if stamp.is_file() else None


def venv_version(root: Path) -> str | None:
    """Return the Python version of `.venv`, such as `3.11`, or None if it cannot run."""
    try:
        result = subprocess.run(
            [str(root / VENV / "bin/python"), "-c", _PRINT_VERSION],
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            check=True,
        )
    except (OSError, subprocess.CalledProcessError):
        return None
    return result.stdout.decode().strip()


def set_up(root: Path, version: str) -> bool:
    """Bring `.venv` up to date and return whether anything had to be installed.

    Args:
        root: the repository root.
        version: the version of the running interpreter, such as `3.11`.

    Raises:
        SystemExit: `venv` or pip failed and has printed why.
        ValueError: `constraints.txt` does not pin torch.
    """
    stamp, installed = stamp_text(root, version), installed_stamp(root)
    same_version = venv_version(root) == version
    if same_version and stamp == installed:
        return False
    start = time.monotonic()
    print(f"Setting up {VENV} with Python {version} (once; torch takes minutes) ...")
    same_home = installed is None or installed.splitlines()[:1] == stamp.splitlines()[:1]
    if not (same_version and same_home):
        run([sys.executable, "-m", "venv", "--clear", VENV], cwd=root)
    # pip prefers another build of torch unless torch is installed first, at its exact version.
    torch = pinned_requirement((root / "constraints.txt").read_text(encoding="utf-8"), "torch")
    python = root / VENV / "bin/python"
    print(f"  {torch}")
    pip_install(python, torch)
    print("  all other packages, at the versions in constraints.txt")
    pip_install(python, "-c", "constraints.txt", "-e", ".[dev]", cwd=root)
    (root / STAMP).write_text(stamp, encoding="utf-8")
    print(f"Set up in {time.monotonic() - start:.0f} s.")
    return True


def main() -> None:
    """Check the interpreter, then set up `.venv`; errors end in one line and exit code 1."""
    version = sys.version_info[:2]
    error = version_error(version, sys.executable)
    if error is not None:
        sys.exit(f"error: {error}")
    try:
        set_up(Path.cwd(), "{}.{}".format(*version))
    except (OSError, ValueError) as failure:
        sys.exit(f"error: {failure}")


if __name__ == "__main__":
    main()
