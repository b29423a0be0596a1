"""The same answer from several engines, each reading the Parquet files by its own code."""

from __future__ import annotations

import math
import time
from pathlib import Path

from .lake import VERSION, FleetError, Lake


def _pandas(folder: str, solve: str):
    import pandas

    frame = pandas.read_parquet(
        folder, columns=["aircraft", "status", "tip_lift_m"], partitioning=None, filters=[("solve", "==", solve)]
    )
    frame = frame[frame.status == "ok"]
    return frame.groupby(frame.aircraft.astype(str)).tip_lift_m.agg(["count", "mean"]).itertuples(name=None)


def _polars(folder: str, solve: str):
    import polars

    frame = polars.scan_parquet(
        f"{folder}/**/*.parquet", hive_partitioning=True, missing_columns="insert", extra_columns="ignore"
    )
    frame = frame.filter((polars.col("solve") == solve) & (polars.col("status") == "ok")).group_by("aircraft")
    return (
        frame.agg(polars.col("tip_lift_m").count().alias("n"), polars.col("tip_lift_m").mean().alias("m"))
        .collect()
        .iter_rows()
    )


def _duckdb(folder: str, solve: str):
    import duckdb

    return duckdb.execute(
        f"SELECT aircraft, count(tip_lift_m), avg(tip_lift_m) FROM read_parquet('{folder}/**/*.parquet', "
        "hive_partitioning = true, union_by_name = true) WHERE solve = ? AND status = 'ok' GROUP BY aircraft",
        [solve],
    ).fetchall()


def _datafusion(folder: str, solve: str):
    import datafusion

    context = datafusion.SessionContext()
    context.register_parquet("shots", folder, file_extension=".parquet")
    text = solve.replace("'", "''")
    frame = context.sql(
        f"SELECT aircraft, count(tip_lift_m) AS n, avg(tip_lift_m) AS m FROM shots WHERE solve = '{text}' AND status = 'ok' GROUP BY aircraft"
    )
    return [tuple(row.values()) for row in frame.to_pylist()]


ENGINES = {"pandas": _pandas, "polars": _polars, "duckdb": _duckdb, "datafusion": _datafusion}


def compare(lake: Lake, solve: str, said=print) -> bool:
    """Frames and mean lift of each aircraft by each engine; whether they agree. For a lake that is a directory."""
    if not lake.folder:
        raise FleetError("the engines read a directory; give file:///DIRECTORY, a copy of the lake's tables")
    folder = str(lake.folder / f"tables/{VERSION}/shots")
    if not Path(folder).is_dir():
        raise FleetError(f"{folder}: is not there; run a solve first")
    answers = {}
    said(f"{'engine':12} {'version':10} {'aircraft':>8} {'frames':>8} {'mean lift, m':>13} {'seconds':>8}")
    for name, ask in ENGINES.items():
        begun = time.perf_counter()
        rows = {str(a): (int(n), m) for a, n, m in ask(folder, solve)}
        took = time.perf_counter() - begun
        answers[name] = rows
        frames = sum(n for n, _ in rows.values())
        mean = sum(n * m for n, m in rows.values() if n) / frames if frames else math.nan
        said(f"{name:12} {_version(name):10} {len(rows):8} {frames:8} {mean:13.6f} {took:8.2f}")
    first = answers["duckdb"]
    same = all(_same(first, rows) for rows in answers.values())
    said("all agree" if same else "THEY DO NOT AGREE")
    return same


def _version(name: str) -> str:
    from importlib.metadata import version

    return version(name)


def _same(one: dict, other: dict) -> bool:
    """Sums in another order differ in their last digits."""

    def value(mean):
        return math.nan if mean is None else mean

    return one.keys() == other.keys() and all(
        one[k][0] == other[k][0]
        and (one[k][0] == 0 or math.isclose(value(one[k][1]), value(other[k][1]), rel_tol=1e-9))
        for k in one
    )
