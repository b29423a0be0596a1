#!/usr/bin/env python3
"""Reads every export of a store back with the readers of the field.

    pip install pandas pyarrow polars duckdb xarray scipy matplotlib
    tests/validation/exports.py target/release/wingd STORE
"""

import json
import os
import re
import subprocess
import sys
import tempfile
from pathlib import Path

import duckdb
import numpy as np
import pandas as pd
import polars as pl
import scipy.io
import xarray


def main(wingd, store):
    work = Path(tempfile.mkdtemp())
    run = lambda *more: subprocess.run([wingd, "export", store, *more], check=True, capture_output=True, text=True).stdout
    truth = [json.loads(line) for line in run("--format", "jsonl").splitlines()]
    solved = [line for line in truth if line["record"] and line["record"]["status"] == "ok"]
    deflections = sorted(line["record"]["tip"]["deflection_m"] for line in solved)
    rows = {"markers": sum(max(1, len(line["record"]["markers"])) for line in truth if line["record"]),
            "span": sum(len(line["record"]["curve"]) for line in solved), "shots": len(truth)}
    for table in ["markers", "span", "parameters", "shots"]:
        file = work / f"{table}.parquet"
        run("--format", "parquet", "--table", table, "--output", str(file))
        csv = work / f"{table}.csv"
        run("--format", "csv", "--table", table, "--output", str(csv))
        frame, polar, text = pd.read_parquet(file), pl.read_parquet(file), pd.read_csv(csv, parse_dates=["utc"])
        duck = duckdb.sql(f"select count(*), min(utc), count(distinct recorder_id) from '{file}'").fetchall()[0]
        assert len(frame) == len(polar) == len(text) == duck[0] == rows.get(table, len(frame)), table
        assert str(frame["utc"].dt.tz) == "UTC" and str(text["utc"].dt.tz) == "UTC"
        assert polar["utc"].dtype == pl.Datetime("us", "UTC") and duck[1].tzinfo is not None and duck[2] == 1
        assert (frame["utc"].iloc[0] == pd.Timestamp(truth[0]["utc"])) and duck[1].timestamp() == frame["utc"].min().timestamp()
        assert list(text.columns) == list(frame.columns) == polar.columns
        for column in frame.select_dtypes("float"):
            assert np.allclose(frame[column], text[column], equal_nan=True, rtol=1e-15), column
        assert set(frame["recorder_id"]) == {truth[0]["recorder_id"]} and frame["inputs"].notna().any(), "what the results follow from"
        print(f"{table}: {len(frame)} rows x {len(frame.columns)} columns, equal in pandas {pd.__version__}, "
              f"polars {pl.__version__}, DuckDB {duckdb.__version__} and CSV")
    shots = pd.read_parquet(work / "shots.parquet")
    assert np.allclose(sorted(shots["tip_deflection_m"].dropna()), deflections)
    read_shape(wingd, store, work, run, solved)


def read_shape(wingd, store, work, run, solved):
    """The joint shape by two readers, and the program of docs/shapes.md."""
    flight = solved[0]["flight"]
    file = work / "shape.nc"
    run("--format", "netcdf", "--flight", flight, "--output", str(file))
    data = xarray.open_dataset(file)
    with scipy.io.netcdf_file(file, "r", mmap=False) as plain:
        for name, variable in plain.variables.items():
            if variable.typecode() in "df" and name != "time":
                assert np.array_equal(variable.data, data[name].values, equal_nan=True), name
    tip = str(data.marker.values[-1])
    assert (data.marker == tip).sum() == 1 and data.marker_displacement.sel(marker=tip, axis="z").shape == data.frame.shape
    records = [line["record"] for line in solved if line["flight"] == flight]
    for k, record in enumerate(records):
        points = len(record["curve"])
        for field, values in [("deflection_m", data.displacement[k, :points, 2]), ("sigma_deflection_m", data.sigma_displacement[k, :points, 2]),
                              ("sigma_slope_deg", data.sigma_slope[k, :points]), ("sigma_twist_deg", data.sigma_twist[k, :points])]:
            stored = np.array([point[field] for point in record["curve"]])
            stored = np.radians(stored) if field.endswith("_deg") else stored
            assert np.allclose(stored, values, rtol=0, atol=1e-9), field
    parts = [part for part in ("lasting", "shared", "own") if f"displacement_{part}" in data]
    variance = sum((data[f"displacement_{part}"].astype(float) ** 2).sum(part) + data[f"displacement_{part}_rest"] ** 2 for part in parts)
    assert np.allclose(np.sqrt(variance), data.sigma_displacement, rtol=1e-5)
    if len(parts) == 3:
        page = (Path(__file__).parents[2] / "docs/shapes.md").read_text()
        program = re.search("### A chi-square test\n\n```python\n(.*?)```", page, re.S)[1]
        np.savetxt(work / "fem.txt", data.displacement[0, :, 2].values + 0.001)
        printed = subprocess.run([sys.executable, "-c", program], cwd=work, check=True, capture_output=True, text=True,
                                 env={**os.environ, "MPLBACKEND": "Agg"}).stdout
        print(f"docs/shapes.md: {printed.strip()}")
        read_series(run, work, flight, data)
    print(f"shape of {len(records)} frames, equal in xarray {xarray.__version__} and scipy")


def read_series(run, work, flight, shape):
    """Means of series in tables, against those of the frames with status ok."""
    for name in ["csv", "parquet"]:
        run("--format", name, "--table", "series", "--flight", flight, "--output", str(work / f"series.{name}"))
    text, frame = pd.read_csv(work / "series.csv", parse_dates=["utc"]), pd.read_parquet(work / "series.parquet")
    names = np.array([name.split("/")[0] for name in shape.image.values])
    names = np.where(shape.status.values.astype(str) == "ok", names, "")
    assert len(text) == len(frame) and set(text["series"]) == set(names) - {""}
    for series, rows in text.groupby("series"):
        z = shape.displacement[names == series, :, 2].values
        assert np.allclose(rows["displacement_z_m"], z.mean(axis=0), atol=1e-12)
        if z.shape[0] > 1:
            assert np.allclose(rows["scatter_displacement_z_m"], z.std(axis=0, ddof=1), atol=1e-12)
    print(f"means of {len(set(names))} series, equal in CSV, Parquet and the frames' shapes")


main(sys.argv[1], sys.argv[2])
