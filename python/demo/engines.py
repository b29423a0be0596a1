"""Comparison of several engines, each reading the files of the current snapshot by its own code (docs/fleet.md)."""

from __future__ import annotations

import math
import time
from pathlib import Path

from wingd.fleet.desk import files
from wingd.fleet.lake import Lake


def _pandas(files: list[str]):
    import pandas

    frame = pandas.concat(
        pandas.read_parquet(one, columns=["aircraft", "status", "tip_deflection_m"], partitioning=None) for one in files
    )
    frame = frame[frame.status == "ok"]
    return frame.groupby("aircraft").tip_deflection_m.agg(["count", "mean"]).itertuples(name=None)


def _polars(files: list[str]):
    import polars

    frame = (
        polars.scan_parquet(files, hive_partitioning=False).filter(polars.col("status") == "ok").group_by("aircraft")
    )
    mean = frame.agg(
        polars.col("tip_deflection_m").count().alias("n"), polars.col("tip_deflection_m").mean().alias("m")
    )
    return mean.collect().iter_rows()


def _duckdb(files: list[str]):
    import duckdb

    listed = "read_parquet($files, hive_partitioning = false)"
    sql = f"SELECT aircraft, count(tip_deflection_m), avg(tip_deflection_m) FROM {listed} WHERE status = 'ok' GROUP BY aircraft"
    return duckdb.execute(sql, {"files": files}).fetchall()


def _pyarrow(files: list[str]):
    import pyarrow.compute as pc
    import pyarrow.dataset as ds

    content = ds.dataset(files).to_table(["aircraft", "tip_deflection_m"], filter=pc.field("status") == "ok")
    grouped = content.group_by("aircraft").aggregate([("tip_deflection_m", "count"), ("tip_deflection_m", "mean")])
    return [
        tuple(row.values())
        for row in grouped.select(["aircraft", "tip_deflection_m_count", "tip_deflection_m_mean"]).to_pylist()
    ]


ENGINES = {"pandas": _pandas, "polars": _polars, "duckdb": _duckdb, "pyarrow": _pyarrow}


def compare(lake: Lake, solve: str, cache: Path, said=print) -> bool:
    """Print frames and mean deflection by each engine; returns whether they agree for each aircraft."""
    listed = [str(path) for path in files(lake, "shots", [solve], cache)]
    answers = {}
    said(f"{'engine':12} {'version':10} {'aircraft':>8} {'frames':>8} {'mean deflection, m':>13} {'seconds':>8}")
    for name, ask in ENGINES.items():
        begun = time.perf_counter()
        rows = {str(a): (int(n), m) for a, n, m in ask(listed)}
        took = time.perf_counter() - begun
        answers[name] = rows
        frames = sum(n for n, _ in rows.values())
        mean = sum(n * m for n, m in rows.values() if n) / frames if frames else math.nan
        said(f"{name:12} {_version(name):10} {len(rows):8} {frames:8} {mean:13.6f} {took:8.2f}")
    first = answers["duckdb"]
    same = all(_same(first, rows) for rows in answers.values())
    said("all engines agree" if same else "THE ENGINES DISAGREE")
    return same


def _version(name: str) -> str:
    from importlib.metadata import version

    return version(name)


def _same(one: dict, other: dict) -> bool:
    """Compare with a tolerance: sums in another order differ in their last digits."""

    def value(mean):
        return math.nan if mean is None else mean

    return one.keys() == other.keys() and all(
        one[k][0] == other[k][0]
        and (one[k][0] == 0 or math.isclose(value(one[k][1]), value(other[k][1]), rel_tol=1e-9))
        for k in one
    )
