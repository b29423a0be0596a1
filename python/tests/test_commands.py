import json

import numpy as np
import pandas as pd
import pytest
from synthetic import Wing, bend, fly, write

from wingd.__main__ import main


@pytest.fixture
def files(tmp_path):
    arcs = Wing().arc
    z, slope, _ = bend(arcs, 2.0)
    pd.DataFrame({"arc_length_m": arcs, "displacement_z_m": z, "slope_deg": np.degrees(slope), "note": ""}).to_csv(
        tmp_path / "fem.csv", index=False
    )
    write(fly(Wing(), [2.0, 1.95, 2.05], seed=5), tmp_path / "one.nc")
    write(fly(Wing(), [2.0], seed=6, flight="f0002"), tmp_path / "two.nc")
    return tmp_path


def answer(capsys, *arguments):
    status = main([str(a) for a in arguments])
    out, err = capsys.readouterr()
    return status, out, err


def test_mean(files, capsys):
    status, out, err = answer(capsys, "mean", f"{files / 'one.nc'}", files / "two.nc", "--eta", "0.5,1")
    assert status == 0 and out.endswith("mean of 4 frames of 2 flights\n") and not err
    status, out, _ = answer(capsys, "mean", f"{files / 'one.nc'}:f0001/s000001", "--json")
    found = json.loads(out)
    assert found["frames"] == 2 and len(found["stations"]) == 10
    assert {"displacement_z_m", "sigma_slope_deg", "scatter_twist_deg"} <= set(found["stations"][0])
    status, _, err = answer(capsys, "mean", files / "one.nc", files / "one.nc")
    assert status == 1 and err == "error: a frame is named twice; name each once\n"


def test_difference(files, capsys):
    status, out, _ = answer(capsys, "difference", files / "one.nc", files / "two.nc")
    assert status == 0 and "chi-square" in out and "difference at 1 %" in out
    status, out, err = answer(
        capsys, "difference", f"{files / 'one.nc'}:f0001/s000001/0001.jpg", "--against", files / "fem.csv", "--json"
    )
    found = json.loads(out)
    assert 3 <= found["freedom"] <= 4 and found["p"] > 0.001 and len(found["stations"]) == 21
    assert found["stations"][0]["sigma_slope_deg"] == 0
    assert "60 mm shorter" in found["notes"][0] and "columns that are not read: note" in err
    _, out, _ = answer(
        capsys, "difference", files / "one.nc", "--against", files / "fem.csv", "--no-thermal", "--eta", "0.5,1"
    )
    assert "this is removed" in out and out.count("\n") < 9


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["difference", "one.nc", "none.nc"], "no such file"),
        (["difference", "one.nc", "one.nc"], "both sides have a frame in common"),
        (["difference", "one.nc:f0009", "two.nc"], "no flight f0009; known are f0001"),
        (["difference", "one.nc:f0001/s9", "two.nc"], "no frame with this name"),
        (["difference", "one.nc", "--against", "one.nc"], "is not text in UTF-8"),
        (["difference", "one.nc", "two.nc", "--load-correction", "fem.csv"], "write FILE:QUANTITY"),
        (["difference", "one.nc", "two.nc", "--where", "mach > 2"], "no frame fulfils"),
        (["mean", "one.nc", "--eta", "0.5,1.5"], "not between the stations"),
        (["loads", "one.nc"], "no bending moments"),
        (["loads", "fem.csv"], "has no column time"),
    ],
)
def test_mistakes_are_one_line_and_status_1(arguments, message, files, capsys, monkeypatch):
    monkeypatch.chdir(files)
    status, out, err = answer(capsys, *arguments)
    error = [line for line in err.splitlines() if line.startswith("error: ")]
    assert status == 1 and not out and len(error) == 1 and message in error[0]
    assert "Traceback" not in err


def test_wrong_usage_is_status_2(files, capsys):
    for arguments in (
        ["difference", "a", "b", "--against", "c"],
        ["difference", "a"],
        ["mean", "a", "--eta", "x"],
        ["loads", "a", "--levels", "0"],
    ):
        with pytest.raises(SystemExit) as end:
            main(arguments)
        assert end.value.code == 2
    assert "Traceback" not in capsys.readouterr().err


def test_loads_of_a_table(capsys, tmp_path):
    from test_loads import history

    history().to_csv(tmp_path / "moments.csv", index=False)
    status, out, _ = answer(capsys, "loads", tmp_path / "moments.csv", "--bending-hz", "1", "--json")
    found = json.loads(out)
    assert status == 0 and found["no_cycles_because"] is None and found["damage"]
    status, out, _ = answer(capsys, "loads", tmp_path / "moments.csv", "--bending-hz", "10")
    assert status == 0 and "No cycles: 50 frames per second are too few" in out
