"""Does it refuse what is wrong? `python -m benchmarks.malformed --number 10000`.

Malformed policies, cards, predictors, training states, tables, recordings, curves and
configurations go through the functions that load them. Each must be refused with an error that a
command says in one line, or be taken for what it is; nothing else may be raised, nothing may hang,
and nothing may ask for gigabytes. A sample goes through the commands themselves.
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

from benchmarks.malformed_kinds import KINDS, Good, Item
from benchmarks.workload import add_output, interruptible, made_by, positive_whole_number
from mrsan import ActionError, ConfigurationError
from mrsan.recording import RecordingError
from samarl.files import check_writable, write_json

REFUSED, ACCEPTED = "refused", "accepted"
SECONDS = 60.0  # may pass until something is refused; on an idle machine it takes milliseconds
MEMORY = 2 * 2**30  # bytes more than before may be asked for


class Hang(BaseException):
    """It took too long."""


def make_item(number: int, good: Good, seed: int = 0) -> Item:
    """The malformed thing of a number: its kinds take turns."""
    r = random.Random(f"{seed}/{number}")
    kind = list(KINDS)[number % len(KINDS)]
    return KINDS[kind](r, good)


def outcome(item: Item) -> str:
    """Load it: `REFUSED`, `ACCEPTED`, or what went wrong."""
    said = "nothing"
    try:
        with _limits(), warnings.catch_warnings():
            warnings.simplefilter("error", RuntimeWarning)
            item.load()
        return ACCEPTED
    except (ConfigurationError, ActionError, RecordingError) as error:
        said = str(error)
    except Hang:
        return f"it took more than {SECONDS:g} s"
    except BaseException as error:
        return f"{type(error).__name__}: {str(error)[:300]}"
    if not said.strip() or (item.names and not any(name in said for name in item.names)):
        return f"the error names none of {', '.join(item.names)}: {said[:300]}"
    return REFUSED


@contextlib.contextmanager
def _limits() -> Iterator[None]:
    """Of time and memory."""

    def ring(*_: Any) -> None:
        raise Hang

    before = signal.signal(signal.SIGALRM, ring)
    soft, hard = resource.getrlimit(resource.RLIMIT_AS)
    statm = Path("/proc/self/statm")
    if statm.exists():
        used = int(statm.read_text().split()[0]) * resource.getpagesize()
        resource.setrlimit(resource.RLIMIT_AS, (used + MEMORY, hard))
    signal.setitimer(signal.ITIMER_REAL, SECONDS)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, before)
        resource.setrlimit(resource.RLIMIT_AS, (soft, hard))


def by_command(item: Item, folder: Path) -> str:
    """The same through the command itself: `REFUSED`, or what it said instead of one line."""
    done = subprocess.run(
        [sys.executable, "-m", f"samarl.commands.{item.command[0]}", *item.command[1:]],
        cwd=folder, capture_output=True, text=True, timeout=600,
    )  # fmt: skip
    lines = [line for line in done.stderr.splitlines() if not line.startswith("Compiling ")]
    if done.returncode == 2 and len(lines) == 1 and lines[0].startswith("error: "):
        return REFUSED
    return f"exit code {done.returncode}: {done.stderr[-300:]}"


def main() -> None:
    """Run, print and write what came of it; exit code 1 if anything was not refused in words."""
    arguments = _parse()
    try:
        check_writable(arguments.output, "--output")
    except ConfigurationError as error:
        sys.exit(f"error: {error}")
    output = arguments.output.resolve()  # what is loaded lies in a folder of its own
    begin = time.perf_counter()
    counts: dict[str, collections.Counter[str]] = collections.defaultdict(collections.Counter)
    failures: list[dict[str, Any]] = []
    commands, slowest, r = 0, 0.0, random.Random(arguments.seed)
    with tempfile.TemporaryDirectory() as name, interruptible():
        good = Good(Path(name))
        numbers = arguments.only or range(arguments.number)
        for number in tqdm(numbers, "malformed", unit="item", disable=None):
            item = make_item(number, good, arguments.seed)
            started = time.perf_counter()
            found = outcome(item)
            slowest = max(slowest, time.perf_counter() - started)
            sampled = r.random() < 3 * arguments.commands / len(numbers)
            if sampled and found == REFUSED and item.command and commands < arguments.commands:
                commands += 1
                found = by_command(item, good.folder)
            kind = found if found in (REFUSED, ACCEPTED) else "wrong"
            counts[item.kind][kind] += 1
            if kind == "wrong":
                failures.append({"number": number, "kind": item.kind, "what": found})
                tqdm.write(f"{number} {item.kind}: {found}", sys.stderr)
    result = {
        "number": len(numbers),
        "wrong": len(failures),
        "failures": failures[:100],
        "by_kind": {kind: dict(sorted(found.items())) for kind, found in counts.items()},
        "through_commands": commands,
        "slowest_seconds": round(slowest, 2),
        "seconds": round(time.perf_counter() - begin, 1),
        **made_by("malformed"),
    }
    write_json(output, result)
    for kind, of_kind in counts.items():
        print(f"{kind:20}", ", ".join(f"{count} {what}" for what, count in of_kind.items()))
    print(f"written to {arguments.output}")
    if failures:
        sys.exit(f"error: {len(failures)} of {len(numbers)} were neither refused nor accepted")


def _parse() -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.malformed",
        description="Load thousands of malformed files and configurations; fail on a traceback.",
    )
    parser.add_argument(
        "--number", type=positive_whole_number, default=10_000, help="how many (default: 10000)"
    )
    parser.add_argument("--seed", type=int, default=0, help="of all of them (default: 0)")
    parser.add_argument("--only", type=int, nargs="*", help="these alone, to look at them")
    parser.add_argument(
        "--commands", type=int, default=40,
        help="so many of them through the commands as well (default: 40)",
    )  # fmt: skip
    add_output(parser, "malformed")
    return parser.parse_args()


if __name__ == "__main__":
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    main()
