"""One flight, one task: fetch, solve, export, publish. Repeated or interrupted tasks give the same tables.

A task changes nothing outside its own folder until it publishes; tables are named by their digest; the commit is written last
and only if none exists, and readers use commits alone. Therefore any queue works that calls a task often enough.
"""

from __future__ import annotations

import fcntl
import os
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path, PurePosixPath

import pyarrow as pa

from . import parquet, program, records, shapes, solves
from .corrections import About, Corrections
from .lake import VERSION, Damaged, FleetError, Flight, Lake, Passing, is_frame
from .records import sha256
from .state import at_once

# Part size of long files, as in `wingd upload`.
PART_BYTES = 4 << 20


def run(lake: Lake, solve: str, flight: Flight, wingd: str, work: Path, jobs: int = 1) -> str:
    """Publish the tables of a flight. Returns `there` if they existed, `done` if this task created them, or `withdrawn`.

    `work` is a folder for frames and tables, emptied at the end.
    """
    if commits(lake, solve, flight):
        return "there"
    manifest = records.read(lake, flight.manifest)
    if Corrections.read(lake).withdrawn(solve, flight, About.of(manifest)):
        return "withdrawn"
    with Folder(work) as folder:
        try:
            record = make(lake, solve, flight, manifest, wingd, folder, jobs)
        except (Passing, Damaged):
            raise
        except FleetError as error:
            reason = str(error).replace(str(folder), "")
            data = records.dump({"flight": str(flight), "solve": solve, "reason": reason})
            lake.create(flight.failure(solve, sha256(data)), data)
            raise FleetError(f"{flight}: {reason}") from error
    return "done" if lake.create(flight.commit(solve, 1), records.dump(record)) else "there"


def commits(lake: Lake, solve: str, flight: Flight) -> list[str]:
    """Return the keys of a flight's commits; the last one is valid."""
    return lake.keys(f"commits/{VERSION}/solve={solve}/{flight.place}")


def make(lake: Lake, solve: str, flight: Flight, manifest: dict, wingd: str, folder: Path, jobs: int) -> dict:
    """Write a flight's tables into the lake; returns the content of its commit."""
    definition = solves.read(lake, solve)
    kept = definition["installations"] == solves.KEPT
    store = folder / "store"
    needs(lake, flight, "results" if kept else "frames")
    fetch(lake, flight, manifest, store, frames=not kept)
    inputs = None
    if not kept:
        inputs = _solve(lake, definition, flight, manifest, wingd, store, folder / "installation", jobs)
    tables = {}
    length = shapes.length_of(definition, manifest["aircraft_type"])
    for name, data in _tables(wingd, store, flight, solve, inputs, kept, length):
        digest = sha256(data)
        key = flight.table(name, solve, digest)
        lake.settle(key, data)
        tables[name] = {"key": key, "sha256": digest, **parquet.facts(data)}
    about = {name: manifest[name] for name in (*parquet.ABOUT, "started")}
    return {
        "solve": solve,
        "definition": definition["seal"],
        "recorder": flight.recorder,
        "flight": flight.flight,
        "manifest": manifest["seal"],
        "tables": tables,
        **about,
    }


def needs(lake: Lake, flight: Flight, stage: str) -> None:
    """Raise Passing if a stage of a flight has not arrived."""
    if lake.get(flight.mark(stage)) is None:
        raise Passing(f"{flight}: its {stage} have not arrived yet; try again after `wingd upload` has finished")


def _tables(
    wingd: str, store: Path, flight: Flight, solve: str, inputs: str | None, kept: bool, length: float | None
) -> Iterator[tuple[str, bytes]]:
    """Yield tables with rows. Live results are not solved again: they belong to the uploaded results."""
    found = {name: program.export(wingd, store, flight.flight, name, inputs) for name in parquet.EXPORTED}
    for name, content in found.items():
        whole = content if name == "shots" else parquet.weighed(content, found["shots"], name)
        if len(whole):
            yield name, parquet.write(parquet.completed(whole, name, solve))
    if content := _shape(wingd, store, flight, inputs, length, found, kept):
        yield parquet.SHAPE, parquet.write(parquet.completed(content, parquet.SHAPE, solve))
    if kept and any(store.glob(f"flights/{flight.flight}/live-*")):
        for name, path in parquet.live(program.export_file(wingd, store, flight.flight, "live"), solve).items():
            yield name, path.read_bytes()


def _shape(
    wingd: str,
    store: Path,
    flight: Flight,
    inputs: str | None,
    length: float | None,
    found: dict[str, pa.Table],
    kept: bool,
) -> pa.Table | None:
    """Return the table `shape`; None if no frame has one: frames that failed, or the method profile."""
    shots = found["shots"]
    solved = set(zip(shots["status"].to_pylist(), shots["method"].to_pylist(), strict=True))
    if kept:
        content = shapes.rows_of_span(found["span"], length)
    elif ("ok", "spatial") in solved:
        export = program.export_shape(wingd, store, flight.flight, shapes.EXPORTED_ETA, inputs)
        content = shapes.rows(export, length)
    else:
        return None
    return parquet.weighed(shapes.with_identity(content, shots), shots, parquet.SHAPE) if len(content) else None


def keys_of(flight: Flight, entry: dict) -> list[tuple[str, str, int]]:
    """Return the objects of a file: key, SHA-256, size in bytes."""
    key, length = flight.file(entry["name"]), entry["length"]
    if not entry.get("parts"):
        return [(key, entry["sha256"], length)]
    sizes = [min(PART_BYTES, length - k * PART_BYTES) for k in range(len(entry["parts"]))]
    return [(f"{key}.part-{k:04d}", digest, sizes[k]) for k, digest in enumerate(entry["parts"])]


def fetch(lake: Lake, flight: Flight, manifest: dict, store: Path, frames: bool = True) -> None:
    """Download a flight as a store and verifies each file against the manifest; `frames` False skips the frames."""
    faults: list[str] = []

    def bring(entry: dict) -> None:
        name = PurePosixPath(entry["name"])
        if name.is_absolute() or ".." in name.parts:
            raise FleetError(f"{flight.manifest}: names {entry['name']!r}, which is outside the flight")
        path = store / name
        path.parent.mkdir(parents=True, exist_ok=True)
        with path.open("wb") as file:
            for key, digest, _ in keys_of(flight, entry):
                data = lake.get(key)
                if data is None or sha256(data) != digest:
                    what = "is missing" if data is None else "is damaged"
                    faults.append(
                        f"{lake.url}/{key}: {what}; repair it by `wingd upload --repair` from a copy of the store"
                    )
                    return
                file.write(data)

    at_once(bring, [entry for entry in manifest["files"] if frames or not is_frame(entry["name"])])
    if faults:
        raise Damaged(sorted(faults))
    for name in ("flights", "incoming", "partial"):
        (store / name).mkdir(exist_ok=True)


def _solve(lake, definition, flight, manifest, wingd, store, folder, jobs) -> str | None:
    digest = solves.choose(definition, flight, manifest["started"])
    if (now := program.version(wingd)) != definition["program"]:
        raise Passing(f"solve {definition['solve']} is of {definition['program']}, but this worker has {now}")
    files = solves.installation(lake, digest)
    folder.mkdir()
    for name, data in files.items():
        (folder / name).write_bytes(data)
    before = program.results(store, flight.flight)
    program.solve(wingd, store, flight.flight, folder, definition["arguments"], jobs)
    after = program.results(store, flight.flight)
    return program.chosen(before, after, files, definition["program"]) if after else None


class Folder:
    """A task's own folder, removed at its end; folders of killed tasks are removed by the next task.

    A lock file next to the folder shows that its task is running. It is ours once it is locked and still exists: before, another
    task may have mistaken it for that of a dead task and removed it.
    """

    def __init__(self, work: Path):
        self.work = work

    def __enter__(self) -> Path:
        while True:
            self.work.mkdir(parents=True, exist_ok=True)
            sweep(self.work)
            try:
                handle, name = tempfile.mkstemp(prefix="task-", suffix=".lock", dir=self.work)
            except FileNotFoundError:
                # Another task removed the empty folder at its end.
                continue
            fcntl.flock(handle, fcntl.LOCK_EX)
            if os.path.exists(name):
                break
            os.close(handle)
        self.handle, self.lock = handle, Path(name)
        self.folder = self.lock.with_suffix("")
        self.folder.mkdir()
        return self.folder

    def __exit__(self, *_) -> None:
        shutil.rmtree(self.folder, ignore_errors=True)
        self.lock.unlink(missing_ok=True)
        os.close(self.handle)
        with suppress(OSError):
            self.work.rmdir()


def sweep(work: Path) -> None:
    """Remove folders of dead tasks, whose lock is free."""
    for lock in work.glob("task-*.lock"):
        with suppress(OSError), lock.open() as file:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            shutil.rmtree(lock.with_suffix(""), ignore_errors=True)
            lock.unlink()
