"""Published state of a lake: commits that no correction has withdrawn. Every query starts from it."""

from __future__ import annotations

import os
import tempfile
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path

from . import records, solves
from .corrections import About, Corrections
from .lake import VERSION, Damaged, FleetError, Flight, Lake, flight_of, solve_of

# Number of concurrent requests.
AT_ONCE = 16
DAY_S = 86_400


@dataclass(frozen=True)
class Table:
    """An object with a flight's rows of a table."""

    key: str
    sha256: str
    rows: int
    columns: str


@dataclass(frozen=True)
class Published:
    """A flight's tables of a solve, with its current aircraft and wing."""

    solve: str
    flight: Flight
    about: About
    tables: dict[str, Table] = field(hash=False)
    commit: str

    @classmethod
    def of(cls, record: dict, about: About, commit: str) -> Published:
        """Make it of a commit and the current aircraft."""
        tables = {name: Table(**table) for name, table in record["tables"].items()}
        return cls(record["solve"], Flight(record["recorder"], record["flight"]), about, tables, commit)


def at_once(work, items: list) -> list:
    """Do work for all items concurrently; return the results in order."""
    with ThreadPoolExecutor(AT_ONCE) as pool:
        return list(pool.map(work, items))


class State:
    """State of the lake, read once."""

    def __init__(self, lake: Lake, cache: Path | None = None):
        self.lake = lake
        self.cache = cache
        self.corrections = Corrections.read(lake)
        self.marks = _marks(lake)
        keys = lake.keys(f"commits/{VERSION}")
        # Includes superseded commits, so the number only grows.
        self.commit_count = len(keys)
        self.commits = _last(keys)
        self._read: dict[str, dict] = {}

    @property
    def flights(self) -> list[Flight]:
        """All flights, including withdrawn ones."""
        return sorted(self.marks)

    @property
    def solves(self) -> list[str]:
        """Names of the solves that have tables."""
        return sorted({solve for solve, _ in self.commits})

    def manifest(self, flight: Flight) -> dict:
        """Return the manifest of a flight."""
        return self._record(flight.manifest)

    def about(self, flight: Flight) -> About:
        """Return the current aircraft, type and wing of a flight."""
        return self.corrections.about(flight, About.of(self.manifest(flight)))

    def arrived(self, flight: Flight) -> str:
        """Return the upload state of a flight: `announced`, `results`, `whole`."""
        marks = self.marks.get(flight, set())
        return "whole" if "frames" in marks else "results" if "results" in marks else "announced"

    def withdrawn(self, flight: Flight, solve: str | None = None) -> dict | None:
        """Return the withdrawal of a flight in a solve (None: in all solves), or None."""
        key = self.commits.get((solve, flight)) if solve else None
        first = About.of(self._record(key) if key else self.manifest(flight))
        return self.corrections.withdrawn(solve, flight, first)

    def missing(self, solve: str) -> list[Flight]:
        """Return flights uploaded as far as a solve needs, without its tables and not withdrawn."""
        kept = solves.read(self.lake, solve)["installations"] == solves.KEPT
        if self.corrections.records:
            self.read_manifests()
        stage = "results" if kept else "frames"
        return [
            flight
            for flight in self.flights
            if stage in self.marks[flight]
            and (solve, flight) not in self.commits
            and not self.corrections.withdrawn(solve, flight, self._first(flight))
        ]

    def read_manifests(self) -> None:
        """Read all manifests concurrently: one by one, thousands in a bucket take a minute."""
        for found in at_once(self._read_or_fault, [flight.manifest for flight in self.flights]):
            if isinstance(found, Damaged):
                raise found

    def _first(self, flight: Flight) -> About:
        # Without corrections the aircraft is not needed.
        return About.of(self.manifest(flight)) if self.corrections.records else About("", None, None, "")

    def published(self, wanted: list[str] | None = None, known: dict[str, dict] | None = None) -> list[Published]:
        """Return the published flights of solves (None: all), sorted by aircraft, day, wing, recorder and flight.

        If the wing is not given, each recorder counts as a wing of its own.

        `known`: commits by key that need not be read again.
        """
        self._read.update(known or {})
        keys = [key for (solve, _), key in sorted(self.commits.items()) if wanted is None or solve in wanted]
        definitions = {solve: solves.read(self.lake, solve)["seal"] for solve in wanted or self.solves}
        found, faults = [], []
        for key, record in zip(keys, at_once(self._read_or_fault, keys), strict=False):
            if isinstance(record, Damaged):
                faults += record.faults
            elif record["definition"] != definitions[record["solve"]]:
                faults.append(f"{self.lake.url}/{key}: belongs to another definition of solve {record['solve']}")
            else:
                first, flight = About.of(record), flight_of(key)
                if not self.corrections.withdrawn(record["solve"], flight, first):
                    about = self.corrections.about(flight, first)
                    wing = about.wing or f"recorder-{flight.recorder[:8]}"
                    found.append(Published.of(record, replace(about, wing=wing), key))
        if faults:
            raise Damaged(faults)
        return sorted(found, key=order)

    def _read_or_fault(self, key: str) -> dict | Damaged:
        try:
            return self._record(key)
        except Damaged as damage:
            return damage

    def _record(self, key: str) -> dict:
        """Read a record; records of a bucket are cached, because records do not change."""
        if key in self._read:
            return self._read[key]
        place = self.cache / self.lake.url.removeprefix("s3://") / key if self.cache and not self.lake.folder else None
        if place and place.exists():
            try:
                self._read[key] = records.load(str(place), place.read_bytes())
                return self._read[key]
            except Damaged:
                place.unlink(missing_ok=True)
        data = self.lake.need(key)
        self._read[key] = records.load(f"{self.lake.url}/{key}", data)
        if place:
            with part_of(place) as part:
                part.write_bytes(data)
        return self._read[key]

    def record(self, key: str) -> dict:
        """Return a record, read once."""
        return self._record(key)

    def failures(self, solve: str) -> dict[Flight, list[str]]:
        """Return the reasons of failed tasks, for flights without tables."""
        found: dict[Flight, list[str]] = {}
        for key in self.lake.keys(f"failures/{VERSION}/solve={solve}"):
            flight = flight_of(key)
            if flight and (solve, flight) not in self.commits:
                try:
                    found.setdefault(flight, []).append(records.read(self.lake, key)["reason"])
                except Damaged:
                    found.setdefault(flight, []).append("the record of the reason is damaged")
        return found


@contextmanager
def part_of(path: Path) -> Iterator[Path]:
    """Yield a temporary file that replaces a cache file in one step; it is removed if writing fails."""
    path.parent.mkdir(parents=True, exist_ok=True)
    handle, part = tempfile.mkstemp(suffix=".part", dir=path.parent)
    os.close(handle)
    try:
        yield Path(part)
        os.rename(part, path)
    except BaseException:
        Path(part).unlink(missing_ok=True)
        raise


def clean(cache: Path) -> None:
    """Remove partial files that killed calls left more than a day ago."""
    for half in cache.rglob("*.part"):
        try:
            if time.time() - half.stat().st_mtime > DAY_S:
                half.unlink()
        except FileNotFoundError:
            continue


def order(one: Published) -> tuple:
    """Return the key by which published flights are sorted."""
    return (one.solve, one.about.aircraft, one.about.started[:10], one.about.wing or "", one.flight)


def _marks(lake: Lake) -> dict[Flight, set[str]]:
    found: dict[Flight, set[str]] = {}
    for key in lake.keys("manifests"):
        if flight := flight_of(key):
            found.setdefault(flight, set()).add(key.rsplit("/", 1)[1].removesuffix(".json"))
    return found


def _last(keys: list[str]) -> dict[tuple[str, Flight], str]:
    """Return the last commit of each flight and solve; keys are sorted, the highest number last."""
    found = {}
    for key in keys:
        flight, solve = flight_of(key), solve_of(key)
        if flight and solve:
            found[solve, flight] = key
    return found


def chosen(state: State, wanted: list[str] | None) -> list[str]:
    """Return the requested solves, each of which must have tables."""
    names = wanted or state.solves
    unknown = [name for name in names if name not in state.solves]
    if unknown or not names:
        known = ", ".join(state.solves) or "none"
        raise FleetError(f"{state.lake.url}: no tables of {', '.join(unknown) or 'any solve'}; available: {known}")
    return names
