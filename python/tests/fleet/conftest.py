"""Two recorders' stores, one server and one lake for all tests. WINGD is the path of the binary."""

from __future__ import annotations

import os
import shutil
import sys
from pathlib import Path

import pytest

from demo.prepare import call, path_with, recalibrated, record, recorder_of, weigh
from demo.server import Server
from wingd.fleet import program, solves, task
from wingd.fleet.lake import Flight, Lake
from wingd.fleet.state import State

# `wingd upload` finds wingd-upload of this environment.
os.environ["PATH"] = path_with(sys.executable)

SOLVES = ("onboard", "recalibrated")
AIRCRAFT = ("D-DEMA", "D-DEMB")


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    for item in items:
        if Path(__file__).parent in item.path.parents:
            item.add_marker(pytest.mark.long)


@pytest.fixture(scope="session")
def wingd() -> str:
    return program.find()


@pytest.fixture(scope="session")
def recorders(wingd, tmp_path_factory) -> list[Path]:
    """Two recorders: the first has aircraft data, the second none."""
    folder = tmp_path_factory.mktemp("recorders")
    stores = [record(wingd, folder / name) for name in ("a", "b")]
    weigh(wingd, stores[0])
    return stores


@pytest.fixture(scope="session")
def installation(wingd, recorders, tmp_path_factory) -> Path:
    return recalibrated(wingd, recorders[0].parent, tmp_path_factory.mktemp("other") / "installation")


@pytest.fixture(scope="session")
def server(tmp_path_factory):
    with Server(tmp_path_factory.mktemp("server")) as running:
        os.environ.update(running.environment)
        yield running


def upload(wingd: str, stores: list[Path], url: str) -> None:
    for store, name, wing in zip(stores, AIRCRAFT, ("left", "right"), strict=False):
        about = ("--aircraft", name, "--aircraft-type", "DEMO", "--wing", wing)
        call(wingd, "upload", str(store), "--to", url, *about)


def flights(stores: list[Path]) -> list[Flight]:
    return [Flight(recorder_of(store), "f0001") for store in stores]


def define(lake: Lake, wingd: str, installation: Path) -> None:
    solves.define(lake, "onboard", None, [], "as recorded")
    both = [({"recorder": flight.recorder, "from": None}, installation) for flight in solves.flights(lake)]
    solves.define(lake, "recalibrated", both, [], program.version(wingd))


def copy(lake: Lake, folder: Path) -> Lake:
    shutil.copytree(lake.folder, folder)
    return Lake(f"file://{folder}")


@pytest.fixture(scope="session")
def uploaded(wingd, recorders, installation, tmp_path_factory) -> Lake:
    """A lake with both flights and both solves defined, nothing solved; must not be changed."""
    url = f"file://{tmp_path_factory.mktemp('uploaded') / 'lake'}"
    upload(wingd, recorders, url)
    made = Lake(url)
    define(made, wingd, installation)
    return made


@pytest.fixture(scope="session")
def published(wingd, uploaded, tmp_path_factory) -> Lake:
    """A lake with both flights solved without errors; must not be changed."""
    folder = tmp_path_factory.mktemp("published")
    made = copy(uploaded, folder / "lake")
    for solve in SOLVES:
        for flight in solves.flights(made):
            assert task.run(made, solve, flight, wingd, folder / "work") == "done"
    return made


@pytest.fixture
def lake(uploaded, tmp_path) -> Lake:
    """A lake of the test's own with both flights and both solves, nothing solved."""
    return copy(uploaded, tmp_path / "lake")


@pytest.fixture
def solved(published, tmp_path) -> Lake:
    """A lake of the test's own with both flights in both solves."""
    return copy(published, tmp_path / "solved")


def contents(lake: Lake, *places: str) -> dict[str, bytes]:
    """Reads every object below the prefixes."""
    return {key: lake.need(key) for place in places or ("tables", "commits") for key in lake.keys(place)}


@pytest.fixture(scope="session")
def faultless(published) -> dict[str, bytes]:
    """Tables and commits of a run without failures."""
    return contents(published)


def of(faultless: dict[str, bytes], solve: str) -> dict[str, bytes]:
    return {key: data for key, data in faultless.items() if f"solve={solve}/" in key}


def state(lake: Lake) -> State:
    return State(lake)
