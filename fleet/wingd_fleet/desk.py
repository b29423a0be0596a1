"""Questions to the tables, by DuckDB in this process: no server."""

from __future__ import annotations

import os
import re
from concurrent.futures import ThreadPoolExecutor
from importlib import resources
from pathlib import Path

import duckdb
import obstore

from .lake import TABLES, FleetError, Flight, Lake

# Columns of aircraft data that the results may have: the first one that is there is taken.
WEIGHT = ("weight_kg", "aircraft_weight_kg")
LOAD_FACTOR = ("load_factor", "aircraft_load_factor")
# Objects brought at a time.
FETCHES = 16
# A fresh connection's `frames` reads these of `shots`.
_FRAMES = """
CREATE TABLE frames AS
SELECT solve, aircraft, aircraft_type, recorder_id, flight, series, shot, image, utc, status, reason, camera_failures,
       variance_factor, global_test, sigma_kind, tip_marker, tip_lift_m, tip_sigma_lift_m, program,
       {weight}::DOUBLE AS weight_kg, {factor}::DOUBLE AS load_factor,
       {weight}::DOUBLE * {factor}::DOUBLE / 1000 AS load_t
FROM shots
"""

# File -> the table that it reads, and what it makes.
_ON_DEMAND = {
    "mount.sql": ("parameters", {"rotations", "mount_by_flight", "mount_by_aircraft"}),
    "detection.sql": ("markers", {"marks", "detection", "marker_reasons"}),
}


class Desk:
    """A connection with the tables of the chosen solves (all without a choice) and the views of views.sql."""

    def __init__(self, lake: Lake, solves: list[str] | None = None, cache: Path | None = None):
        self.lake = lake
        committed = lake.committed()
        self.solves = solves or sorted(committed)
        unknown = [solve for solve in self.solves if solve not in committed]
        if unknown or not self.solves:
            known = ", ".join(sorted(committed)) or "none"
            raise FleetError(f"{lake.url}: no tables of {', '.join(unknown) or 'any solve'}; there are: {known}")
        self.flights = {solve: committed[solve] for solve in self.solves}
        self.cache = cache or Path.home() / ".cache" / "wingd-fleet"
        self.connection = duckdb.connect()
        # The bar would stand among the answers.
        self.connection.execute("SET enable_progress_bar = false")
        # Thousands of files: each one's footer is read once.
        self.connection.execute("SET parquet_metadata_cache = true")
        self.made: set[str] = set()
        self._need("shots")
        columns = {row[0] for row in self.connection.sql("DESCRIBE shots").fetchall()}
        weight, factor = (next((c for c in names if c in columns), None) for names in (WEIGHT, LOAD_FACTOR))
        self.connection.execute(_FRAMES.format(weight=weight or "NULL", factor=factor or "NULL"))
        # The columns are there without an aircraft's data too, and empty.
        self.has_load = self.rows("SELECT count(load_t) > 0 AS some FROM frames")[0]["some"]
        self._views("views.sql")

    def _need(self, sql: str) -> None:
        """Makes what a question names and nothing else: opening thousands of files takes seconds."""
        words = set(re.findall(r"\w+", sql)) - self.made
        for file, (table, names) in _ON_DEMAND.items():
            if words & names:
                self._need(table)
                self.made |= names
                self._views(file)
        for table in words & set(TABLES):
            self.made.add(table)
            keys = [flight.table(table, solve) for solve in self.solves for flight in self.flights[solve]]
            listed = ", ".join("'" + str(file).replace("'", "''") + "'" for file in self._local(keys))
            how = "union_by_name = true, hive_partitioning = false"
            self.connection.execute(f"CREATE VIEW {table} AS SELECT * FROM read_parquet([{listed}], {how})")

    def _views(self, file: str) -> None:
        self.connection.execute(resources.files(__package__).joinpath(file).read_text())

    def _local(self, keys: list[str]) -> list[Path]:
        """Files of the keys: in place where the lake is a directory, else brought once, for they never change."""
        if self.lake.folder:
            return [self.lake.folder / key for key in keys]
        place = self.cache / self.lake.url.removeprefix("s3://")

        def bring(key: str) -> Path:
            path = place / key
            if not path.exists():
                path.parent.mkdir(parents=True, exist_ok=True)
                part = path.with_name(f"{path.name}.{os.getpid()}.part")
                part.write_bytes(bytes(obstore.get(self.lake.store, key).bytes()))
                part.rename(path)
            return path

        with ThreadPoolExecutor(FETCHES) as pool:
            return list(pool.map(bring, keys))

    def rows(self, sql: str, parameters: list | None = None) -> list[dict]:
        """A question's answer."""
        self._need(sql)
        result = self.connection.execute(sql, parameters or [])
        names = [column[0] for column in result.description]
        return [dict(zip(names, row)) for row in result.fetchall()]

    def ask(self, sql: str):
        """A question's answer as DuckDB shows it; None where the statement has none."""
        self._need(sql)
        return self.connection.sql(sql)

    def missing(self, solve: str) -> tuple[list[Flight], dict[Flight, list[dict]]]:
        """Published flights without tables of a solve, and what their tasks said."""
        done = set(self.flights[solve])
        return [flight for flight in self.lake.flights() if flight not in done], self.lake.failures(solve)
