import gvar
import numpy as np
import pytest
import xarray as xr
from synthetic import Wing, fly, opened, reduced, write
from uncertainties import unumpy

from wingd import WingdError
from wingd.backend import open_shape
from wingd.shapes import to_dataset
from wingd.values import Values, concat


@pytest.fixture
def flight():
    return opened(fly(Wing(), [2.0, 1.9, 1.8, 1.7], seed=5))


def full_covariance(values: Values) -> np.ndarray:
    return values.covariance


def test_arithmetic_equals_that_of_gvar(flight):
    z = flight.wingd.displacement("z").sel(eta=[0.25, 0.5, 1.0])
    numbers = z.to_gvar()
    assert np.allclose(gvar.evalcov(numbers.ravel()), z.covariance)
    for ours, theirs in [
        (z.isel(frame=0) - z.isel(frame=3), numbers[0] - numbers[3]),
        (z.mean(), numbers.mean(axis=0)),
        (z.mean() - z.isel(frame=1), numbers.mean(axis=0) - numbers[1]),
        (2.0 * z.isel(frame=0) + z.isel(frame=1) / 3 - 0.5, 2.0 * numbers[0] + numbers[1] / 3 - 0.5),
        (z - z.isel(frame=2), numbers - numbers[2]),
        (z - z.mean(), numbers - numbers.mean(axis=0)),
    ]:
        np.testing.assert_allclose(ours.value.values, gvar.mean(theirs), rtol=1e-12)
        np.testing.assert_allclose(ours.covariance, gvar.evalcov(theirs.ravel()), atol=1e-15)
        np.testing.assert_allclose(ours.sigma.values, gvar.sdev(theirs), atol=2e-9)


def test_conversions(flight):
    z = flight.wingd.displacement("z").isel(frame=0).sel(eta=[0.5, 1.0])
    for numbers in (z.to_gvar(), z.to_uncertainties()):
        back = Values.from_correlated(numbers, z.value)
        np.testing.assert_allclose(back.value.values, z.value.values)
        np.testing.assert_allclose(back.covariance, z.covariance, atol=1e-16)
        # A new source: nothing cancels with the values that it came from.
        np.testing.assert_allclose((back - z).covariance, 2 * z.covariance, atol=1e-15)
    assert np.allclose(unumpy.std_devs(z.to_uncertainties()), z.sigma)


def test_what_is_common_cancels_by_its_key(flight):
    z = flight.wingd.displacement("z").isel(eta=-1)
    same = z.isel(frame=0) - z.isel(frame=0)
    assert same.sigma.item() == 0
    pair = z.isel(frame=0) - z.isel(frame=1)
    only_own = np.sqrt(sum((flight["displacement_own"].values[k, -1, 2] ** 2).sum() for k in (0, 1)))
    assert pair.sigma.item() == pytest.approx(only_own, rel=1e-12)
    other = opened(fly(Wing(), [2.0], seed=6, flight="f0002")).wingd.displacement("z").isel(frame=0, eta=-1)
    shared = [
        (f["displacement_shared"].values[0, -1, 2] ** 2).sum()
        for f in (flight, opened(fly(Wing(), [2.0], seed=6, flight="f0002")))
    ]
    own = [
        (f["displacement_own"].values[0, -1, 2] ** 2).sum()
        for f in (flight, opened(fly(Wing(), [2.0], seed=6, flight="f0002")))
    ]
    assert (z.isel(frame=0) - other).sigma.item() == pytest.approx(np.sqrt(sum(shared) + sum(own)), rel=1e-12)


def test_reduced_factors_keep_sigma_and_lead_back_to_common_sources(flight):
    less = opened(reduced(fly(Wing(), [2.0, 1.9, 1.8, 1.7], seed=5), 5))
    full, cut = flight.wingd.displacement("z"), less.wingd.displacement("z")
    np.testing.assert_allclose(cut.sigma, full.sigma, rtol=1e-4, atol=1e-9)
    # Another flight of the installation, reduced to other sources: the lasting errors still cancel.
    second = fly(Wing(), [2.5, 2.4], seed=8, flight="f0002")
    pair = [opened(d).wingd.displacement("z").mean() for d in (second, reduced(second, 4))]
    difference = cut.mean() - pair[1]
    np.testing.assert_allclose(difference.sigma, (full.mean() - pair[0]).sigma, rtol=0.02, atol=1e-6)
    joined = concat([cut.mean(), pair[1]]).mean()
    np.testing.assert_allclose(joined.sigma, concat([full.mean(), pair[0]]).mean().sigma, rtol=1e-2, atol=1e-9)
    # Of two frames with one digest the rests of a value cancel.
    assert (cut.isel(frame=0) - cut.isel(frame=1)).sigma.values[-1] == pytest.approx(
        (full.isel(frame=0) - full.isel(frame=1)).sigma.values[-1], rel=1e-4
    )


def test_concat_of_two_files_by_xarray():
    parts = [reduced(fly(Wing(), [2.0, 1.9], seed=s, flight=f"f{s:04d}"), k) for s, k in ((5, 3), (6, 4))]
    aircraft = [parts[0], reduced(fly(Wing(name="L2", seed=9), [2.0], seed=7), 3)]
    for pair, common in ((parts, True), (aircraft, False)):
        labelled = [p.assign_coords({k: np.arange(p.sizes[k]) for k in ("lasting", "shared", "own")}) for p in pair]
        both = opened(
            xr.concat(
                [opened(p) for p in labelled],
                "frame",
                join="outer",
                data_vars="all",
                coords="minimal",
                compat="override",
            )
        )
        z = both.wingd.displacement("z").isel(eta=-1)
        alone = [opened(p).wingd.displacement("z").isel(eta=-1) for p in pair]
        expected = alone[0].isel(frame=0) - alone[1].isel(frame=0)
        found = z.isel(frame=0) - z.isel(frame=2)
        assert found.sigma.item() == pytest.approx(expected.sigma.item(), rel=1e-9)
        covariance = z.covariance[0, 2]
        assert (abs(covariance) > 1e-6) == common


def test_interpolation_between_stations(flight):
    z = flight.wingd.displacement("z")
    assert z.sel(eta=0.5).value.values == pytest.approx(flight["displacement"].sel(eta=0.5, axis="z").values)
    wing = Wing(stations=41)
    fine = opened(fly(wing, [2.0], seed=5, sampled=False)).wingd.displacement("z")
    coarse = opened(fly(Wing(stations=11), [2.0], seed=5, sampled=False)).wingd.displacement("z")
    there = coarse.sel(arc_length=fine.value["arc_length"].values)
    np.testing.assert_allclose(there.value.values, fine.value.values, atol=1e-5)
    np.testing.assert_allclose(there.sigma.values, fine.sigma.values, atol=1e-5)
    with pytest.raises(WingdError, match="not between the stations"):
        z.sel(eta=1.2)


def test_selection_by_names_and_numbers(flight, tmp_path):
    data = open_shape(
        write(
            fly(Wing(), [2.0, 1.9], seed=5).assign(marker_displacement=(("frame", "marker"), np.ones((2, 2)))),
            tmp_path / "a.nc",
        )
    )
    assert data.sel(eta=0.5)["displacement"].shape == (2, 3)
    assert data.sel(eta=0.35)["arc_length"] == pytest.approx(10.5)
    assert data.sel(arc_length=15.0)["eta"] == pytest.approx(0.5)
    assert bool((data["marker"] == "M19")[1])
    assert data.sel(marker="M19")["marker_displacement"].shape == (2,)
    with pytest.raises(KeyError, match="nearest is 0.5"):
        data.sel(eta=0.51)
    assert data.sel(eta=slice(0.4, 0.6)).sizes["eta"] == 5
    assert data.sel(eta=0.51, method="nearest")["eta"] == 0.5
    assert str(data["time"].values[1]).startswith("2026-06-01T08:00:10")


def test_mean_dataset_reads_back(flight):
    average = flight.wingd.mean()
    z = flight.wingd.displacement("z").mean()
    np.testing.assert_allclose(average.wingd.displacement("z").covariance, z.covariance, atol=1e-16)
    np.testing.assert_allclose(average["sigma_displacement"].sel(axis="z"), z.sigma, atol=1e-12)
    # A later frame of the same flight still shares its sources with the mean.
    frame = flight.isel(frame=0).wingd.displacement("z")
    np.testing.assert_allclose((average.wingd.displacement("z") - frame).covariance, (z - frame).covariance, atol=1e-15)
    again = to_dataset({"slope": average.wingd.slope()})
    np.testing.assert_allclose(again.wingd.slope().covariance, average.wingd.slope().covariance)


def test_frames_without_a_shape_do_not_enter_the_mean():
    data = fly(Wing(), [2.0, 1.9, 1.8], seed=5)
    for name in ("displacement", "slope", "twist"):
        data[name][1], data[f"sigma_{name}"][1] = np.nan, np.nan
    shape = opened(data).wingd.mean()
    assert int(shape["frames"]) == 2
    assert np.isfinite(shape["displacement"]).all()
    assert np.isnan(opened(data).wingd.displacement("z").sigma.values[1]).all()


def test_stations_of_other_exports_of_one_flight_are_refused():
    one, two = (opened(fly(Wing(), [2.0, 1.9], seed=5)) for _ in range(2))
    two = two.assign_coords(shared_sources=("frame", ["other"] * 2))
    with pytest.raises(WingdError, match="export them together"):
        one.wingd.slope().isel(frame=0) - two.wingd.slope().isel(frame=1)


def test_factors_too_large_for_memory_are_refused():
    data = fly(Wing(stations=5), [2.0] * 1200, seed=5)
    z = opened(data).wingd.displacement("z")
    import wingd.values as module

    before, module.MAX_FACTOR = module.MAX_FACTOR, 10 << 20
    try:
        with pytest.raises(WingdError, match="select fewer frames"):
            z - z.mean()
    finally:
        module.MAX_FACTOR = before


def test_newer_formats_and_other_files_are_refused(tmp_path):
    data = fly(Wing(), [2.0], seed=5)
    data.attrs["format_version"] = 3
    with pytest.raises(WingdError, match="format version 3.*update"):
        open_shape(write(data, tmp_path / "new.nc"))
    xr.Dataset({"a": ("x", [1.0])}).to_netcdf(tmp_path / "other.nc", engine="scipy")
    with pytest.raises(WingdError, match="is not a shape"):
        open_shape(tmp_path / "other.nc")
    (tmp_path / "text.nc").write_text("arc_length")
    with pytest.raises(WingdError, match="not a NetCDF file"):
        open_shape(tmp_path / "text.nc")
    with pytest.raises(FileNotFoundError):
        open_shape(tmp_path / "none.nc")


def test_the_engine_of_xarray(tmp_path):
    file = write(fly(Wing(), [2.0], seed=5), tmp_path / "a.nc")
    data = xr.open_dataset(file, engine="wingd")
    assert data.wingd.displacement().value.shape == (1, 21)


def test_ten_thousand_frames():
    import resource
    import time

    n, rng = 10_000, np.random.default_rng(1)
    data = fly(Wing(stations=41), [2.0], seed=5).isel(frame=np.zeros(n, dtype=int))
    data["own_sources"] = "frame", [f"own-{k}" for k in range(n)]
    data["displacement_own"] = data["displacement_own"].dims, rng.normal(size=data["displacement_own"].shape) * 1e-3
    started = time.process_time()
    z = opened(data).wingd.displacement("z")
    mean = z.mean()
    assert mean.sigma.values[-1] < z.sigma.values[0, -1]
    assert (z - z.isel(frame=0)).sigma.shape == (n, 41)
    assert time.process_time() - started < 10
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss < 2 << 20
