"""The command `wingd-fleet`."""

from __future__ import annotations

import argparse
import sys
import tempfile
from pathlib import Path

from . import __version__, program, solves, task
from .lake import FleetError, Flight, Lake


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="wingd-fleet",
        description="Many flights of many aircraft: solved again, kept as tables, asked. LAKE is s3://BUCKET/PREFIX "
        "(credentials in AWS_* variables) or file:///DIRECTORY, as given to `wingd upload`.",
        epilog="Exit status: 0 all went well, 1 something could not be done, 2 wrong usage.",
    )
    parser.add_argument("--version", action="version", version=f"wingd-fleet {__version__}")
    commands = parser.add_subparsers(dest="command", required=True, metavar="COMMAND")

    def command(name: str, what: str):
        sub = commands.add_parser(name, help=what, description=what)
        sub.add_argument("--lake", required=True, help="s3://BUCKET/PREFIX or file:///DIRECTORY")
        sub.set_defaults(run=globals()[f"_{name}"])
        return sub

    def worker(sub):
        sub.add_argument("--solve", required=True, metavar="NAME")
        sub.add_argument("--wingd", help="the binary [default: WINGD, or wingd on the path]")
        sub.add_argument("--jobs", type=int, default=1, help="frames of a flight at a time [1]")

    sub = command("flights", "Published flights, one a line; with --solve those without its tables")
    sub.add_argument("--solve", metavar="NAME")
    sub = command("define", "Say once what a solve is: its installations, arguments and program")
    sub.add_argument("--solve", required=True, metavar="NAME")
    sub.add_argument("--wingd", help="the binary [default: WINGD, or wingd on the path]")
    what = sub.add_mutually_exclusive_group(required=True)
    what.add_argument("--kept", action="store_true", help="the results that came with the flights, nothing computed")
    what.add_argument("--installation", action="append", metavar="AIRCRAFT=DIR", help="once for each aircraft")
    sub.add_argument(
        "arguments", nargs="*", metavar="ARGUMENT", help="after --: for wingd solve, e.g. --method profile"
    )
    sub = command("task", "One flight: fetch, solve, export, publish")
    worker(sub)
    sub.add_argument("--flight", required=True, metavar="AIRCRAFT/RECORDER/FLIGHT")
    sub.add_argument("--work", type=Path, help="for frames, emptied [default: the system's place for such]")
    sub = command("run", "All flights that lack this solve's tables, on Ray")
    worker(sub)
    sub.add_argument("--workers", type=int, help="on this machine [default: the cores]")
    sub.add_argument("--address", help="a Ray cluster's")
    sub.add_argument("--work", type=Path, help="on each node, for frames, emptied")
    sub = command("slurm", "The same as a Slurm array: writes DIR/array.sh and DIR/flights.txt")
    worker(sub)
    sub.add_argument("--output", type=Path, required=True, metavar="DIR")
    sub.add_argument("--chunk", type=int, default=1, help="flights of an element [1]")
    sub = command("iceberg", "Iceberg tables over a solve's Parquet files: a snapshot and a tag per solve")
    sub.add_argument("--solve", required=True, metavar="NAME")
    sub.add_argument("--catalogue", required=True, metavar="URI", help="sqlite:///FILE, or a REST catalogue's URL")
    for name, help_text in (("report", "One HTML file"), ("query", "The answer to a question, as a table")):
        sub = command(name, help_text)
        sub.add_argument(
            "--cache", type=Path, metavar="DIR", help="tables of a bucket are kept here [~/.cache/wingd-fleet]"
        )
        if name == "report":
            sub.add_argument("--solve", metavar="NAME", help="[default: the last by name]")
            sub.add_argument("--against", metavar="NAME", help="another solve to hold it against")
            sub.add_argument("--output", type=Path, default=Path("fleet.html"), metavar="FILE")
        else:
            sub.add_argument("--solve", metavar="NAME", action="append", help="[default: all]")
            sub.add_argument("sql", help='e.g. "FROM lift_by_aircraft"; the views are in the .sql files of the package')
    sub = command(
        "synthesise", "Synthetic flights, made from the results of real ones, into another lake: for trying sizes"
    )
    sub.add_argument("--to", required=True, help="the other lake")
    sub.add_argument("--flights", type=int, required=True)
    sub = command("engines", "Whether pandas, polars, DuckDB and DataFusion read the same in the tables")
    sub.add_argument("--solve", required=True, metavar="NAME")
    return parser


def main(arguments: list[str] | None = None) -> int:
    args = _parser().parse_args(arguments)
    try:
        return args.run(args) or 0
    except FleetError as error:
        print(f"wingd-fleet: {error}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        print("wingd-fleet: stopped; the same command goes on with what is missing", file=sys.stderr)
        return 1


def _missing(lake: Lake, solve: str | None) -> list[Flight]:
    done = set(lake.committed(solve).get(solve, [])) if solve else set()
    return [flight for flight in lake.flights() if flight not in done]


def _flights(args) -> None:
    for flight in _missing(Lake(args.lake), args.solve):
        print(flight)


def _define(args) -> None:
    installations = None
    if not args.kept:
        pairs = [text.partition("=") for text in args.installation]
        wrong = [name for name, equals, _ in pairs if not equals]
        if wrong:
            raise FleetError(f"--installation {wrong[0]}: give AIRCRAFT=DIR")
        installations = {name: Path(folder) for name, _, folder in pairs}
    # What is kept needs a binary too: its export.
    version = program.version(program.find(args.wingd)) if installations is not None else "as recorded"
    definition = solves.define(Lake(args.lake), args.solve, installations, args.arguments, version)
    of = "the results that came along" if args.kept else f"{version}, {len(definition['installations'])} installations"
    print(f"{args.solve}: {of}")


def _task(args) -> None:
    work = args.work or Path(tempfile.gettempdir()) / "wingd-fleet"
    outcome = task.run(
        Lake(args.lake), args.solve, Flight.parse(args.flight), program.find(args.wingd), work, args.jobs
    )
    print(f"{args.flight}  {outcome}")


def _run(args) -> int:
    from . import ray_driver

    lake = Lake(args.lake)
    definition = solves.read(lake, args.solve)
    flights, wingd = _missing(lake, args.solve), program.find(args.wingd)
    # Before the workers find it out one by one.
    if definition["installations"] != solves.KEPT and program.version(wingd) != definition["program"]:
        raise FleetError(f"{wingd} is {program.version(wingd)}, solve {args.solve} is of {definition['program']}")
    if not flights:
        print("every published flight has its tables")
        return 0
    work = args.work or Path(tempfile.mkdtemp(prefix="wingd-fleet-"))
    counts = ray_driver.run(args.lake, args.solve, flights, wingd, work, args.workers, args.address, args.jobs)
    print(", ".join(f"{count} {outcome}" for outcome, count in sorted(counts.items())))
    return 1 if counts["failed"] else 0


def _slurm(args) -> None:
    from . import slurm

    flights = _missing(Lake(args.lake), args.solve)
    wingd, fleet = program.find(args.wingd), str(Path(sys.argv[0]).resolve())
    script, elements = slurm.write(args.output, args.lake, args.solve, flights, wingd, fleet, args.chunk, args.jobs)
    print(f"{script}: {len(flights)} flights in {elements} elements")


def _iceberg(args) -> None:
    from . import iceberg

    lake = Lake(args.lake)
    counts = iceberg.update(lake, iceberg.catalogue(lake, args.catalogue), args.solve)
    print(", ".join(f"{table}: {count} files" for table, count in counts.items()))


def _report(args) -> None:
    from . import desk, report, synthesise

    solves_asked = [one for one in (args.against, args.solve) if one] if args.solve and args.against else None
    lake = Lake(args.lake)
    report.write(
        desk.Desk(lake, solves_asked, args.cache), args.output, args.solve, args.against, synthesise.is_made(lake)
    )
    print(args.output)


def _query(args) -> None:
    from . import desk

    answer = desk.Desk(Lake(args.lake), args.solve, args.cache).ask(args.sql)
    if answer is not None:
        answer.show(max_width=200, max_rows=10_000)


def _synthesise(args) -> None:
    from . import synthesise

    synthesise.make(Lake(args.lake), Lake(args.to), args.flights)


def _engines(args) -> int:
    from . import engines

    return 0 if engines.compare(Lake(args.lake), args.solve) else 1


if __name__ == "__main__":
    sys.exit(main())
