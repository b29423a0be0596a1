import json
import os
import stat
import sys
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from synthetic import Wing, fly, write

import wingd
from wingd import WingdError, store
from wingd.values import WingdWarning

PROGRAM = """#!{python}
import pathlib, shutil, sys
folder = pathlib.Path(r"{folder}")
arguments = sys.argv[1:]
with open(folder / "calls", "a") as calls:
    calls.write(" ".join(arguments) + "\\n")
if arguments == ["--version"]:
    print("wingd " + (folder / "version").read_text())
elif "--flight" in arguments and arguments[arguments.index("--flight") + 1] == "f0002":
    sys.exit("wingd: f0002: has no such results; run `wingd solve` on the store first")
else:
    name = next((name + ".csv" for name in ("shots", "moments") if name in arguments), "shape.nc")
    print("wingd: f0001: 4 frames have results of 2 inputs", file=sys.stderr)
    shutil.copy(folder / name, arguments[arguments.index("--output") + 1])
"""


@pytest.fixture
def place(tmp_path, monkeypatch):
    """A store, and a program that answers as wingd does."""
    folder = tmp_path / "program"
    folder.mkdir()
    (folder / "version").write_text(wingd.__version__)
    write(fly(Wing(), [2.0, 1.9, 1.8, 1.7], seed=5), folder / "shape.nc")
    (folder / "moments.csv").write_text(
        "flight,image,exposure_time,arc_length_m,bending_moment_nm,sigma_bending_moment_nm,sigma_stiffness_nm\n"
        "f0001,0002.jpg,2026-06-01T08:00:01Z,10,2e6,5e4,3e4\nf0001,0001.jpg,2026-06-01T08:00:00Z,10,1e6,5e4,3e4\n"
        "f0001,0001.jpg,2026-06-01T08:00:00Z,30,,,\n"
    )
    rows = [
        ("s000001", f"000{k}.jpg", "ok" if k < 3 else "no_markers", 2.0 - 0.1 * k if k < 3 else np.nan)
        for k in (1, 2, 3)
    ]
    shots = pd.DataFrame(rows, columns=["series", "image", "status", "tip_deflection_ground_m"])
    shots.assign(flight="f0001", utc="2026-06-01T08:00:00.5Z").to_csv(folder / "shots.csv", index=False)
    program = folder / "wingd"
    program.write_text(PROGRAM.format(python=sys.executable, folder=folder))
    program.chmod(program.stat().st_mode | stat.S_IXUSR)
    monkeypatch.setenv("WINGD", str(program))
    monkeypatch.setenv("WINGD_CACHE", str(tmp_path / "cache"))
    store._check_version.cache_clear()
    root = tmp_path / "D-ABCD"
    for flight in ("f0001", "f0002"):
        series = root / "flights" / flight / "s000001"
        series.mkdir(parents=True)
        (series.parent / "flight.json").write_text(json.dumps({"started": {"utc": "2026-06-01T08:00:00Z"}}))
        (series / "results.jsonl").write_text("{}")
        (series / "0001.jpg").write_bytes(b"jpeg")
    (root / "store.toml").write_text("")
    return root, folder


def calls(folder: Path) -> list[str]:
    return [line for line in (folder / "calls").read_text().splitlines() if line.startswith("export")]


def test_a_store_exports_once_for_equal_inputs(place):
    root, folder = place
    with pytest.warns(WingdWarning, match="2 inputs"):
        mean = wingd.open(root)["f0001"].shape("s000001")
    assert mean["displacement"].dims == ("eta", "axis") and int(mean["frames"]) == 2
    frame = wingd.open(root)["f0001"].shape(frame="s000002/0001.jpg")
    assert frame["displacement"].dims == ("eta", "axis")
    assert len(calls(folder)) == 1 and "--eta 0,0.025," in calls(folder)[0]
    (root / "flights/f0001/s000001/0001.jpg").write_bytes(b"other")
    wingd.open(root)["f0001"].frames()
    assert len(calls(folder)) == 1
    (root / "flights/f0001/s000001/results.jsonl").write_text('{"new": 1}')
    with pytest.warns(WingdWarning):
        wingd.open(root)["f0001"].frames()
        wingd.open(root)["f0001"].frames(eta=[0.5, 1.0])
    assert len(calls(folder)) == 3
    assert not [p for p in Path(os.environ["WINGD_CACHE"]).iterdir() if p.is_dir()]


@pytest.mark.filterwarnings("ignore::wingd.values.WingdWarning")
def test_tables_of_a_store(place):
    root, _ = place
    opened = wingd.open(root)
    assert opened.names == ["f0001", "f0002"]
    shots = opened["f0001"].shots
    assert str(shots["utc"].dtype).startswith("datetime64") and shots.loc[("s000001", "0002.jpg"), "status"] == "ok"
    shape = opened["f0001"].shape(where="mach between .785 and .805")
    assert int(shape["frames"]) == 2
    moments = opened["f0001"].moments
    assert list(moments["moment_nm"]) == [1e6, 2e6] and list(moments["s_m"]) == [10, 10]
    assert wingd.loads.extremes(moments).loc[10.0, "sigma_greatest_nm"] == pytest.approx(5e4)
    with pytest.raises(WingdError, match="f0002: has no such results; run `wingd solve`"):
        opened["f0002"].frames()
    (root / "flights/f0002/flight.json").unlink()
    row = wingd.open(root).flights.loc["f0001"]
    assert (row["frames"], row["solved"], row["max_tip_deflection_ground_m"]) == (3, 2, 1.9)
    assert wingd.open(root).shape("s000001").wingd.displacement().sel(eta=0.5).sigma.item() > 0


@pytest.mark.filterwarnings("ignore::wingd.values.WingdWarning")
def test_mistakes_in_names(place, monkeypatch):
    root, folder = place
    opened = wingd.open(root)
    with pytest.raises(WingdError, match="no flight f9; known are f0001, f0002"):
        opened["f9"]
    with pytest.raises(WingdError, match="no frame of s000009 .* known are s000001, s000002"):
        opened["f0001"].shape("s000009")
    with pytest.raises(WingdError, match="has the flights f0001, f0002"):
        opened.shape()
    with pytest.raises(WingdError, match="is not a store"):
        wingd.open(folder)
    with pytest.raises(FileNotFoundError):
        wingd.open(root / "none.nc")
    (folder / "version").write_text("9.0.0")
    store._check_version.cache_clear()
    with pytest.raises(WingdError, match="version 9.0.0, this package .*; install the two of one release"):
        opened["f0001"].frames()
    monkeypatch.setenv("WINGD", str(folder / "none"))
    with pytest.raises(WingdError, match="is not a program"):
        opened["f0001"].frames()
    monkeypatch.delenv("WINGD")
    monkeypatch.setenv("PATH", str(folder.parent))
    with pytest.raises(WingdError, match="not on the PATH"):
        opened["f0001"].frames()


def test_exported_files_need_no_program(tmp_path, monkeypatch):
    monkeypatch.setenv("PATH", "")
    one = write(fly(Wing(), [2.0, 1.9], seed=5), tmp_path / "a.nc")
    two = write(fly(Wing(), [2.0], seed=6, flight="f0002"), tmp_path / "b.nc")
    opened = wingd.open([one, two])
    assert opened.names == ["f0001", "f0002"]
    assert list(opened.flights["frames"]) == [2, 1]
    difference = opened["f0001"].shape().wingd.difference(opened["f0002"].shape())
    assert 3 <= difference.test().freedom <= 6
    assert "weight_kg" in opened["f0001"].shots
    with pytest.raises(WingdError, match="flight f0001 twice"):
        wingd.open([one, one])
    other = write(fly(Wing(name="L2", recorder="R2"), [2.0], seed=7), tmp_path / "c.nc")
    assert wingd.open([one, other]).names == ["R1/f0001", "R2/f0001"]
    with pytest.raises(WingdError, match="no bending moments"):
        opened["f0001"].moments  # noqa: B018


def test_a_frame_of_unknown_time_does_not_hide_the_start_of_its_flight(tmp_path):
    data = fly(Wing(), [2.0, 1.9], seed=5)
    known = wingd.open(write(data, tmp_path / "0.nc"))["f0001"].frames()["time"].values
    for unknown in (1, 2):
        times = data["time"].copy(data=np.where(np.arange(2) < unknown, np.nan, data["time"].values))
        row = wingd.open(write(data.assign_coords(time=times), tmp_path / f"{unknown}.nc")).flights.iloc[0]
        assert pd.isna(row["started"]) if unknown == 2 else row["started"] == pd.Timestamp(known[1], tz="UTC")
