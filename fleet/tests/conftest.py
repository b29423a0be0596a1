"""Two recorders' stores, one server and one lake for all tests. WINGD names the binary, built with upload."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from demo.prepare import call, recalibrated, record
from demo.server import Server
from wingd_fleet import program, solves
from wingd_fleet.lake import Lake


@pytest.fixture(scope="session")
def wingd() -> str:
    return program.find()


@pytest.fixture(scope="session")
def recorders(wingd, tmp_path_factory) -> list[Path]:
    folder = tmp_path_factory.mktemp("recorders")
    return [record(wingd, folder / name) for name in ("a", "b")]


@pytest.fixture(scope="session")
def installation(wingd, recorders, tmp_path_factory) -> Path:
    return recalibrated(wingd, recorders[0].parent, tmp_path_factory.mktemp("other") / "installation")


@pytest.fixture(scope="session")
def server(tmp_path_factory):
    with Server(tmp_path_factory.mktemp("server")) as running:
        os.environ.update(running.environment)
        yield running


def upload(wingd: str, stores: list[Path], url: str) -> None:
    for store, name in zip(stores, ("D-DEMA", "D-DEMB")):
        call(wingd, "upload", str(store), "--to", url, "--aircraft", name, "--aircraft-type", "DEMO")


def define(lake: Lake, wingd: str, installation: Path) -> None:
    solves.define(lake, "onboard", None, [], "as recorded")
    both = {"D-DEMA": installation, "D-DEMB": installation}
    solves.define(lake, "recalibrated", both, [], program.version(wingd))


@pytest.fixture
def lake(wingd, recorders, installation, tmp_path) -> Lake:
    """A directory with both flights and both solves defined, nothing solved."""
    url = f"file://{tmp_path / 'lake'}"
    upload(wingd, recorders, url)
    made = Lake(url)
    define(made, wingd, installation)
    return made


def contents(lake: Lake, *places: str) -> dict[str, bytes]:
    """Every object below the places."""
    return {key: lake.need(key) for place in places or ("tables", "commits") for key in lake.keys(place)}


@pytest.fixture(scope="session")
def faultless(wingd, recorders, installation, tmp_path_factory) -> dict[str, bytes]:
    """Tables and commits of a run in which nothing failed."""
    from wingd_fleet import task

    folder = tmp_path_factory.mktemp("faultless")
    url = f"file://{folder / 'lake'}"
    upload(wingd, recorders, url)
    made = Lake(url)
    define(made, wingd, installation)
    for solve in ("onboard", "recalibrated"):
        for flight in made.flights():
            assert task.run(made, solve, flight, wingd, folder / "work") == "done"
    return contents(made)
