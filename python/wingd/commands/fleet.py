"""Command line of `wingd-fleet`: commands and options. Their implementation is in commands.py."""

from __future__ import annotations

import argparse
import os
import signal
import sys
from pathlib import Path

from .. import WingdError, __version__
from ..fleet import commands

_TARGET = "RECORDER/FLIGHT, RECORDER, RECORDER@f0012 or @2026-11-01 (from there onwards), aircraft=NAME; the first characters of a recorder's id are enough"


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="wingd-fleet",
        description="Solve many flights of many aircraft again, store the results as tables, query them. LAKE is s3://BUCKET/PREFIX "
        "(credentials in AWS_* variables) or file:///DIRECTORY, as given to `wingd upload`.",
        epilog="Exit status: 0 success, 1 failure, 2 wrong usage.",
    )
    parser.add_argument("--version", action="version", version=f"wingd-fleet {__version__}")
    subs = parser.add_subparsers(dest="command", required=True, metavar="COMMAND")

    def command(name: str, what: str):
        sub = subs.add_parser(name, help=what, description=what)
        sub.add_argument("--lake", required=True, help="s3://BUCKET/PREFIX or file:///DIRECTORY")
        sub.set_defaults(run=commands.task_of if name == "task" else getattr(commands, name))
        return sub

    _ask(command)
    _solve(command)
    _correct(command)
    _keep(command)
    _modes(subs)
    return parser


def _modes(subs) -> None:
    what = "Frequency, damping and shape of a wing's modes from exports of live results, as a table; needs no lake"
    sub = subs.add_parser("modes", help=what, description=what)
    sub.set_defaults(run=commands.modes)
    sub.add_argument(
        "exports",
        nargs="+",
        type=Path,
        metavar="EXPORT",
        help="output of wingd export --table live: .parquet, .csv, .jsonl",
    )
    sub.add_argument(
        "--seconds", type=float, default=300, help="length of a window; modes are identified in each window [300]"
    )
    sub.add_argument(
        "--lowest-hz", type=float, default=1.0, help="lower frequencies are load changes, not vibration [1]"
    )
    sub.add_argument(
        "--count", type=int, default=3, help="maximum number of modes per window, lowest frequency first [3]"
    )
    sub.add_argument(
        "--of", choices=("stations", "markers"), default="stations", help="points whose deflections are used [stations]"
    )
    sub.add_argument("--output", type=Path, metavar="FILE", help=".csv or .parquet [default: CSV, to standard output]")


def _worker(sub) -> None:
    sub.add_argument("--solve", required=True, metavar="NAME")
    sub.add_argument("--jobs", type=int, default=1, help="number of frames of a flight solved at the same time [1]")
    _program(sub)
    sub.add_argument(
        "--work",
        type=Path,
        help="folder for temporary files, emptied at the end [default: the system's temporary folder]",
    )


def _program(sub) -> None:
    sub.add_argument("--wingd", help="the binary [default: WINGD, or wingd on the path]")


def _cache(sub) -> None:
    sub.add_argument("--cache", type=Path, metavar="DIR", help="cache for objects of a bucket [~/.cache/wingd-fleet]")


def _ask(command) -> None:
    sub = command(
        "flights", "List flights with aircraft, wing and upload state; with --solve those that lack its tables"
    )
    sub.add_argument(
        "--solve", metavar="NAME", help="only flights that a task can process now, one per line, e.g. for xargs"
    )
    sub = command("query", "Run an SQL query and print the result as a table")
    _cache(sub)
    sub.add_argument("--solve", metavar="NAME", action="append", help="[default: all]")
    sub.add_argument("--csv", action="store_true", help="print all rows as CSV")
    sub.add_argument("sql", help='e.g. "FROM deflection_by_aircraft"; the views are in the .sql files of the package')
    sub = command("report", "Write a report as one HTML file")
    _cache(sub)
    sub.add_argument("--solve", metavar="NAME", help="[default: the last by name]")
    sub.add_argument("--against", metavar="NAME", help="another solve to compare with")
    sub.add_argument("--output", type=Path, default=Path("fleet.html"), metavar="FILE")
    sub = command("files", "List files with all published rows of a table, digests verified, for other engines")
    _cache(sub)
    sub.add_argument("--table", required=True, help="shots, markers, parameters, span, live, live_markers, live_span")
    sub.add_argument("--solve", metavar="NAME", action="append", help="[default: all]")
    sub = command("fetch", "Download a flight's files, verified against its manifest, as a store that wingd reads")
    sub.add_argument("--flight", required=True, metavar="RECORDER/FLIGHT")
    sub.add_argument("--to", type=Path, required=True, metavar="DIR")


def _solve(command) -> None:
    sub = command("define", "Define a solve: its installations, arguments and program")
    sub.add_argument("--solve", required=True, metavar="NAME")
    _program(sub)
    source = sub.add_mutually_exclusive_group(required=True)
    source.add_argument(
        "--kept", action="store_true", help="use the results uploaded with the flights, compute nothing"
    )
    source.add_argument(
        "--installation",
        action="append",
        metavar="RECORDER[@FROM]=DIR",
        help="one per recorder; more if it changes from a flight (@f0012) or a date (@2026-11-01) onwards",
    )
    sub.add_argument(
        "--length",
        action="append",
        metavar="[TYPE=]M",
        help="length of the wings of a type from the bending root along the axis, m: eta of the table `shape` is a fraction of "
        "it [default: of each model's tip, which depends on its outermost marker]",
    )
    sub.add_argument(
        "arguments", nargs="*", metavar="ARGUMENT", help="after --: arguments of wingd solve, e.g. --method profile"
    )
    sub = command("task", "Process one flight: fetch, solve, export, publish")
    _worker(sub)
    sub.add_argument("--flight", required=True, metavar="RECORDER/FLIGHT")
    sub = command("run", "Process all flights that lack this solve's tables")
    _worker(sub)
    sub.add_argument(
        "--workers",
        type=int,
        default=os.cpu_count(),
        help="number of flights processed at the same time [number of cores]",
    )
    sub.add_argument("--part", metavar="I/N", help="process only part I of N, for N parallel runs; I counts from 0")
    sub.add_argument("--ray", metavar="ADDRESS", help="run on an existing Ray cluster, e.g. auto")


def _correct(command) -> None:
    def by(sub):
        sub.add_argument("--why", required=True, help="reason, stored with the correction")
        sub.add_argument("--by", help="your name [default: the user name]")

    for name, what in (
        ("withdraw", "Exclude a flight or a solve from all results; name and reason are stored"),
        ("restore", "Undo a withdrawal"),
    ):
        sub = command(name, what)
        sub.add_argument("target", nargs="?", metavar="WHAT", help=_TARGET)
        sub.add_argument("--solve", metavar="NAME", help="in this solve only; without a target: the whole solve")
        by(sub)
    sub = command("correct", "Correct aircraft, aircraft_type or wing of flights")
    sub.add_argument("target", metavar="WHAT", help=_TARGET)
    sub.add_argument(
        "--set",
        action="append",
        required=True,
        metavar="NAME=VALUE",
        help="e.g. aircraft=D-ABCD; an empty value means unknown",
    )
    by(sub)
    command("corrections", "List withdrawals and corrections, with name and reason")


def _keep(command) -> None:
    sub = command(
        "compact", "Write a snapshot: all published rows in a few sorted files, for many flights and other engines"
    )
    sub.add_argument("--prune", action="store_true", help="remove older snapshots")
    sub.add_argument("--work", type=Path, help="folder for temporary files, emptied at the end")
    sub = command("verify", "Read every byte of the lake and list damaged and missing objects")
    sub.add_argument(
        "--without-frames", action="store_true", help="skip the frames, e.g. if a rule of the bucket expires them"
    )
    sub = command("repair", "Recreate damaged and missing objects from intact ones")
    sub.add_argument(
        "--without-frames", action="store_true", help="skip the frames, e.g. if a rule of the bucket expires them"
    )
    _program(sub)
    sub.add_argument("--work", type=Path, help="folder for temporary files, emptied at the end")
    sub = command("iceberg", "Write Iceberg tables for the current snapshot (an extra of the package)")
    sub.add_argument("--catalogue", required=True, metavar="URI", help="sqlite:///FILE, or a REST catalogue's URL")


def _stop(number, frame) -> None:
    raise KeyboardInterrupt


def main(arguments: list[str] | None = None) -> int:
    """Run the command line; return the exit status."""
    args = _parser().parse_args(arguments)
    # SIGTERM cleans up as Ctrl-C does.
    signal.signal(signal.SIGTERM, _stop)
    try:
        status = args.run(args) or 0
        sys.stdout.flush()
        return status
    except WingdError as error:
        print(f"wingd-fleet: {error}", file=sys.stderr)
    except BrokenPipeError:
        # The reader has gone, as after `| head`: no error. The final flush of Python goes to /dev/null.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    except OSError as error:
        print(f"wingd-fleet: {error.filename or type(error).__name__}: {error.strerror or error}", file=sys.stderr)
    except KeyboardInterrupt:
        print("wingd-fleet: stopped; run the same command again to continue", file=sys.stderr)
    return 1


if __name__ == "__main__":
    sys.exit(main())
