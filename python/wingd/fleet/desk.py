"""Queries of the tables by DuckDB in this process, without a server."""

from __future__ import annotations

import csv
import re
from contextlib import contextmanager, suppress
from functools import partial
from importlib import resources
from pathlib import Path

import duckdb
import pyarrow as pa

from . import parquet, snapshot
from .corrections import ATTRIBUTES
from .lake import Damaged, FleetError, Flight, Lake
from .state import Published, State, at_once, chosen, clean, part_of

# Memory limit of DuckDB, MB; it writes the rest to disk.
MEMORY_MB = 400
# Rows written at once.
FETCHED = 10_000
# Columns of `shots` in the table `frames`.
_FRAMES = """
CREATE TABLE frames AS
SELECT solve, aircraft, aircraft_type, wing, recorder_id, flight, series, shot, image, utc, status, reason, camera_failures,
       variance_factor, global_test, sigma_kind, tip_marker, tip_deflection_m, tip_sigma_deflection_m, program,
       weight_kg, load_factor, mach, weight_kg * load_factor / 1000 AS load_t
FROM shots
"""
# File -> the table that it reads, and the views that it creates.
_ON_DEMAND = {
    "shape.sql": ("shape", {"shapes", "shape_by_flight", "shape_by_wing", "line_of_type", "aircraft_against_type"}),
    "span.sql": ("span", {"shape_by_series"}),
    "mount.sql": ("parameters", {"rotations", "mount_by_flight", "mount_by_aircraft"}),
    "detection.sql": ("markers", {"marks", "detection", "marker_reasons"}),
    "live.sql": ("live", {"live_by_flight"}),
}


class Desk:
    """A connection with the tables of the chosen solves (default: all) and the views of views.sql."""

    def __init__(self, lake: Lake, solves: list[str] | None = None, cache: Path | None = None):
        self.lake = lake
        self.cache = cache or Path.home() / ".cache" / "wingd-fleet"
        clean(self.cache)
        self.state = State(lake, self.cache)
        self.solves = chosen(self.state, solves)
        self.snapshot = snapshot.newest(lake)
        self.published = self.state.published(self.solves, snapshot.covered(self.snapshot, self.state))
        self.connection = duckdb.connect()
        # A progress bar would be mixed with the output.
        self.connection.execute("SET enable_progress_bar = false")
        # Days are UTC in every time zone.
        self.connection.execute("SET TimeZone = 'UTC'")
        self.connection.execute(f"SET memory_limit = '{MEMORY_MB}MB'")
        self.connection.execute("SET preserve_insertion_order = false")
        self.made: set[str] = set()
        self._place_published()
        self._need("shots")
        self.connection.execute(_FRAMES)
        # Without aircraft data the columns exist but are empty.
        self.has_load = self.rows("SELECT count(load_t) > 0 AS some FROM frames")[0]["some"]
        self._views("views.sql")

    def _place_published(self) -> None:
        """Create the table of published flights: current aircraft and wing, and whether the snapshot contains them."""
        inside = set(self.snapshot.commits) if self.snapshot else set()
        names = ("solve", "recorder_id", "flight", *ATTRIBUTES, "inside")
        rows = [
            (
                one.solve,
                one.flight.recorder,
                one.flight.flight,
                *(getattr(one.about, name) for name in ATTRIBUTES),
                one.commit in inside,
            )
            for one in self.published
        ]
        types = [pa.string()] * 6 + [pa.bool_()]
        arrays = [pa.array([row[k] for row in rows], kind) for k, kind in enumerate(types)]
        self.connection.register("published_now", pa.table(arrays, names=list(names)))
        self.connection.execute("CREATE TABLE published AS FROM published_now")
        self.connection.unregister("published_now")

    def _need(self, sql: str) -> None:
        """Create only the views that a query names, because opening thousands of files takes seconds."""
        words = set(re.findall(r"\w+", sql)) - self.made
        for file, (table, names) in _ON_DEMAND.items():
            if words & names:
                self._need(table)
                self.made |= names
                self._views(file)
        for table in words & set(parquet.TABLES):
            self.made.add(table)
            self.connection.execute(f"CREATE VIEW {table} AS {' UNION ALL BY NAME '.join(self._parts(table))}")

    def _parts(self, table: str) -> list[str]:
        """Return selections that yield each row of each published flight once."""
        inside = set(self.snapshot.commits) if self.snapshot else set()
        about = ", ".join(ATTRIBUTES)
        parts = [_empty(table)]
        if self.snapshot:
            files = [file for solve in self.solves for file in self.snapshot.files.get(table, {}).get(solve, [])]
            for listed in self._grouped(table, [(f["key"], f["sha256"], f["columns"]) for f in files]):
                old = f"SELECT * EXCLUDE ({about}) FROM read_parquet([{listed}], hive_partitioning = false)"
                parts.append(f"SELECT {_prefixed(about)}, t.* FROM ({old}) t {_JOIN} AND p.inside")
        own = [one.tables[table] for one in self.published if one.commit not in inside and table in one.tables]
        for listed in self._grouped(table, [(one.key, one.sha256, one.columns) for one in own]):
            old = f"FROM read_parquet([{listed}], hive_partitioning = false)"
            parts.append(f"SELECT {_prefixed(about)}, t.* FROM ({old}) t {_JOIN} AND NOT p.inside")
        return parts

    def _grouped(self, table: str, objects: list[tuple[str, str, str]]) -> list[str]:
        """Return local files of objects, digests verified, grouped by their columns."""
        paths, faults = [], []
        for object, path in zip(objects, at_once(partial(self.local, self.lake, self.cache), objects), strict=False):
            if isinstance(path, str):
                faults.append(path)
            else:
                paths.append((object[2], path))
        if faults:
            number = f"{len(faults)} of {len(objects)} files are missing or damaged, first {faults[0]}"
            raise Damaged([f"table {table}: {number}"])
        groups: dict[str, list[str]] = {}
        for columns, path in paths:
            groups.setdefault(columns, []).append("'" + str(path).replace("'", "''") + "'")
        return [", ".join(files) for files in groups.values()]

    @staticmethod
    def local(lake: Lake, cache: Path, object: tuple[str, str, str]) -> Path | str:
        """Return a file with an object's bytes, or an error text: in place if the lake is a directory, else downloaded once."""
        key, digest, _ = object
        path = lake.folder / key if lake.folder else cache / "objects" / f"{digest}.parquet"
        found = snapshot.digest_of(path)
        if found == digest:
            return path
        if not lake.folder:
            with suppress(_Wrong), part_of(path) as part:
                found = lake.download(key, part)
                if found != digest:
                    raise _Wrong
                return path
        return f"{lake.url}/{key}: {'is missing' if found is None else 'is damaged: its digest does not match'}"

    def _views(self, file: str) -> None:
        self.connection.execute(resources.files(__package__).joinpath(file).read_text())

    def rows(self, sql: str, parameters: list | None = None) -> list[dict]:
        """Return the rows of a query."""
        with _said():
            self._need(sql)
            result = self.connection.execute(sql, parameters or [])
        names = [column[0] for column in result.description]
        return [dict(zip(names, row, strict=False)) for row in result.fetchall()]

    def show(self, sql: str) -> None:
        """Print the result of a query as a table; nothing if the statement has no result."""
        with _said():
            self._need(sql)
            answer = self.connection.sql(sql)
            if answer is not None:
                answer.show(max_width=200, max_rows=10_000)

    def write_csv(self, sql: str, output) -> None:
        """Write all rows of a query as CSV."""
        writer = csv.writer(output, lineterminator="\n")
        with _said():
            self._need(sql)
            answer = self.connection.execute(sql)
            writer.writerow([column[0] for column in answer.description])
            while rows := answer.fetchmany(FETCHED):
                writer.writerows(rows)

    def incomplete(self) -> list[str]:
        """Return sentences about flights that the result lacks."""
        said = []
        for solve in self.solves:
            if missing := self.state.missing(solve):
                named = ", ".join(map(str, missing[:3])) + (" …" if len(missing) > 3 else "")
                said.append(
                    f"solve {solve}: no tables yet of {len(missing)} flights: {named}; `wingd-fleet run` creates them"
                )
        said += [sentence for solve in self.solves for sentence in self.shapes_apart(solve)]
        coming = [flight for flight in self.state.flights if self.state.arrived(flight) != "whole"]
        if coming:
            said.append(f"{len(coming)} flights are not completely uploaded; `wingd-fleet flights` shows their state")
        return said

    def shapes_apart(self, solve: str) -> list[str]:
        """Return sentences about shapes of a solve that are absent, or not compared because the lengths of their wings differ."""
        said, own = [], self.flights(solve)
        lacking = [str(one.flight) for one in own if parquet.SHAPE not in one.tables]
        if lacking:
            named = ", ".join(lacking[:3]) + (" …" if len(lacking) > 3 else "")
            said.append(
                f"solve {solve}: {len(lacking)} flights have no shapes, and no view of shapes has them: {named}"
            )
        sql = (
            "SELECT aircraft_type, side, list(DISTINCT arc_length_m ORDER BY arc_length_m) AS lengths FROM shapes "
            "WHERE solve = ? AND eta = 1 GROUP BY ALL HAVING count(DISTINCT arc_length_m) > 1 ORDER BY ALL"
        )
        for row in self.rows(sql, [solve]) if len(lacking) < len(own) else []:
            lengths = ", ".join(f"{length:.3f} m" for length in row["lengths"][:5])
            said.append(
                f"solve {solve}: the models of {row['aircraft_type']} {row['side']} have the lengths {lengths}, so their "
                "shapes are not compared; define a solve with --length"
            )
        return said

    def withdrawn(self) -> list[tuple[Flight, str, dict]]:
        """Return the withdrawn flights of the chosen solves, with their withdrawals."""
        found = []
        for solve in self.solves:
            for flight in self.state.flights if self.state.corrections.records else []:
                if record := self.state.withdrawn(flight, solve if (solve, flight) in self.state.commits else None):
                    found.append((flight, solve, record))
        return found

    def flights(self, solve: str) -> list[Published]:
        """Return the published flights of a solve."""
        return [one for one in self.published if one.solve == solve]


def files(lake: Lake, table: str, solves: list[str] | None, cache: Path) -> list[Path]:
    """Return local files with all published rows of a table, digests verified. Files of a directory are used in place."""
    now = snapshot.current(State(lake))
    if now is None:
        raise FleetError(f"{lake.url}: there is no snapshot of the current state; write one with `wingd-fleet compact`")
    listed = now.files.get(table, {})
    wanted = [file for solve in (solves or sorted(listed)) for file in listed.get(solve, [])]
    found = [Desk.local(lake, cache, (file["key"], file["sha256"], file["columns"])) for file in wanted]
    if faults := [one for one in found if isinstance(one, str)]:
        raise Damaged(faults)
    return found


class _Wrong(Exception):
    """The downloaded bytes do not match their digest."""


@contextmanager
def _said():
    """Report an error in a query in one line."""
    try:
        yield
    except duckdb.Error as error:
        raise FleetError(f"query: {' '.join(str(error).split())[:600]}") from None


_JOIN = "JOIN published p ON t.solve = p.solve AND t.recorder_id = p.recorder_id AND t.flight = p.flight"
_KINDS = {
    "string": "VARCHAR",
    "int64": "BIGINT",
    "double": "DOUBLE",
    "float": "FLOAT",
    "bool": "BOOLEAN",
    "list<element: float>": "FLOAT[]",
}


def _prefixed(about: str) -> str:
    return ", ".join(f"p.{name.strip()}" for name in about.split(","))


def _empty(table: str) -> str:
    """Return an empty table with the columns of this version, so that a query may name them although no flight has any."""
    kinds = dict.fromkeys(ATTRIBUTES, "VARCHAR")
    kinds |= {name: _KINDS.get(kind, "TIMESTAMPTZ") for name, kind in parquet.schema(table).items()}
    return f"SELECT {', '.join(f'NULL::{kind} AS {name}' for name, kind in kinds.items())} WHERE false"
