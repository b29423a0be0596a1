"""What the program writes today: format 2, read by the package, and the questions of docs/python.md on it."""

from __future__ import annotations

import itertools
import os
import shutil
import subprocess

import matplotlib
import numpy as np
import pandas as pd
import pytest
import xarray as xr
from test_loads import history

import wingd
from wingd import WingdError
from wingd.backend import open_shape
from wingd.values import WingdWarning

matplotlib.use("Agg")
pytestmark = pytest.mark.filterwarnings("ignore::wingd.values.WingdWarning")


@pytest.fixture(scope="module")
def files(demo_store, tmp_path_factory):
    """Exports with reduced and with full factors."""
    folder = tmp_path_factory.mktemp("exports")
    for name, more in (("reduced", []), ("full", ["--full-factors"])):
        export = [
            "export",
            str(demo_store),
            "--format",
            "netcdf",
            "--table",
            "shape",
            "--output",
            folder / f"{name}.nc",
        ]
        subprocess.run([os.environ["WINGD"], *export, *more], check=True, capture_output=True)
    return folder


def test_format_2_has_its_coordinates_texts_units_and_attributes(files):
    data = xr.open_dataset(files / "reduced.nc", engine="wingd")
    assert data.attrs["format_version"] == 2 and data.attrs["Conventions"] == "CF-1.8" and data.attrs["history"]
    assert data.attrs["root_offset_sigma_m"] == 0.3 and data.attrs["side"] == "left"
    assert data.attrs["length_to_tip_m"] > data.attrs["outermost_marker_m"] > 20
    assert (data["marker"] == "M19").sum() == 1 and data.sel(marker="M19").sizes["frame"] == 10
    assert list(data["axis"].values) == ["x", "y", "z"] and data["time"].dtype.kind == "M"
    assert data.sel(arc_length=float(data["arc_length"][20])).sizes["axis"] == 3
    with pytest.raises(KeyError, match="there is no station at eta = 0.512"):
        data.sel(eta=0.512)
    assert data["weight_kg"].attrs["units"] == "kg" and data["bending_moment"].attrs["units"] == "N m"
    assert {"lasting_sources", "shared_sources", "own_sources", "thermal_scale"} <= set(data.variables)
    assert np.isfinite(data["sigma_displacement"]).all() and (data["status"] == "ok").all()
    assert len(set(data["shared_sources"].values)) == 1 and len(set(data["own_sources"].values)) == 10


def test_reduced_factors_have_the_sigmas_of_full_ones(files):
    """Of values to rounding, of differences of two frames to 1e-4."""
    reduced, full = (open_shape(files / f"{name}.nc") for name in ("reduced", "full"))
    assert (files / "reduced.nc").stat().st_size < 0.5 * (files / "full.nc").stat().st_size
    for quantity in ("displacement", "slope", "twist", "marker_displacement", "bending_moment"):
        one, two = (data.wingd.values(quantity) for data in (reduced, full))
        np.testing.assert_allclose(one.sigma, two.sigma, rtol=1e-6, atol=1e-12)
        for i, j in itertools.combinations(range(10), 2):
            less, whole = ((v.isel(frame=i) - v.isel(frame=j)).sigma.values for v in (one, two))
            np.testing.assert_allclose(less, whole, rtol=1e-4, atol=1e-7 * whole.max())


def test_installations_of_independent_roots_are_known_by_the_file(files):
    one = open_shape(files / "reduced.nc").isel(frame=[0])
    names = {
        n: one[n].astype(str).copy(data=[f"other-{one[n].item()}"])
        for n in one.coords
        if n == "inputs" or str(n).endswith("_sources")
    }
    other = one.assign_coords(names)
    sharp = one.assign_attrs(root_offset_sigma_m=0.0), other.assign_attrs(root_offset_sigma_m=0.0)
    z = [(a.wingd.displacement() - b.wingd.displacement()).sigma.values[0, -1] for a, b in ((one, other), sharp)]
    slope = float(one.wingd.slope().value[0, -1])
    assert z[0] == pytest.approx(np.hypot(z[1], 0.3 * np.sqrt(2) * slope), rel=0.05) and z[0] > 1.5 * z[1]


#: The lines of the analyst, of one installation; their flight and their series are those of the demonstration.
QUESTIONS = """
store = wingd.open("D-ABCD")
store.flights, store["f0001"].shots
shape = store["f0001"].shape("s000002")
store["f0001"].shape(frame="s000002/0001.jpg"), store["f0001"].shape(where="mach between .78 and .80")

d = shape.wingd.displacement(axis="z", reference="ground")
d.sigma, d.covariance, d.plot()
(d - other).test()

wingd.compare(shape, fem="fem.csv", axes="cad", eta=[.25, .5, .75, 1])

moved = shape.wingd.deform(mesh)

wingd.loads.rainflow(moments), wingd.spectrum(live)
"""


def test_the_questions_of_an_analyst_take_at_most_five_lines_each(demo_store, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("WINGD_CACHE", str(tmp_path / "cache"))
    shutil.copytree(demo_store, "D-ABCD")
    questions = [q.splitlines() for q in QUESTIONS.strip().split("\n\n")]
    assert all(len(lines) <= 5 for lines in questions)
    flight = wingd.open("D-ABCD")["f0001"]
    shape = flight.shape("s000002")
    pd.DataFrame({"arc_length_m": shape["arc_length"], "displacement_z_m": shape.wingd.displacement().value}).to_csv(
        "fem.csv"
    )
    other = flight.shape("s000003").wingd.displacement(axis="z", reference="ground")
    names = {"wingd": wingd, "other": other, "mesh": shape["marker_ground_position"].values}
    names |= {"moments": history(), "live": history()}
    found = {}
    for line in itertools.chain(*questions):
        assigns = line.split(" = ")[0].isidentifier()
        if assigns:
            exec(line, names)
        found[line] = names[line.split(" = ")[0]] if assigns else eval(line, names)
    answers = list(found.values())
    assert len(answers[1][0]) == 1 and len(answers[1][1]) == 10 and "mach" in answers[1][1]
    assert int(answers[3][1]["frames"]) == 10 and names["shape"].wingd.displacement().sel(eta=0.5).sigma > 0
    d = names["d"]
    assert d.sigma.dims == ("eta",) and d.covariance.shape == (d.value.size,) * 2
    assert "ground frame / m" in answers[5][2].get_ylabel().replace("\n", " ")
    assert answers[6].significant and answers[6].freedom <= 4
    assert list(answers[7].table()["eta"]) == pytest.approx([0.25, 0.5, 0.75, 1.0])
    assert np.isfinite(answers[7]["displacement_z"].sigma).all()
    assert names["moved"].sigma_m.shape == (27, 3) and answers[9][0]["significant"].any()
    # The demonstration's frames are hours apart: its moments have extremes, but no cycles.
    assert wingd.loads.extremes(flight.moments)["greatest_nm"].gt(0).all()
    with pytest.raises(WingdError, match="too few to count cycles"):
        wingd.loads.rainflow(flight.moments)


def test_notes_of_the_program_are_warnings(demo_store, tmp_path, monkeypatch):
    monkeypatch.setenv("WINGD_CACHE", str(tmp_path))
    with pytest.warns(WingdWarning, match="results of|inputs"):
        wingd.open(demo_store)["f0001"].frames(eta=[0.0, 0.5, 1.0])
