"""One flight, one task: fetch, solve, export, publish. Done twice, or half and again, it gives the same tables.

What makes it so: a task changes nothing but its own folder until it publishes; an object is created where there is
none; the commit comes last, and readers look at committed flights alone.
"""

from __future__ import annotations

import shutil
import tempfile
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path, PurePosixPath
from typing import Callable

from . import parquet, program, solves
from .lake import TABLES, FleetError, Flight, Lake, Passing, dump, sha256

# Objects fetched at a time.
FETCHES = 8


def run(
    lake: Lake,
    solve: str,
    flight: Flight,
    wingd: str,
    work: Path,
    jobs: int = 1,
    at: Callable[[str], None] = lambda step: None,
) -> str:
    """Publishes the tables of a flight; `there` where they were, `done` where this task made them.

    `work` is a folder for frames and tables, emptied at the end. `at` is told each step before it is done: for tests.
    """
    if lake.get(flight.commit(solve)) is not None:
        return "there"
    definition = solves.read(lake, solve)
    work.mkdir(parents=True, exist_ok=True)
    folder = Path(tempfile.mkdtemp(prefix=f"{flight.flight}-", dir=work))
    try:
        return _run(lake, definition, flight, wingd, folder, jobs, at)
    except Passing:
        raise
    except FleetError as error:
        reason = str(error).replace(str(folder), "")
        data = dump({"flight": str(flight), "solve": solve, "reason": reason})
        lake.create(flight.failure(solve, sha256(data)), data)
        raise FleetError(f"{flight}: {reason}") from error
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def _run(lake, definition, flight, wingd, folder, jobs, at) -> str:
    at("fetch")
    manifest = lake.json(flight.manifest)
    kept = definition["installations"] == solves.KEPT
    store = folder / "store"
    fetch(lake, flight, manifest, store, frames=not kept)
    inputs = None
    if not kept:
        at("solve")
        inputs = _solve(lake, definition, flight, wingd, store, folder / "installation", jobs)
    at("export")
    identity = {
        "solve": definition["solve"],
        "aircraft": flight.aircraft,
        "aircraft_type": manifest["aircraft_type"],
    }
    published = {}
    for table in TABLES:
        file = folder / f"{table}.parquet"
        program.export(wingd, store, flight.flight, table, file, inputs)
        data, facts = parquet.identified(file, table, identity)
        at(f"publish {table}")
        published[table] = _publish(lake, flight.table(table, definition["solve"]), data, facts)
    at("commit")
    commit = {
        "solve": definition["solve"],
        "flight": str(flight),
        "aircraft_type": manifest["aircraft_type"],
        "started": manifest["started"],
        "manifest": manifest["digest"],
        "tables": published,
    }
    return "done" if lake.create(flight.commit(definition["solve"]), dump(commit)) else "there"


def fetch(lake: Lake, flight: Flight, manifest: dict, store: Path, frames: bool = True) -> None:
    """A published flight as a store; each file is held against the manifest. Without frames where none is solved."""

    def bring(entry: dict) -> None:
        key = flight.file(entry["name"])
        data = lake.get(key)
        if data is None or len(data) != entry["length"] or sha256(data) != entry["sha256"]:
            raise FleetError(f"{lake.url}/{key}: is not what the manifest says; upload the flight below another prefix")
        name = PurePosixPath(entry["name"])
        if name.is_absolute() or ".." in name.parts:
            raise FleetError(f"{flight.manifest}: names {entry['name']!r}, which lies outside of the flight")
        path = store / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(data)

    wanted = [entry for entry in manifest["files"] if frames or not _is_frame(entry["name"])]
    with ThreadPoolExecutor(FETCHES) as pool:
        list(pool.map(bring, wanted))
    for name in ("flights", "incoming", "partial"):
        (store / name).mkdir(exist_ok=True)


def _is_frame(name: str) -> bool:
    parts = name.split("/")
    return len(parts) == 4 and parts[0] == "flights" and parts[3] not in ("series.json", "results.jsonl")


def _solve(lake, definition, flight, wingd, store, folder, jobs) -> str:
    digest = definition["installations"].get(flight.aircraft)
    if digest is None:
        known = ", ".join(sorted(definition["installations"])) or "none"
        raise FleetError(f"solve {definition['solve']} has no installation for {flight.aircraft}, only for: {known}")
    if (now := program.version(wingd)) != definition["program"]:
        raise Passing(f"solve {definition['solve']} is of {definition['program']}, this worker has {now}")
    folder.mkdir()
    files = {}
    for key in lake.keys(f"installations/{digest}"):
        name = key.rsplit("/", 1)[1]
        files[name] = lake.need(key)
        (folder / name).write_bytes(files[name])
    if solves.digest_of(files) != digest:
        raise Passing(f"{lake.url}/installations/{digest}: is not whole; define the solve once more")
    before = program.results(store, flight.flight)
    program.solve(wingd, store, flight.flight, folder, definition["arguments"], jobs)
    after = program.results(store, flight.flight)
    return program.chosen(before, after, files, definition["program"]) if after else None


def _publish(lake: Lake, key: str, data: bytes, facts: dict) -> dict:
    """Creates a table. One that is there, of the same inputs and rows, stays, though another processor may have
    rounded its last digits otherwise; the commit then names that one."""
    if not lake.create(key, data):
        data = lake.need(key)
        there = parquet.facts(data)
        if there != facts:
            raise FleetError(f"{lake.url}/{key}: is there with other rows or inputs; choose another solve's name")
    return {"sha256": sha256(data), "rows": facts["rows"]}
