"""Install the newest wheel of `dist/` into a fresh environment and run its commands there.

`python -m tools.check_wheel` takes minutes, because torch is installed again.
"""

from __future__ import annotations

import os
import sys
import tempfile
import time
from pathlib import Path

from tools.process import run

# The modules, the configuration and the results must all come from the fresh environment.
CHECK_LOCATIONS = """
import os, mrsan, samarl
from samarl.files import find_folder
home = os.path.realpath("venv") + os.sep
places = [samarl.__file__, mrsan.__file__, *map(str, map(find_folder, ("conf", "results")))]
outside = [p for p in places if not (os.path.realpath(p).startswith(home) and os.path.exists(p))]
assert not outside, outside
"""
COMMANDS = [
    ["samarl-evaluate", "agent=orca", "evaluation.cases=5"],
    ["samarl-record", "agent=samarl", "case=28", "output=case.csv"],
    ["samarl-macro", "training.steps=20000", "validation_cases=5"],
    ["samarl-predictor", "predictor=recurrent", "validation_cases=5"],
    ["samarl-examples", "examples"],
    ["samarl-bench", "agents=[straight]", "evaluation.cases=5", "output=bench"],
]
SAMPLE = "lib/python*/site-packages/mrsan/recording/synthetic.txt"


def check_wheel(root: Path, folder: Path) -> None:
    """Install the newest wheel of `root/dist` into `folder/venv` and run it in `folder`."""
    wheels = sorted((root / "dist").glob("samarl-*.whl"), key=lambda path: path.stat().st_mtime)
    if not wheels:
        sys.exit("error: dist/ has no wheel; run make wheel first")
    print(f"Installing {wheels[-1].name} into a fresh environment (torch takes minutes) ...")
    scripts = folder / "venv/bin"
    python = scripts / "python"
    constraints = root / "constraints.txt"
    run([sys.executable, "-m", "venv", str(folder / "venv")])
    pins = constraints.read_text(encoding="utf-8").splitlines()
    torch = next(pin for pin in pins if pin.startswith("torch=="))
    pip = [str(python), "-m", "pip", "--disable-pip-version-check", "--no-input", "-qq"]
    run([*pip, "install", torch])
    run([*pip, "install", "-c", str(constraints), str(wheels[-1])])
    env = {**os.environ, "PATH": f"{scripts}{os.pathsep}{os.environ['PATH']}"}
    env.pop("PYTHONPATH", None)  # it could hide a module that the wheel lacks
    samples = [str(path) for path in (folder / "venv").glob(SAMPLE)]
    commands = [*COMMANDS, ["samarl-recording", *samples, "--figure", "people.png"]]
    for name, *arguments in commands:
        run([str(scripts / name), *arguments], cwd=folder, env=env)
    run([str(python), "-c", CHECK_LOCATIONS], cwd=folder, env=env)


def main() -> None:
    """Check the wheel in a temporary folder."""
    start = time.monotonic()
    with tempfile.TemporaryDirectory() as folder:
        check_wheel(Path.cwd(), Path(folder))
    print(f"The wheel works: checked in {time.monotonic() - start:.0f} s.")


if __name__ == "__main__":
    main()
