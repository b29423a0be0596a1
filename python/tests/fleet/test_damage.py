"""A flipped bit in each kind of object, and each kind missing: no wrong result, the object is named and repaired."""

from __future__ import annotations

import random
import re

import pytest

from demo.prepare import call, recorder_of
from wingd.fleet import corrections, damage, program, records, snapshot, solves, task
from wingd.fleet.lake import Damaged, FleetError, Lake

from .conftest import copy
from .faults import answers, flip

SEED = 56
# Kinds of objects, by the beginning and the end of their keys.
KINDS = [
    "manifests/.*/manifest.json",
    "manifests/.*/results.json",
    "manifests/.*/frames.json",
    "flights/.*/results.jsonl",
    "flights/.*/store.toml",
    "frames/.*jpg",
    "installations/.*survey.csv",
    "solves/.*json",
    "copies/solves/.*json",
    "corrections/.*json",
    "copies/corrections/.*json",
    "tables/.*/shots/.*parquet",
    "tables/.*/markers/.*parquet",
    "commits/.*json",
    "failures/.*json",
    "snapshots/.*manifest.json",
    "snapshots/.*/shots/.*parquet",
]


@pytest.fixture(scope="module")
def full(wingd, published, tmp_path_factory) -> Lake:
    """A lake with an object of every kind; must not be changed."""
    folder = tmp_path_factory.mktemp("full")
    lake = copy(published, folder / "lake")
    flight = solves.flights(lake)[0]
    nobody = [({"recorder": "0" * 32, "from": None}, folder)]
    definition = {"solve": "nobody", "installations": [], "arguments": [], "program": program.version(wingd)}
    assert nobody and records.create_twice(lake, solves.key("nobody"), records.dump(definition))
    with pytest.raises(FleetError, match="no installation"):
        task.run(lake, "nobody", flight, wingd, folder / "work")
    # The snapshot has the tables of one flight only; those of the other are read directly.
    other = solves.flights(lake)[1]
    corrections.add(lake, "withdraw", {"recorder": other.recorder, "flight": other.flight}, "tests", "to see")
    snapshot.make(lake, folder / "work")
    corrections.add(lake, "restore", {"recorder": other.recorder, "flight": other.flight}, "tests", "to see")
    assert damage.verify(lake) == []
    return lake


@pytest.mark.parametrize("gone", [False, True], ids=["flipped", "gone"])
@pytest.mark.parametrize("kind", KINDS)
def test_what_is_damaged_or_gone_is_named_and_never_answered_from(
    wingd, full, recorders, installation, tmp_path, kind, gone
):
    lake = copy(full, tmp_path / "lake")
    wanted = answers(full)
    keys = [key for key in lake.keys("") if re.fullmatch(kind, key)]
    assert keys, f"there is no object of the kind {kind}"
    key = random.Random(f"{SEED} {kind}").choice(keys)
    path = lake.folder / key
    path.unlink() if gone else flip(path, random.Random(f"{SEED} {kind} {gone}"))
    _answers_rightly_or_names(lake, key, wanted)
    faults = damage.verify(lake)
    # A missing snapshot or failure record is not a fault.
    silent = gone and re.match("snapshots/.*manifest|failures", key)
    assert silent or any(_names(str(fault), key) for fault in faults), faults
    left = damage.repair(lake, faults, wingd, tmp_path / "work")
    assert all(fault.kind in ("upload", "installation") for fault in left), left
    for store in recorders if left else []:
        call(wingd, "upload", str(store), "--to", lake.url, "--repair")
    if any(fault.kind == "installation" for fault in left):
        both = [({"recorder": recorder_of(store), "from": None}, installation) for store in recorders]
        solves.define(lake, "recalibrated", both, [], program.version(wingd))
    assert damage.verify(lake) == []
    assert answers(lake) == wanted


def _names(text: str, key: str) -> bool:
    """Returns whether a text names the object: an installation as a whole, a lost commit by its key."""
    return key in text or (key.startswith("installations/") and key.rsplit("/", 1)[0] in text)


def _answers_rightly_or_names(lake: Lake, key: str, wanted: dict) -> None:
    try:
        found = answers(lake)
    except Damaged as error:
        assert _names(str(error), key), error
        return
    if found != wanted:
        # Fewer rows, never wrong ones; and the flight without tables is reported.
        from wingd.fleet.desk import Desk

        for table, rows in found.items():
            assert set(rows) < set(wanted[table])
        assert any(re.search(r"no tables yet of 1 flights", text) for text in Desk(lake).incomplete())


def test_a_task_takes_nothing_that_was_changed(wingd, lake, tmp_path):
    flight = solves.flights(lake)[0]
    flip(lake.folder / flight.file(f"flights/{flight.flight}/s000001/0001.jpg"), random.Random(1))
    with pytest.raises(Damaged, match="0001.jpg: is damaged"):
        task.run(lake, "recalibrated", flight, wingd, tmp_path / "work")
    assert lake.keys("tables") == [] and lake.keys("failures") == []


def test_a_stranger_among_a_flights_files_is_named(wingd, solved, tmp_path):
    solved.create(solves.flights(solved)[0].file("notes.txt"), b"mine")
    (fault,) = damage.verify(solved)
    assert fault.kind == "foreign" and "notes.txt" in fault.key
    assert damage.repair(solved, [fault], wingd, tmp_path / "work") == [fault]


def test_frames_that_a_rule_has_aged_are_no_damage_to_what_is_kept(wingd, solved, recorders, tmp_path):
    wanted = answers(solved)
    solved.delete(solved.keys("frames"))
    assert answers(solved) == wanted
    assert damage.verify(solved, frames=False) == []
    assert len(damage.verify(solved)) == 20
    said = call(wingd, "upload", str(recorders[0]), "--to", solved.url)
    assert "10 frames expired at the destination" in said.stdout and solved.keys("frames") == []


def test_another_processors_rounding_is_another_commit(wingd, solved, tmp_path, monkeypatch):
    """The tables cannot be recreated bit for bit: new ones are published as the next commit, and only they are read."""
    import numpy as np
    import pyarrow as pa

    flight = solves.flights(solved)[0]
    export = program.export

    def rounded(wingd, store, flight, table, inputs):
        content = export(wingd, store, flight, table, inputs)
        if table == "shots":
            place = content.column_names.index("tip_deflection_m")
            deflections = np.nextafter(content["tip_deflection_m"].to_numpy(), np.inf)
            content = content.set_column(place, "tip_deflection_m", pa.array(deflections))
        return content

    monkeypatch.setattr(program, "export", rounded)
    before = answers(solved)
    key = next(key for key in solved.keys("tables/v3/shots/solve=onboard") if flight.recorder in key)
    flip(solved.folder / key, random.Random(2))
    assert damage.repair(solved, damage.verify(solved), wingd, tmp_path / "work") == []
    assert len(task.commits(solved, "onboard", flight)) == 2
    assert answers(solved) == before, "to nine digits"


def test_a_fault_that_nobody_can_mend_is_left_and_named(wingd, solved, tmp_path):
    flight = solves.flights(solved)[0]
    solved.delete([key for key in solved.keys(f"flights/{flight.place}") if key.endswith("results.jsonl")])
    solved.delete([key for key in solved.keys("tables/v3/shots/solve=onboard") if flight.recorder in key])
    left = damage.repair(solved, damage.verify(solved), wingd, tmp_path / "work")
    assert any("results.jsonl" in str(fault) and "wingd upload --repair" in str(fault) for fault in left)
    corrections.add(solved, "withdraw", {"recorder": flight.recorder, "flight": flight.flight}, "tests", "lost")
    assert {row[1] for row in answers(solved)["shots"]} == {solves.flights(solved)[1].recorder}
