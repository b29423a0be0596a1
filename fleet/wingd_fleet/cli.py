"""The command `wingd-fleet`: its words. What they do stands in commands.py."""

from __future__ import annotations

import argparse
import os
import signal
import sys
from pathlib import Path

from . import __version__, commands
from .lake import FleetError

_TARGET = "RECORDER/FLIGHT, RECORDER, RECORDER@f0012 or @2026-11-01 (from there on), aircraft=NAME; the beginning of a recorder's id will do"


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="wingd-fleet",
        description="Many flights of many aircraft: solved again, kept as tables, asked. LAKE is s3://BUCKET/PREFIX "
        "(credentials in AWS_* variables) or file:///DIRECTORY, as given to `wingd upload`.",
        epilog="Exit status: 0 all went well, 1 something could not be done, 2 wrong usage.",
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
    what = "Frequency, damping and shape of a wing's modes from exports of live results, as a table; no lake"
    sub = subs.add_parser("modes", help=what, description=what)
    sub.set_defaults(run=commands.modes)
    sub.add_argument(
        "exports", nargs="+", type=Path, metavar="EXPORT", help="of wingd export --table live: .parquet, .csv, .jsonl"
    )
    sub.add_argument("--seconds", type=float, default=300, help="of a window, which has modes of its own [300]")
    sub.add_argument("--lowest-hz", type=float, default=1.0, help="slower swings are the load's, not the wing's [1]")
    sub.add_argument("--count", type=int, default=3, help="modes of a window at most, the slowest first [3]")
    sub.add_argument("--of", choices=("stations", "markers"), default="stations", help="whose deflections [stations]")
    sub.add_argument("--output", type=Path, metavar="FILE", help=".csv or .parquet [default: CSV, to standard output]")


def _worker(sub) -> None:
    sub.add_argument("--solve", required=True, metavar="NAME")
    sub.add_argument("--jobs", type=int, default=1, help="frames of a flight at a time [1]")
    _program(sub)
    sub.add_argument("--work", type=Path, help="for frames, emptied [default: the system's place for such]")


def _program(sub) -> None:
    sub.add_argument("--wingd", help="the binary [default: WINGD, or wingd on the path]")


def _cache(sub) -> None:
    sub.add_argument("--cache", type=Path, metavar="DIR", help="what a bucket gave is kept here [~/.cache/wingd-fleet]")


def _ask(command) -> None:
    sub = command(
        "flights", "Flights with whose wing they are and how far they have come; with --solve those without its tables"
    )
    sub.add_argument("--solve", metavar="NAME", help="only what a task can do now, one a line, for xargs and its like")
    sub = command("query", "The answer to a question, as a table")
    _cache(sub)
    sub.add_argument("--solve", metavar="NAME", action="append", help="[default: all]")
    sub.add_argument("--csv", action="store_true", help="as CSV, all rows")
    sub.add_argument("sql", help='e.g. "FROM deflection_by_aircraft"; the views are in the .sql files of the package')
    sub = command("report", "One HTML file")
    _cache(sub)
    sub.add_argument("--solve", metavar="NAME", help="[default: the last by name]")
    sub.add_argument("--against", metavar="NAME", help="another solve to hold it against")
    sub.add_argument("--output", type=Path, default=Path("fleet.html"), metavar="FILE")
    sub = command("files", "Files with all published rows of a table, held against their digests, for other engines")
    _cache(sub)
    sub.add_argument("--table", required=True, help="shots, markers, parameters, span, live, live_markers, live_span")
    sub.add_argument("--solve", metavar="NAME", action="append", help="[default: all]")
    sub = command("fetch", "A flight's files, held against its manifest: a store that wingd reads")
    sub.add_argument("--flight", required=True, metavar="RECORDER/FLIGHT")
    sub.add_argument("--to", type=Path, required=True, metavar="DIR")


def _solve(command) -> None:
    sub = command("define", "Say once what a solve is: its installations, arguments and program")
    sub.add_argument("--solve", required=True, metavar="NAME")
    _program(sub)
    what = sub.add_mutually_exclusive_group(required=True)
    what.add_argument("--kept", action="store_true", help="the results that came with the flights, nothing computed")
    what.add_argument(
        "--installation",
        action="append",
        metavar="RECORDER[@FROM]=DIR",
        help="once for each recorder, and again from a flight (@f0012) or a date (@2026-11-01) on",
    )
    sub.add_argument(
        "arguments", nargs="*", metavar="ARGUMENT", help="after --: for wingd solve, e.g. --method profile"
    )
    sub = command("task", "One flight: fetch, solve, export, publish")
    _worker(sub)
    sub.add_argument("--flight", required=True, metavar="RECORDER/FLIGHT")
    sub = command("run", "All flights that lack this solve's tables")
    _worker(sub)
    sub.add_argument(
        "--workers", type=int, default=os.cpu_count(), help="flights at a time on this machine [the cores]"
    )
    sub.add_argument("--part", metavar="I/N", help="only the share of element I of N that run side by side, I from 0")
    sub.add_argument("--ray", metavar="ADDRESS", help="on a Ray cluster that runs already, e.g. auto")


def _correct(command) -> None:
    def by(sub):
        sub.add_argument("--why", required=True, help="for those who ask later")
        sub.add_argument("--by", help="who [default: this user's name]")

    for name, what in (
        ("withdraw", "Take a flight, or a solve, out of every answer; who and why is kept"),
        ("restore", "Take a withdrawal back"),
    ):
        sub = command(name, what)
        sub.add_argument("target", nargs="?", metavar="WHAT", help=_TARGET)
        sub.add_argument("--solve", metavar="NAME", help="of this solve only; alone: all of the solve")
        by(sub)
    sub = command("correct", "Correct whose wing it is: aircraft, aircraft_type, wing")
    sub.add_argument("target", metavar="WHAT", help=_TARGET)
    sub.add_argument(
        "--set", action="append", required=True, metavar="NAME=VALUE", help="e.g. aircraft=D-ABCD; empty: not known"
    )
    by(sub)
    command("corrections", "What was withdrawn or corrected, by whom and why")


def _keep(command) -> None:
    sub = command(
        "compact", "A snapshot: all that is published in few sorted files, for many flights and other engines"
    )
    sub.add_argument("--prune", action="store_true", help="remove the snapshots before it")
    sub.add_argument("--work", type=Path, help="for files under way, emptied")
    sub = command("verify", "Read every byte of the lake and name what is damaged or gone")
    sub.add_argument(
        "--without-frames", action="store_true", help="leave out the frames: a rule of the bucket ages them"
    )
    sub = command("repair", "Make again what is damaged or gone, from what is whole")
    sub.add_argument(
        "--without-frames", action="store_true", help="leave out the frames: a rule of the bucket ages them"
    )
    _program(sub)
    sub.add_argument("--work", type=Path, help="for files under way, emptied")
    sub = command("iceberg", "Iceberg tables over the current snapshot, derived anew (an extra of the package)")
    sub.add_argument("--catalogue", required=True, metavar="URI", help="sqlite:///FILE, or a REST catalogue's URL")
    sub = command(
        "synthesise", "Synthetic flights, made from the results of real ones, into another lake: for trying sizes"
    )
    sub.add_argument("--to", required=True, help="the other lake")
    sub.add_argument("--flights", type=int, required=True)
    sub = command("engines", "Whether pandas, polars, DuckDB and pyarrow read the same in the tables")
    sub.add_argument("--solve", required=True, metavar="NAME")
    _cache(sub)


def _stop(number, frame) -> None:
    raise KeyboardInterrupt


def main(arguments: list[str] | None = None) -> int:
    args = _parser().parse_args(arguments)
    # A polite end leaves nothing, as Ctrl-C does.
    signal.signal(signal.SIGTERM, _stop)
    try:
        status = args.run(args) or 0
        sys.stdout.flush()
        return status
    except FleetError as error:
        print(f"wingd-fleet: {error}", file=sys.stderr)
    except BrokenPipeError:
        # Nobody reads on, as after `| head`: no fault. What Python would flush at its end goes nowhere.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    except OSError as error:
        print(f"wingd-fleet: {error.filename or type(error).__name__}: {error.strerror or error}", file=sys.stderr)
    except KeyboardInterrupt:
        print("wingd-fleet: stopped; the same command goes on with what is missing", file=sys.stderr)
    return 1


if __name__ == "__main__":
    sys.exit(main())
