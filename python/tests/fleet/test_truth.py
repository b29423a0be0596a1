"""Published rows are right and unique: duplicate runs, kills between any two steps, renamed aircraft, two wings, withdrawals. No
row of a result is wrong or duplicated."""

# ruff: noqa: B023 - functions are called within the loop
from __future__ import annotations

import os
import shutil
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest

from demo.prepare import call, recorder_of
from wingd.fleet import corrections, iceberg, program, run, snapshot, solves, task
from wingd.fleet.corrections import Corrections
from wingd.fleet.desk import Desk
from wingd.fleet.lake import FleetError, Lake, Passing
from wingd.fleet.state import State

from .conftest import SOLVES, contents, copy, of
from .faults import Died, answers, deaths

FLEET = str(Path(sys.executable).with_name("wingd-fleet"))
BY = ("tests", "to see")


@pytest.fixture
def quick(monkeypatch):
    """Serves exports from memory, because these tests cover the steps around wingd, not wingd itself."""
    kept, export = {}, program.export

    def remembered(wingd, store, flight, table, inputs):
        recorder = recorder_of(store)
        if (recorder, flight, table, inputs) not in kept:
            kept[recorder, flight, table, inputs] = export(wingd, store, flight, table, inputs)
        return kept[recorder, flight, table, inputs]

    monkeypatch.setattr(program, "export", remembered)


def fresh(source: Lake, folder: Path):
    """Creates copies of a lake and removes the previous one."""

    def make() -> Lake:
        shutil.rmtree(folder, ignore_errors=True)
        return copy(source, folder)

    return make


def test_a_task_killed_at_any_step_is_done_again_and_gives_the_same(wingd, uploaded, tmp_path, faultless, quick):
    flight = solves.flights(uploaded)[0]
    wanted = {key: data for key, data in of(faultless, "onboard").items() if flight.recorder in key}

    def work(lake: Lake):
        return task.run(lake, "onboard", flight, wingd, tmp_path / "work")

    steps = 0
    for lake in deaths(fresh(uploaded, tmp_path / "lake"), work):
        steps += 1
        done = contents(lake)
        assert all(wanted[key] == data for key, data in done.items())
        whole = any(key.startswith("commits") for key in done)
        assert not whole or done == wanted, "a commit before its tables"
        assert work(lake) == ("there" if whole else "done")
        assert contents(lake) == wanted
    assert steps == 2 * 6, "five tables and the commit, before and after each"
    assert not (tmp_path / "work").exists(), "folders of killed tasks are removed"


@pytest.mark.parametrize("what", ["withdraw", "set", "compact", "prune", "define"])
def test_a_kill_at_any_step_leaves_the_answer_before_or_the_one_after(wingd, solved, installation, tmp_path, what):
    flight = solves.flights(solved)[0]
    snapshot.make(solved, tmp_path / "work")
    corrections.add(solved, "set", {"recorder": flight.recorder}, *BY, {"wing": "port"})

    def work(lake: Lake):
        if what == "withdraw":
            corrections.add(lake, what, {"recorder": flight.recorder, "flight": flight.flight}, *BY)
        elif what == "set":
            corrections.add(lake, what, {"recorder": flight.recorder}, *BY, {"aircraft": "D-NEW"})
        elif what == "define":
            rule = {"recorder": flight.recorder, "from": None}
            solves.define(lake, "third", [(rule, installation)], [], program.version(wingd))
        else:
            snapshot.make(lake, tmp_path / "work", prune=what == "prune")

    before = answers(solved)
    model = copy(solved, tmp_path / "model")
    work(model)
    after, steps = answers(model), 0
    for lake in deaths(fresh(solved, tmp_path / "dying"), work):
        steps += 1
        assert answers(lake) in (before, after)
        work(lake)
        assert answers(lake) == after
        if what in ("compact", "prune"):
            assert snapshot.current(State(lake)) is not None
    assert steps >= 4


def test_iceberg_killed_at_any_step_is_made_again(solved, tmp_path, monkeypatch):
    from pyiceberg.catalog.sql import SqlCatalog

    snapshot.make(solved, tmp_path / "work")
    before = answers(solved)
    catalogue = f"sqlite:///{tmp_path}/catalogue.db"
    steps = 0
    for step in ("create_namespace", "create_table", "commit_table"):
        for table in (1, 3):
            for after in (False, True):
                Path(tmp_path / "catalogue.db").unlink(missing_ok=True)
                whole, calls = getattr(SqlCatalog, step), []

                def dying(self, *arguments, **named):
                    calls.append(step)
                    if len(calls) == table and not after:
                        raise Died
                    done = whole(self, *arguments, **named)
                    if len(calls) == table:
                        raise Died
                    return done

                with monkeypatch.context() as patch:
                    patch.setattr(SqlCatalog, step, dying)
                    try:
                        iceberg.update(solved, iceberg.catalogue(solved, catalogue))
                    except Died:
                        steps += 1
                iceberg.update(solved, iceberg.catalogue(solved, catalogue))
                _iceberg_is(solved, catalogue, before)
    assert steps == 10, "there is one namespace"


def _iceberg_is(lake: Lake, catalogue: str, wanted: dict) -> None:
    catalog = iceberg.catalogue(lake, catalogue)
    for table, rows in wanted.items():
        content = catalog.load_table((iceberg.NAMESPACE, table)).scan().to_arrow()
        assert len(content) == sum(row[6] for row in rows), table


def test_doubled_tasks_give_the_same(wingd, lake, tmp_path, faultless):
    outcomes = []

    def work(flight):
        outcomes.append(task.run(lake, "recalibrated", flight, wingd, tmp_path / "work"))

    threads = [threading.Thread(target=work, args=(flight,)) for flight in solves.flights(lake) for _ in range(2)]
    [thread.start() for thread in threads]
    [thread.join() for thread in threads]
    assert set(outcomes) <= {"done", "there"} and len(outcomes) == 4
    assert contents(lake) == of(faultless, "recalibrated")


def test_everything_run_twice_at_once_is_there_once(wingd, lake, tmp_path, faultless):
    """Two concurrent processes each: runs, snapshots, Iceberg, the same withdrawal."""
    environment = {**os.environ, "WINGD": wingd, "HOME": str(tmp_path)}

    def twice(*command: str) -> None:
        both = [
            subprocess.Popen([FLEET, *command, "--lake", lake.url], env=environment, stdout=subprocess.PIPE, text=True)
            for _ in range(2)
        ]
        assert [(one.communicate()[0], one.returncode)[1] for one in both] == [0, 0]

    for solve in SOLVES:
        twice("run", "--solve", solve, "--workers", "2", "--work", str(tmp_path / "work"))
    assert contents(lake) == faultless
    whole = answers(lake)
    twice("compact", "--work", str(tmp_path / "work"))
    assert len(snapshot.ids(lake)) == 1 and answers(lake) == whole
    twice("iceberg", "--catalogue", f"sqlite:///{tmp_path}/catalogue.db")
    _iceberg_is(lake, f"sqlite:///{tmp_path}/catalogue.db", whole)
    gone = solves.flights(lake)[0]
    twice("withdraw", str(gone), "--why", "doubled")
    assert {row[1] for rows in answers(lake).values() for row in rows} == {solves.flights(lake)[1].recorder}
    twice("compact", "--work", str(tmp_path / "work"), "--prune")
    twice("iceberg", "--catalogue", f"sqlite:///{tmp_path}/catalogue.db")
    _iceberg_is(lake, f"sqlite:///{tmp_path}/catalogue.db", answers(lake))


def test_an_aircraft_under_another_name_is_no_other_flight(wingd, recorders, solved, tmp_path):
    before = answers(solved)
    arguments = ("upload", str(recorders[0]), "--to", solved.url, "--aircraft", "DDEMA")
    said = call(wingd, *arguments, check=False)
    assert said.returncode == 1 and "D-DEMA" in said.stderr and "wingd-fleet correct" in said.stderr
    assert len(solves.flights(solved)) == 2 and answers(solved) == before
    flight = next(f for f in solves.flights(solved) if f.recorder == recorder_of(recorders[0]))
    corrections.add(solved, "set", {"recorder": flight.recorder}, *BY, {"aircraft": "DDEMA"})
    for rows in answers(solved).values():
        assert {row[3] for row in rows if row[1] == flight.recorder} == {"DDEMA"}
        assert sorted(row[6:] for row in rows) == sorted(row[6:] for row in before[_table(rows, before)])
    # The type of an aircraft after correction; in snapshots written before and after.
    corrections.add(solved, "set", {"aircraft": "DDEMA"}, *BY, {"aircraft_type": "A321"})
    corrections.add(solved, "set", {"aircraft": "D-DEMA"}, *BY, {"aircraft_type": "WRONG"})
    for _ in range(2):
        kinds = {(row[3], row[4]) for row in answers(solved)["shots"]}
        assert kinds == {("DDEMA", "A321"), ("D-DEMB", "DEMO")}
        snapshot.make(solved, tmp_path / "work")


def _table(rows: list, of: dict) -> str:
    return next(
        name for name, other in of.items() if len(other) == len(rows) and [r[6] for r in other] == [r[6] for r in rows]
    )


def test_recorders_that_nobody_named_are_aircraft_of_their_own(wingd, recorders, tmp_path):
    url = f"file://{tmp_path / 'lake'}"
    for store in recorders:
        call(wingd, "upload", str(store), "--to", url)
    state = State(Lake(url))
    names = {state.about(flight).aircraft for flight in state.flights}
    assert names == {f"recorder-{recorder_of(store)[:8]}" for store in recorders}


def test_two_wings_of_an_aircraft_have_their_own_installations(wingd, lake, recorders, installation, tmp_path):
    left, right = (recorder_of(store) for store in recorders)
    own = recorders[1].parent / "input/installation"
    for flight in solves.flights(lake):
        corrections.add(lake, "set", {"recorder": flight.recorder}, *BY, {"aircraft": "D-TWO"})
    rules = solves.rules(lake, [f"{left[:8]}={installation}", f"{right}={own}"])
    solves.define(lake, "wings", rules, [], program.version(wingd))
    for flight in solves.flights(lake):
        task.run(lake, "wings", flight, wingd, tmp_path / "work")
    rows = Desk(lake, ["wings"]).rows("SELECT aircraft, wing, deflection_m FROM deflection_by_aircraft ORDER BY wing")
    assert [(row["aircraft"], row["wing"]) for row in rows] == [("D-TWO", "left"), ("D-TWO", "right")]
    assert abs(rows[0]["deflection_m"] - rows[1]["deflection_m"]) > 1e-4, (
        "the other calibration is of the left one alone"
    )


def test_a_re_survey_holds_from_a_flight_or_a_date_on(uploaded):
    one = solves.flights(uploaded)[0].recorder

    def definition(*since):
        return {"solve": "s", "installations": [{"recorder": one, "from": f, "digest": str(f)} for f in since]}

    flight = solves.flights(uploaded)[0].__class__
    by_flight, by_date = definition(None, "f0012", "f0100"), definition("2026-11-01", "2026-12-01")
    for number, digest in (("f0001", "None"), ("f0012", "f0012"), ("f0099", "f0012"), ("f0100", "f0100")):
        assert solves.choose(by_flight, flight(one, number), "2026-01-01T00:00:00Z") == digest
    for day, digest in (("2026-11-01", "2026-11-01"), ("2026-11-30", "2026-11-01"), ("2026-12-01", "2026-12-01")):
        assert solves.choose(by_date, flight(one, "f0001"), f"{day}T08:00:00Z") == digest
    with pytest.raises(FleetError, match="before 2026-11-01"):
        solves.choose(by_date, flight(one, "f0001"), "2026-10-31T23:59:59Z")


def test_what_is_refused_of_a_definition_is_said(wingd, lake, recorders, installation):
    one = recorder_of(recorders[0])
    own = recorders[0].parent / "input/installation"
    for texts, words in (
        (["D-DEMA=x"], "two wings"),
        ([f"{one}=x", f"{one[:6]}=y"], "two from the start"),
        ([f"{one}@f0002=x", f"{one}@2026-11-01=y"], "one kind"),
        ([f"{one}@soon=x"], "@2026-11-01"),
        ([one], "RECORDER=DIR"),
    ):
        with pytest.raises(FleetError, match=words):
            solves.rules(lake, texts)
    before = contents(lake, "solves")
    with pytest.raises(FleetError, match="another solve already: installations .*nothing was changed"):
        solves.define(lake, "recalibrated", [({"recorder": one, "from": None}, own)], [], program.version(wingd))
    assert contents(lake, "solves") == before


def test_what_is_withdrawn_is_gone_and_does_not_come_back(wingd, recorders, solved, tmp_path):
    gone, stays = solves.flights(solved)
    snapshot.make(solved, tmp_path / "work")
    before = answers(solved)
    corrections.add(solved, "withdraw", {"recorder": gone.recorder, "flight": gone.flight}, "Ada", "the wrong cable")
    left = {table: [row for row in rows if row[1] == stays.recorder] for table, rows in before.items()}
    assert answers(solved) == left
    with pytest.raises(FleetError, match="compact"):
        from wingd.fleet import desk

        desk.files(solved, "shots", None, tmp_path / "cache")
    # Not by the next run, not by another upload, not by a new snapshot.
    for solve in SOLVES:
        assert State(solved).missing(solve) == []
        assert sum(run.run(solved, solve, [gone], wingd, tmp_path / "work", 1, said=str).values()) == 1
    store = next(store for store in recorders if recorder_of(store) == gone.recorder)
    call(wingd, "upload", str(store), "--to", solved.url)
    snapshot.make(solved, tmp_path / "work", prune=True)
    assert answers(solved) == left
    (record,) = Corrections.read(solved).records
    assert (record["by"], record["why"]) == ("Ada", "the wrong cable")
    corrections.add(
        solved, "restore", {"recorder": gone.recorder, "flight": gone.flight}, "Ada", "it was the right one"
    )
    assert answers(solved) == before


def test_a_solve_is_withdrawn_as_a_whole_or_of_a_flight(wingd, solved, lake, tmp_path):
    one, other = solves.flights(solved)
    corrections.add(solved, "withdraw", {"solve": "recalibrated", "recorder": one.recorder, "flight": one.flight}, *BY)
    found = {(row[0], row[1]) for row in answers(solved)["shots"]}
    assert found == {("onboard", one.recorder), ("onboard", other.recorder), ("recalibrated", other.recorder)}
    corrections.add(solved, "withdraw", {"solve": "recalibrated"}, *BY)
    assert {row[0] for row in answers(solved)["shots"]} == {"onboard"}
    # No task creates tables of a withdrawn flight without tables.
    corrections.add(lake, "withdraw", {"recorder": one.recorder, "flight": one.flight}, *BY)
    assert State(lake).missing("onboard") == [other]
    assert task.run(lake, "onboard", one, wingd, tmp_path / "work") == "withdrawn"


def test_what_has_not_arrived_is_not_solved_and_said(wingd, lake, tmp_path):
    flight = solves.flights(lake)[0]
    lake.delete([flight.mark("frames")])
    assert State(lake).arrived(flight) == "results"
    assert flight in State(lake).missing("onboard") and flight not in State(lake).missing("recalibrated")
    with pytest.raises(Passing, match="not arrived"):
        task.run(lake, "recalibrated", flight, wingd, tmp_path / "work")
    assert task.run(lake, "onboard", flight, wingd, tmp_path / "work") == "done"
    assert any("not completely uploaded" in text for text in Desk(lake).incomplete())


def test_a_driver_that_is_ended_leaves_no_process_and_no_folder(wingd, lake, tmp_path):
    work = tmp_path / "work"
    environment = {**os.environ, "WINGD": wingd, "HOME": str(tmp_path)}
    for number in (signal.SIGTERM, signal.SIGKILL):
        command = [FLEET, "run", "--lake", lake.url, "--solve", "recalibrated", "--workers", "2", "--work", str(work)]
        driver = subprocess.Popen(command, env=environment, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        end = time.monotonic() + 30
        while not _below(work) and driver.poll() is None and time.monotonic() < end:
            time.sleep(0.01)
        driver.send_signal(number)
        driver.wait(30)
        time.sleep(0.3)
        assert not _below(work), "a wingd lives on"
        if number == signal.SIGTERM:
            assert not work.exists()
    for flight in solves.flights(lake):
        task.run(lake, "recalibrated", flight, wingd, work)
    assert not work.exists(), "what the killed one left is removed by the next"


def _below(work: Path) -> list[str]:
    """Returns processes whose command line contains a folder."""
    found = []
    for place in Path("/proc").glob("[0-9]*/cmdline"):
        try:
            text = place.read_bytes().decode(errors="replace")
        except OSError:
            continue
        if str(work) in text and "wingd-fleet" not in text:
            found.append(text)
    return found
