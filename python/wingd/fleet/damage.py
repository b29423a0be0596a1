"""Verification of every object against its digest, and repair of damaged or missing objects from intact ones."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from . import records, snapshot, solves, task
from .corrections import Corrections
from .lake import VERSION, Damaged, FleetError, Flight, Lake, flight_of, is_frame, solve_of
from .records import sha256
from .state import State, at_once

UPLOAD = "`wingd upload --repair` from a copy of the store"


@dataclass(frozen=True)
class Fault:
    """A damaged or missing object.

    `kind` is the kind of object: `copy`, `upload`, `commit`, `snapshot`, `failure`, `installation`, `foreign`,
    `lost`.
    """

    kind: str
    key: str
    what: str
    remedy: str

    def __str__(self) -> str:
        return f"{self.key}: {self.what}; {self.remedy}"


def verify(lake: Lake, frames: bool = True) -> list[Fault]:
    """Read the whole lake; `frames` False skips the frames, which a rule of the bucket may have expired."""
    faults = _twice(lake)
    if any(fault.kind == "lost" for fault in faults):
        return faults
    state = State(lake)
    manifests, found = _manifests(lake, state)
    faults += found
    faults += _files(lake, state, manifests, frames)
    faults += _strangers(lake, state)
    faults += _installations(lake)
    faults += _commits(lake, state)
    faults += _snapshots(lake)
    for key in lake.keys("failures"):
        faults += _sealed(lake, key, "failure", "`wingd-fleet repair` removes it")
    return sorted(faults, key=lambda fault: fault.key)


def _sealed(lake: Lake, key: str, kind: str, remedy: str) -> list[Fault]:
    data = lake.get(key)
    if data is None:
        return [Fault(kind, key, "is missing", remedy)]
    try:
        records.load(key, data)
        return []
    except Damaged:
        return [Fault(kind, key, "is damaged: its seal does not match", remedy)]


def _twice(lake: Lake) -> list[Fault]:
    """Verify corrections and definitions, each of which has a copy."""
    faults = []
    for prefix in ("corrections", "solves"):
        for key in records.names_twice(lake, prefix):
            own = [
                _sealed(lake, place, "copy", "`wingd-fleet repair` restores it from its copy")
                for place in (key, records.twin(key))
            ]
            if all(own):
                faults.append(
                    Fault(
                        "lost", key, "is damaged or missing, and its copy too", "restore it from a backup of the bucket"
                    )
                )
            else:
                faults += [fault for found in own for fault in found]
    try:
        Corrections.read(lake)
    except Damaged as damage:
        known = {f"{lake.url}/{fault.key}" for fault in faults}
        gone = [text for text in damage.faults if text.split(": ")[0] not in known]
        faults += [
            Fault("lost", text.split(": ")[0], "is missing", "restore it from a backup of the bucket") for text in gone
        ]
    return faults


def _manifests(lake: Lake, state: State) -> tuple[dict[Flight, dict], list[Fault]]:
    whole, faults = {}, []
    kept = {solve: solves.read(lake, solve)["installations"] == solves.KEPT for solve in state.solves}
    # Whatever was solved must have been uploaded.
    needed: dict[Flight, set[str]] = {}
    for solve, flight in state.commits:
        needed.setdefault(flight, set()).update({"results"} if kept[solve] else {"results", "frames"})
    for flight in sorted({*state.flights, *needed}):
        for mark in sorted({"manifest", *state.marks.get(flight, set()), *needed.get(flight, set())}):
            faults += _sealed(lake, flight.mark(mark), "upload", UPLOAD)
        if not any(fault.key == flight.manifest for fault in faults):
            whole[flight] = records.read(lake, flight.manifest)
    return whole, faults


def _check_digests(lake: Lake, wanted: list[tuple[str, str]], kind: str, remedy: str) -> list[Fault]:
    """Compare objects with the digests that other objects state for them."""

    def check(item: tuple[str, str]) -> Fault | None:
        data = lake.get(item[0])
        if data is None:
            return Fault(kind, item[0], "is missing", remedy)
        return None if sha256(data) == item[1] else Fault(kind, item[0], "is damaged", remedy)

    return [fault for fault in at_once(check, wanted) if fault]


def _files(lake: Lake, state: State, manifests: dict[Flight, dict], frames: bool) -> list[Fault]:
    """Verify the uploaded files of each flight and finds foreign files among them."""
    wanted, known = [], set()
    for flight, manifest in manifests.items():
        for entry in manifest["files"]:
            stage = "frames" if is_frame(entry["name"]) else "results"
            objects = [(key, digest) for key, digest, _ in task.keys_of(flight, entry)]
            known.update(key for key, _ in objects)
            if stage in state.marks[flight] and (frames or stage == "results"):
                wanted += objects
    there = [key for place in ("flights", "frames") for key in lake.keys(place)]
    foreign = [key for key in there if key not in known and flight_of(key) in manifests]
    remedy = "move it away"
    return [Fault("foreign", key, "does not belong to its flight", remedy) for key in foreign] + _check_digests(
        lake, wanted, "upload", UPLOAD
    )


def _strangers(lake: Lake, state: State) -> list[Fault]:
    """Find flights with files but without a manifest."""
    known = {*state.flights, *(flight for _, flight in state.commits)}
    there = {flight_of(key) for place in ("flights", "frames") for key in lake.keys(place)}
    lost = {flight for flight in there if flight and flight not in known}
    return [
        Fault("upload", flight.manifest, "is missing, but files of the flight exist", UPLOAD) for flight in sorted(lost)
    ]


def _installations(lake: Lake) -> list[Fault]:
    faults = []
    for name in solves.names(lake):
        rules = solves.read(lake, name)["installations"]
        for digest in sorted({rule["digest"] for rule in rules}) if rules != solves.KEPT else []:
            try:
                solves.installation(lake, digest)
            except Damaged:
                remedy = f"run `wingd-fleet define --solve {name}` again with the same folders"
                faults.append(Fault("installation", f"installations/{digest}", "is incomplete", remedy))
    return faults


def _commits(lake: Lake, state: State) -> list[Fault]:
    again = "`wingd-fleet repair` recreates it"
    keys = sorted(state.commits.values())
    broken = [fault for found in at_once(lambda key: _sealed(lake, key, "commit", again), keys) for fault in found]
    whole = [key for key in keys if key not in {fault.key for fault in broken}]
    tables = [t for record in at_once(lambda key: records.read(lake, key), whole) for t in record["tables"].values()]
    faults = broken + _check_digests(lake, [(table["key"], table["sha256"]) for table in tables], "commit", again)
    # Tables that their commit does not name were left by a killed task; tables without any commit lost it or wait for it.
    without = {(solve_of(key), flight_of(key)) for key in lake.keys(f"tables/{VERSION}")} - set(state.commits)
    for solve, flight in sorted(without):
        faults.append(Fault("commit", flight.commit(solve, 1), "is missing, or its task was interrupted", again))
    return faults


def _snapshots(lake: Lake) -> list[Fault]:
    faults = []
    remedy = "`wingd-fleet repair` recreates it"
    for id in snapshot.ids(lake):
        found = _sealed(lake, snapshot.manifest(id), "snapshot", remedy)
        faults += found
        if not found:
            files = [f for by in snapshot.Snapshot.read(lake, id).files.values() for fs in by.values() for f in fs]
            faults += _check_digests(lake, [(file["key"], file["sha256"]) for file in files], "snapshot", remedy)
    return faults


def repair(
    lake: Lake, faults: list[Fault], wingd: str, work: Path, said: Callable[[str], None] = lambda text: None
) -> list[Fault]:
    """Recreates what it can; returns the faults that need another remedy."""
    left = [fault for fault in faults if fault.kind in ("upload", "installation", "lost", "foreign")]
    for fault in faults:
        if fault.kind == "copy":
            _from_twin(lake, fault.key)
            said(f"{fault.key}: restored from its copy")
        elif fault.kind == "failure":
            lake.delete([fault.key])
            said(f"{fault.key}: removed; the task records it again")
    for solve, flight in sorted({(solve_of(f.key), flight_of(f.key)) for f in faults if f.kind == "commit"}):
        try:
            said(f"{flight} in {solve}: {remake(lake, solve, flight, wingd, work)}")
        except FleetError as error:
            left.append(Fault("commit", f"{flight} in {solve}", str(error), "or withdraw the flight"))
    if broken := sorted({fault.key.split("/")[2] for fault in faults if fault.kind == "snapshot"}):
        now = snapshot.id_of(State(lake))
        snapshot.remove(lake, broken)
        said(f"snapshots {', '.join(broken)}: removed")
        if now in broken and not any(fault.kind == "commit" for fault in left):
            said(f"snapshots {snapshot.make(lake, work)}: recreated")
    return left


def _from_twin(lake: Lake, key: str) -> None:
    own = key.removeprefix("copies/")
    other = own if key.startswith("copies/") else records.twin(own)
    lake.settle(key, lake.need(other))


def remake(lake: Lake, solve: str, flight: Flight, wingd: str, work: Path) -> str:
    """Recreates a flight's tables and commit. If the bytes are the same, the commit stays; otherwise the next number is used."""
    there = task.commits(lake, solve, flight)
    if not there:
        return f"run again: {task.run(lake, solve, flight, wingd, work)}"
    with task.Folder(work) as folder:
        record = task.make(lake, solve, flight, records.read(lake, flight.manifest), wingd, folder, 1)
    data, last = records.dump(record), there[-1]
    before = lake.get(last)
    if before == data:
        return "recreated, identical bytes"
    try:
        records.load(last, before or b"")
    except Damaged:
        lake.settle(last, data)
        return "commit and tables recreated"
    number = int(last.rsplit("/", 1)[1].removesuffix(".json")) + 1
    lake.create(flight.commit(solve, number), data)
    return f"recreated as commit {number}: last digits or the state of the record differ"
