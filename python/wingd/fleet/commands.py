"""Commands of `wingd-fleet`; each returns the exit status, None for 0."""

from __future__ import annotations

import getpass
import os
import socket
import sys
import tempfile
from pathlib import Path

from . import corrections as log
from . import program, records, shapes, solves, task
from .lake import FleetError, Flight, Lake
from .state import State


def _work(args) -> Path:
    """Return a work folder per user, because another user's folder is not writable."""
    return args.work or Path(tempfile.gettempdir()) / f"wingd-fleet-{os.getuid()}"


def _cache(args) -> Path:
    return args.cache or Path.home() / ".cache" / "wingd-fleet"


def flights(args) -> None:
    """List flights, or those that a solve lacks."""
    state = State(Lake(args.lake), _default_cache())
    if args.solve:
        for flight in state.missing(args.solve):
            print(flight)
        return
    state.read_manifests()
    for flight in state.flights:
        about = state.about(flight)
        whose = "  ".join(part or "-" for part in (about.aircraft, about.aircraft_type, about.wing))
        gone = state.withdrawn(flight)
        said = f"withdrawn: {gone['why']}" if gone else state.arrived(flight)
        print(f"{flight}  {whose}  {about.started}  {said}")


def _default_cache() -> Path:
    return Path.home() / ".cache" / "wingd-fleet"


def define(args) -> None:
    """Define a solve."""
    lake = Lake(args.lake)
    installations = None if args.kept else solves.rules(lake, args.installation)
    version = "as recorded" if args.kept else program.version(program.find(args.wingd))
    lengths = shapes.parse_lengths(args.length or [])
    definition = solves.define(lake, args.solve, installations, args.arguments, version, lengths)
    source = "the uploaded results" if args.kept else f"{version}, {len(definition['installations'])} installations"
    print(f"{args.solve}: {source}")


def task_of(args) -> None:
    """Process one flight."""
    flight = Flight.parse(args.flight)
    outcome = task.run(Lake(args.lake), args.solve, flight, program.find(args.wingd), _work(args), args.jobs)
    print(f"{flight}  {outcome}")


def run(args) -> int:
    """Process all flights that lack tables of a solve."""
    from . import run as local

    lake = Lake(args.lake)
    definition = solves.read(lake, args.solve)
    flights, wingd = State(lake, _default_cache()).missing(args.solve), program.find(args.wingd)
    if args.part:
        flights = local.part(flights, args.part)
    # Checked here once, before each worker would fail.
    if definition["installations"] != solves.KEPT and program.version(wingd) != definition["program"]:
        raise FleetError(f"{wingd} is {program.version(wingd)}, solve {args.solve} needs {definition['program']}")
    if not flights:
        print("every uploaded flight has its tables")
        return 0
    if args.ray:
        from . import ray_driver

        counts = ray_driver.run(args.lake, args.solve, flights, wingd, _work(args), args.ray, args.jobs)
    else:
        counts = local.run(lake, args.solve, flights, wingd, _work(args), args.workers, args.jobs)
    print(", ".join(f"{count} {outcome}" for outcome, count in sorted(counts.items())))
    return 1 if counts["failed"] else 0


def fetch(args) -> None:
    """Download a flight as a store."""
    lake, flight = Lake(args.lake), Flight.parse(args.flight)
    if args.to.exists() and any(args.to.iterdir()):
        raise FleetError(f"--to {args.to}: is not empty; give another directory")
    manifest = records.read(lake, flight.manifest)
    task.needs(lake, flight, "frames")
    task.fetch(lake, flight, manifest, args.to)
    print(args.to)


def _target(lake: Lake, args) -> dict:
    of = {}
    if args.target:
        of = log.target([flight.recorder for flight in solves.flights(lake)], args.target)
    if getattr(args, "solve", None):
        solves.read(lake, args.solve)
        of["solve"] = args.solve
    if not of:
        raise FleetError("give a target: RECORDER/FLIGHT, RECORDER, aircraft=NAME, or --solve NAME")
    return of


def _by(args) -> str:
    return args.by or f"{getpass.getuser()}@{socket.gethostname()}"


def _add(args, what: str, values: dict | None = None) -> None:
    lake = Lake(args.lake)
    of = _target(lake, args)
    state = State(lake, _default_cache())
    before = {(one.solve, one.flight): one.about for one in state.published()}
    number = log.add(lake, what, of, _by(args), args.why, values)
    after = {(one.solve, one.flight): one.about for one in State(lake, _default_cache()).published()}
    changed = sum(before.get(key) != after.get(key) for key in before | after)
    print(
        f"correction {number}: changes the tables of {changed} flights; run `wingd-fleet compact` to update other engines"
    )


def withdraw(args) -> None:
    """Exclude flights or a solve from all results."""
    _add(args, "withdraw")


def restore(args) -> None:
    """Undo a withdrawal."""
    _add(args, "restore")


def correct(args) -> None:
    """Correct aircraft, type or wing."""
    pairs = [text.partition("=") for text in args.set]
    if wrong := [name for name, equals, _ in pairs if not equals]:
        raise FleetError(f"--set {wrong[0]}: give NAME=VALUE, e.g. aircraft=D-ABCD")
    _add(args, "set", {name: value or None for name, _, value in pairs})


def corrections(args) -> None:
    """List withdrawals and corrections."""
    for record in log.Corrections.read(Lake(args.lake)).records:
        of = " ".join(f"{name}={value}" for name, value in record["of"].items())
        what = " ".join(f"{name}={value}" for name, value in record["set"].items()) or record["what"]
        print(f"{record['number']}  {record['at']}  {record['by']}  {of}: {what}  ({record['why']})")


def compact(args) -> None:
    """Write a snapshot."""
    from . import snapshot

    id = snapshot.make(Lake(args.lake), _work(args), args.prune, lambda text: print(text, file=sys.stderr))
    print(f"{args.lake.rstrip('/')}/{snapshot.PLACE}/{id}")


def verify(args) -> int:
    """List damaged and missing objects."""
    from . import damage

    faults = damage.verify(Lake(args.lake), not args.without_frames)
    for fault in faults:
        print(fault)
    print(f"{len(faults)} faults" if faults else "all objects are intact", file=sys.stderr)
    return 1 if faults else 0


def repair(args) -> int:
    """Recreate damaged and missing objects."""
    from . import damage

    lake = Lake(args.lake)
    faults = damage.verify(lake, not args.without_frames)
    left = damage.repair(lake, faults, program.find(args.wingd), _work(args), print) if faults else []
    for fault in left:
        print(f"not repaired: {fault}")
    print(
        f"{len(faults) - len(left)} of {len(faults)} faults repaired" if faults else "nothing is damaged",
        file=sys.stderr,
    )
    return 1 if left else 0


def files(args) -> None:
    """List files with all published rows of a table."""
    from . import desk, parquet

    if args.table not in parquet.TABLES:
        raise FleetError(f"--table {args.table}: give one of {', '.join(parquet.TABLES)}")
    for path in desk.files(Lake(args.lake), args.table, args.solve, _cache(args)):
        print(path)


def iceberg(args) -> None:
    """Write Iceberg tables."""
    from . import iceberg as derived

    lake = Lake(args.lake)
    counts = derived.update(lake, derived.catalogue(lake, args.catalogue))
    print(", ".join(f"{table}: {count} files" for table, count in counts.items()))


def report(args) -> None:
    """Write the report."""
    from . import desk
    from . import report as page

    asked = [one for one in (args.against, args.solve) if one] if args.solve and args.against else None
    lake = Lake(args.lake)
    page.write(desk.Desk(lake, asked, _cache(args)), args.output, args.solve, args.against, lake.is_synthetic())
    print(args.output)


def query(args) -> None:
    """Run an SQL query and print its result."""
    from . import desk

    asked = desk.Desk(Lake(args.lake), args.solve, _cache(args))
    for text in asked.incomplete():
        print(f"wingd-fleet: {text}", file=sys.stderr)
    if args.csv:
        asked.write_csv(args.sql, sys.stdout)
    else:
        asked.show(args.sql)


def modes(args) -> int:
    """Identify modes of a wing."""
    from .. import modes as of_wings

    return of_wings.run(args.exports, args.seconds, args.lowest_hz, args.count, args.of, args.output, sys.stdout)
