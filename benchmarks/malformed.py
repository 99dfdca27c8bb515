"""Load malformed inputs: `python -m benchmarks.malformed --number 10000`.

Malformed policies, metadata, predictors, training states, tables, recordings, curves and
configurations are passed to the functions that load them. Each must be refused with an error that
a command reports in one line, or load without an error. Other exceptions, hangs and allocations of
gigabytes are failures. A sample is also passed to the commands themselves.
"""

from __future__ import annotations

import argparse
import collections
import contextlib
import os
import random
import resource
import signal
import subprocess
import sys
import tempfile
import time
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from tqdm import tqdm

from benchmarks.malformed_kinds import KINDS, MalformedInput, ValidInputs
from benchmarks.workload import add_output, interruptible, positive_whole_number, provenance
from mrsan import ActionError, ConfigurationError
from mrsan.recording import RecordingError
from samarl.files import check_writable, write_json
from samarl.progress import progress_bar

REFUSED, ACCEPTED = "refused", "accepted"
SECONDS = 60.0  # time limit of one input; on an idle machine it takes milliseconds
MEMORY = 2 * 2**30  # limit of the additional memory of one input, bytes


class TimeLimitExceeded(BaseException):
    """Loading an input exceeded the time limit."""


def make_input(number: int, valid: ValidInputs, seed: int = 0) -> MalformedInput:
    """Return the malformed input with a number; the kinds alternate."""
    r = random.Random(f"{seed}/{number}")
    kind = list(KINDS)[number % len(KINDS)]
    return KINDS[kind](r, valid)


def outcome(item: MalformedInput) -> str:
    """Load an input and return `REFUSED`, `ACCEPTED` or a description of the failure."""
    try:
        with _limits(), warnings.catch_warnings():
            warnings.simplefilter("error", RuntimeWarning)
            item.load()
        return ACCEPTED
    except (ConfigurationError, ActionError, RecordingError) as error:
        message = str(error)
    except TimeLimitExceeded:
        return f"loading took more than {SECONDS:g} s"
    except BaseException as error:
        return f"{type(error).__name__}: {str(error)[:300]}"
    if not message.strip() or (item.names and not any(name in message for name in item.names)):
        return f"the error names none of {', '.join(item.names)}: {message[:300]}"
    return REFUSED


@contextlib.contextmanager
def _limits() -> Iterator[None]:
    """Limit time and memory."""

    def raise_exceeded(*_: Any) -> None:
        raise TimeLimitExceeded

    previous_handler = signal.signal(signal.SIGALRM, raise_exceeded)
    soft, hard = resource.getrlimit(resource.RLIMIT_AS)
    statm = Path("/proc/self/statm")
    if statm.exists():
        used = int(statm.read_text(encoding="utf-8").split()[0]) * resource.getpagesize()
        resource.setrlimit(resource.RLIMIT_AS, (used + MEMORY, hard))
    signal.setitimer(signal.ITIMER_REAL, SECONDS)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, previous_handler)
        resource.setrlimit(resource.RLIMIT_AS, (soft, hard))


def command_outcome(item: MalformedInput, folder: Path) -> str:
    """Pass an input to its command; return `REFUSED` or a description of the failure."""
    result = subprocess.run(
        [sys.executable, "-m", f"samarl.commands.{item.command[0]}", *item.command[1:]],
        cwd=folder,
        capture_output=True,
        text=True,
        timeout=600,
    )
    lines = [line for line in result.stderr.splitlines() if not line.startswith("Compiling ")]
    if result.returncode == 2 and len(lines) == 1 and lines[0].startswith("error: "):
        return REFUSED
    return f"exit code {result.returncode}: {result.stderr[-300:]}"


def main() -> None:
    """Load all inputs, print and write the counts; exit with code 1 if there were failures."""
    arguments = _parse()
    try:
        check_writable(arguments.output, "--output")
    except ConfigurationError as error:
        sys.exit(f"error: {error}")
    output = arguments.output.resolve()  # inputs are loaded in a temporary folder
    start = time.perf_counter()
    counts: dict[str, collections.Counter[str]] = collections.defaultdict(collections.Counter)
    failures: list[dict[str, Any]] = []
    commands, slowest, r = 0, 0.0, random.Random(arguments.seed)
    with tempfile.TemporaryDirectory() as name, interruptible():
        valid = ValidInputs(Path(name))
        numbers = arguments.only or range(arguments.number)
        for number in progress_bar(numbers, desc="malformed", unit="input"):
            item = make_input(number, valid, arguments.seed)
            loading_start = time.perf_counter()
            item_outcome = outcome(item)
            slowest = max(slowest, time.perf_counter() - loading_start)
            share = 3 * arguments.commands / len(numbers)
            sampled = commands < arguments.commands and r.random() < share
            if sampled and item_outcome == REFUSED and item.command:
                commands += 1
                item_outcome = command_outcome(item, valid.folder)
            category = item_outcome if item_outcome in (REFUSED, ACCEPTED) else "wrong"
            counts[item.kind][category] += 1
            if category == "wrong":
                failures.append({"number": number, "kind": item.kind, "what": item_outcome})
                tqdm.write(f"{number} {item.kind}: {item_outcome}", sys.stderr)
    result = {
        "number": len(numbers),
        "wrong": len(failures),
        "failures": failures[:100],
        "by_kind": {kind: dict(sorted(of_kind.items())) for kind, of_kind in counts.items()},
        "through_commands": commands,
        "slowest_seconds": round(slowest, 2),
        "seconds": round(time.perf_counter() - start, 1),
        **provenance("malformed"),
    }
    write_json(output, result)
    for kind, of_kind in counts.items():
        print(f"{kind:20}", ", ".join(f"{count} {category}" for category, count in of_kind.items()))
    print(f"written to {arguments.output}")
    if failures:
        sys.exit(f"error: {len(failures)} of {len(numbers)} inputs failed")


def _parse() -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.malformed",
        description="Load thousands of malformed files and configurations; fail on a traceback.",
    )
    parser.add_argument(
        "--number",
        type=positive_whole_number,
        default=10_000,
        help="of inputs (default: 10000)",
    )
    parser.add_argument("--seed", type=int, default=0, help="seed of the inputs (default: 0)")
    parser.add_argument("--only", type=int, nargs="*", help="load only these inputs, by number")
    parser.add_argument(
        "--commands",
        type=int,
        default=40,
        help="number of inputs that are also passed to commands (default: 40)",
    )
    add_output(parser, "malformed")
    return parser.parse_args()


if __name__ == "__main__":
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    main()
