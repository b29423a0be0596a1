"""The package against the results of the Rust program that it replaces.

``data/base-*.nc`` are exports of ``wingd 0.1.0`` (``wingd export STORE --format netcdf --table shape --eta 0,.25,.5,.75,1``,
without rotations and markers, some with fewer frames), ``base.json`` has ``wingd mean`` and ``wingd difference`` with
``--json --eta 0,.25,.5,.75,1`` of the same stores: the sets dev and lit and two flights of the demonstration, each solved
together. ``moments.csv``, ``base-stress.json`` and ``base-goodman.json`` are of ``wingd stress --bending-hz 3`` on the
demonstration's frames at 50 per second.
"""

import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from wingd import WingdError, loads
from wingd.backend import open_shape
from wingd.comparison import COLUMN_OF, compare, difference, shape_quantities, station_table
from wingd.shapes import mean

DATA = Path(__file__).parent / "data"
BASE = json.loads((DATA / "base.json").read_text())


def shape(name):
    return open_shape(DATA / f"base-{name}.nc")


def assert_equal(table: pd.DataFrame, base: list[dict], relative=1e-9):
    compared = 0
    for column in base[0]:
        theirs = np.array([row[column] for row in base], dtype=float)
        np.testing.assert_allclose(table[column].to_numpy(), theirs, rtol=relative, atol=1e-13, err_msg=column)
        compared += np.isfinite(theirs).sum()
    assert compared > 20


def mean_table(data):
    quantities = shape_quantities(data)
    scatter = {}
    for q in quantities:
        array = data["scatter_displacement"].sel(axis="z") if q == "displacement_z" else data[f"scatter_{q}"]
        scatter[q] = array.values
    return station_table(quantities, {"scatter_": scatter})


def test_mean_of_a_flight():
    assert_equal(mean_table(shape("dev").wingd.mean()), BASE["dev mean"]["stations"])


def test_mean_of_two_flights_of_one_installation():
    assert_equal(mean_table(mean([shape("two-1"), shape("two-2")])), BASE["two mean"]["stations"])


@pytest.mark.parametrize(
    ("name", "one", "other"),
    [
        ("dev", ("dev", [1]), ("dev", [3])),
        ("lit", ("lit", [0]), ("lit", [2])),
        ("two", ("two-1", None), ("two-2", None)),
    ],
)
def test_difference(name, one, other):
    a, b = (shape(n) if frames is None else shape(n).isel(frame=frames) for n, frames in (one, other))
    found, base = difference(a, b), BASE[f"{name} difference"]
    assert_equal(found.table(), base["stations"])
    test = found.test(full=True)
    np.testing.assert_allclose([test.chi_square, test.p], [base["chi_square"], base["p"]], rtol=1e-9, atol=1e-300)
    assert test.freedom == base["freedom"]
    ours = test.combinations["sigmas"][: len(base["combinations"])]
    np.testing.assert_allclose(ours, [c["sigmas"] for c in base["combinations"]], rtol=1e-9)


@pytest.mark.parametrize("name", ["dev fem", "dev fem load"])
def test_comparison_with_a_computation(name):
    load = [f"{DATA / 'load.csv'}:0.4,0.1"] if "load" in name else []
    found = compare(shape("dev"), DATA / "fem.csv", load=load)
    base = BASE[name]
    known = [k for k in base["stations"][0] if k in found.table()]
    assert {"displacement_z_m", "sigma_slope_deg"} <= set(known)
    assert_equal(found.table(), [{k: row[k] for k in known} for row in base["stations"]])
    test = found.test(full=True)
    np.testing.assert_allclose([test.chi_square, test.p], [base["chi_square"], base["p"]], rtol=1e-9, atol=1e-300)
    assert test.freedom == base["freedom"]


def test_frames_adjusted_singly_are_not_averaged_or_compared():
    single = shape("single")
    assert shape("single").isel(frame=[0]).wingd.displacement().sigma.values.max() > 0.005
    with pytest.raises(WingdError, match="adjusted singly"):
        single.wingd.mean()
    with pytest.raises(WingdError, match="adjusted singly"):
        difference(single.isel(frame=[0]), single.isel(frame=[1]))
    # The installation of two-1 is that of the demonstration: what a single frame shares with its flight is not known.
    with pytest.raises(WingdError, match="adjusted singly"):
        joint = shape("two-1")
        joint = joint.assign_coords(
            lasting_sources=("frame", np.resize(single["lasting_sources"].values, joint.sizes["frame"]))
        )
        difference(single.isel(frame=[0]), joint)


@pytest.mark.parametrize("goodman", [False, True])
def test_loads_equal_those_of_stress(goodman):
    base = json.loads((DATA / f"base-{'goodman' if goodman else 'stress'}.json").read_text())
    moments, structure = loads.read_moments(DATA / "moments.csv"), loads.read_structure(DATA / "structure.csv")
    extremes, exceedances = loads.extremes(moments), loads.exceedances(moments)
    cycles, damage = loads.rainflow(moments, 3.0), loads.damage(moments, structure=structure, goodman=goodman)
    for station in base["stations"]:
        s = station["s_m"]
        row = extremes.loc[s]
        ours = [row.greatest_nm, row.sigma_greatest_nm, row.smallest_nm, row.sigma_smallest_nm]
        ours += [row.ground_air_ground_nm, row.sigma_ground_air_ground_nm]
        theirs = [station[k][f] for k in ("greatest", "smallest") for f in ("moment_n_m", "sigma_moment_n_m")]
        theirs += [station["ground_air_ground"][f] for f in ("range_n_m", "sigma_range_n_m")]
        np.testing.assert_allclose(ours, theirs, rtol=1e-9)
        counted = cycles[(cycles.s_m == s) & cycles.significant]
        expected = pd.DataFrame(station["cycles"])
        pairs = {"range_nm": "range_n_m", "sigma_range_nm": "sigma_range_n_m", "mean_nm": "mean_n_m", "count": "count"}
        for a, b in pairs.items():
            np.testing.assert_allclose(counted[a], expected[b], rtol=1e-9)
        assert cycles[(cycles.s_m == s) & ~cycles.significant]["count"].sum() == station["cycles_excluded"]
        expected = pd.DataFrame(station["damage"])
        pairs = {
            "relative": "relative",
            "sigma_relative": "sigma_relative",
            "equivalent_range_nm": "equivalent_range_n_m",
        }
        pairs["sigma_equivalent_range_nm"] = "sigma_equivalent_range_n_m"
        for a, b in pairs.items():
            np.testing.assert_allclose(damage[damage.s_m == s][a], expected[b], rtol=1e-9)
        expected = pd.DataFrame(station["exceedances"])
        found = exceedances[exceedances.s_m == s]
        assert list(found.frames_above) == list(expected.frames_above)
        assert list(found.upward_crossings) == list(expected.upward_crossings)


def test_every_compared_column_is_a_known_one():
    assert set(COLUMN_OF.values()) >= {
        c for c in BASE["dev mean"]["stations"][0] if not c.startswith(("sigma", "scatter", "arc"))
    }
