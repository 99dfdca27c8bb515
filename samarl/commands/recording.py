"""`samarl-recording`: summarise, draw and convert a recording of people."""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

from mrsan import Crowd, Scenario
from mrsan.recording import People, RecordingError, Summary, find_problem, read_people, summarize
from mrsan.recording.rows import FRAME_SECONDS, MAX_GAP
from samarl.commands.console import PICTURES, Parser, check_output, origin_of_world, run, table
from samarl.files import write_text

_DECIMALS = 6  # of positions in the output, m
_OPTIONS = {  # options of this command for the settings in messages
    "scenario.frame_seconds": "--frame-seconds",
    "scenario.recording_scale": "--scale",
    "scenario.recording_check=false": "--no-check",
}


def main() -> None:
    """Entry point."""
    run(_parser(), _describe, _OPTIONS)


def _parser() -> Parser:
    parser = Parser(
        "samarl-recording",
        "Summarise a recording of people and check whether it is plausible; draw and convert it. "
        "--frame-seconds and --scale correspond to scenario.frame_seconds and "
        "scenario.recording_scale of the other commands.",
        "a recording of people",
    )
    parser.add_argument(
        "--frame-seconds",
        type=float,
        metavar="S",
        help=f"seconds between frame numbers (default: as stated in the file, or {FRAME_SECONDS})",
    )
    parser.add_argument(
        "--scale",
        type=float,
        metavar="M",
        help="metres per unit of the positions (default: as stated in the file, or 1)",
    )
    parser.add_argument(
        "--figure", type=Path, metavar="PICTURE", help=f"draw the tracks ({', '.join(PICTURES)})"
    )
    parser.add_argument(
        "--output",
        type=Path,
        metavar="TABLE",
        help=f"write 'frame id x y' in metres, frames {FRAME_SECONDS} s apart; with commas and a "
        "header if it ends in .csv",
    )
    parser.add_argument("--no-check", action="store_true", help="accept an implausible recording")
    return parser


def _describe(arguments: argparse.Namespace) -> None:
    """Print the summary, then draw and convert the recording.

    Raises:
        ConfigurationError: an option is not valid.
        RecordingError: the file cannot be read or is implausible.
    """
    path: Path = arguments.file
    _check_options(arguments)
    people = read_people(path, arguments.frame_seconds, arguments.scale)
    summary = summarize(people)
    problem = find_problem(people, summary)
    print(table(_rows(arguments, people, summary, problem)))
    if arguments.figure is not None:
        from samarl.report.tracks import save_tracks  # imports matplotlib, which takes a second

        name = path.name.encode("utf-8", "replace").decode()
        statistics = f"{summary.people} people, {summary.seconds:.0f} s, median speed"
        title = f"{name}\n{statistics} {summary.speed_median:.2f} m/s"
        save_tracks(people, title, arguments.figure)
        print(f"written to {arguments.figure}")
    if problem and not arguments.no_check:
        raise RecordingError(f"{problem}; scenario.recording_check=false accepts it")
    if arguments.output is not None:
        write_text(arguments.output, _as_table(people, arguments.output.suffix == ".csv"))
        print(f"written to {arguments.output}")


def _check_options(arguments: argparse.Namespace) -> None:
    Scenario(
        crowd=Crowd.recorded, frame_seconds=arguments.frame_seconds, recording_scale=arguments.scale
    )
    check_output("--figure", arguments.figure, arguments.file, pictures=True)
    check_output("--output", arguments.output, arguments.file)


def _rows(
    arguments: argparse.Namespace, people: People, summary: Summary, problem: str | None
) -> list[tuple[str, str]]:
    """Return the name and the value of each quantity."""
    rows, s = people.rows, summary
    gaps = f", since a gap of more than {MAX_GAP:g} s starts another" if s.tracks > s.people else ""
    return [
        ("format", rows.format),
        ("people", f"{s.people}, at most {s.people_at_once} at once"),
        ("tracks", f"{s.tracks}{gaps}"),
        ("rows", f"{s.rows}"),
        ("duration", f"{s.seconds:.1f} s"),
        (
            "clock",
            f"{people.frame_seconds:.4g} s between frame numbers "
            f"({_origin(arguments.frame_seconds, rows.frame_seconds)})",
        ),
        ("unit", f"{people.metres:.4g} m ({_origin(arguments.scale, rows.metres)})"),
        ("floor", f"{s.floor[0]:.1f} x {s.floor[1]:.1f} m"),
        ("origin", origin_of_world(people.centre)),
        (
            "speeds",
            f"median {s.speed_median:.2f}, 95 % below {s.speed_95:.2f}, largest "
            f"{s.speed_largest:.2f} m/s",
        ),
        ("longest gap", f"{s.longest_gap:.2f} s"),
        *(("note", note) for note in rows.notes),
        ("verdict", "implausible" if problem else "plausible"),
    ]


def _origin(option: float | None, stated: float | None) -> str:
    """Return where a value comes from."""
    if option is not None:
        return "from the option"
    return "assumed" if stated is None else "as stated in the file"


def _as_table(people: People, commas: bool) -> str:
    """Return the table `frame id x y` in metres, with frames `FRAME_SECONDS` apart."""
    frames = people.rows.frame * (people.frame_seconds / FRAME_SECONDS)
    positions = people.position.round(_DECIMALS)
    separator = "," if commas else " "
    lines = ["frame,id,x,y"] if commas else []
    for k in np.lexsort((people.rows.person, frames)):
        x, y = positions[k].tolist()
        cells = (f"{frames[k]:.10g}", str(people.rows.person[k]), repr(x), repr(y))
        lines.append(separator.join(cells))
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    main()
