"""Flights and exported files are read from a bucket as from the disk."""

from __future__ import annotations

import obstore
import pytest
import xarray as xr

import wingd as package
from demo.prepare import call
from demo.server import BUCKET
from wingd.objects import open_bucket

pytestmark = pytest.mark.filterwarnings("ignore::wingd.values.WingdWarning")
ETA = (0.0, 0.5, 1.0)


@pytest.fixture
def cache(tmp_path, monkeypatch):
    monkeypatch.setenv("WINGD_CACHE", str(tmp_path / "cache"))
    return tmp_path / "cache"


def test_a_flight_of_a_bucket_is_that_of_the_store(wingd, recorders, server, cache):
    url = f"s3://{BUCKET}/read"
    call(wingd, "upload", str(recorders[0]), "--to", url, "--aircraft", "D-DEMA", "--wing", "left")
    lake = package.open(url)
    (name,) = lake.names
    assert lake.flights.loc[name, "aircraft"] == "D-DEMA" and lake.flights.loc[name, "wing"] == "left"
    local = package.open(recorders[0])["f0001"]
    xr.testing.assert_equal(lake[name].frames(eta=ETA), local.frames(eta=ETA))
    assert lake[name].shots["status"].equals(local.shots["status"])
    # The flight is downloaded once.
    downloaded = {path: path.stat().st_mtime_ns for path in cache.rglob("*.jpg")}
    assert downloaded and package.open(url)[name].shots.shape == local.shots.shape
    assert downloaded == {path: path.stat().st_mtime_ns for path in cache.rglob("*.jpg")}
    with pytest.raises(package.WingdError, match="there is no flight f9"):
        lake["f9"]


def test_an_exported_file_of_a_bucket_is_opened_by_its_url(wingd, recorders, server, cache, tmp_path):
    file, url = tmp_path / "shape.nc", f"s3://{BUCKET}/files/shape.nc"
    call(wingd, "export", str(recorders[0]), "--format", "netcdf", "--table", "shape", "--output", str(file))
    obstore.put(open_bucket(f"s3://{BUCKET}/files", url, "60s"), "shape.nc", file.read_bytes())
    with xr.open_dataset(url, engine="wingd") as remote, xr.open_dataset(file, engine="wingd") as local:
        xr.testing.assert_identical(remote, local)
    assert package.open(url)["f0001"].shape(frame="s000001/0001.jpg").wingd.displacement().sel(eta=0.5).sigma > 0
    for missing, message in ((f"s3://{BUCKET}/files/none.nc", "no such object"), ("s3:///none.nc", "names no bucket")):
        with pytest.raises(package.WingdError, match=message):
            xr.open_dataset(missing, engine="wingd")
