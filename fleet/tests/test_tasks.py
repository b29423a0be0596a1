"""One flight, one task: whatever dies, is lost or done twice, the tables are those of a run without faults."""

from __future__ import annotations

import os
import random
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest

from wingd_fleet import parquet, program, ray_driver, slurm, solves, task
from wingd_fleet.lake import FleetError, Lake, Passing, sha256

from .conftest import contents, define, upload

KILLS = 12


class Died(BaseException):
    """As when the power goes: no handler of the task's own sees it."""


STEPS = ["fetch", "solve", "export", *(f"publish {t}" for t in ("shots", "markers", "parameters", "span")), "commit"]


def test_a_task_that_dies_at_any_step_is_done_again_and_gives_the_same(wingd, lake, tmp_path, faultless):
    for flight in lake.flights():
        for step in STEPS:

            def die(now: str) -> None:
                if now == step:
                    raise Died(step)

            with pytest.raises(Died):
                task.run(lake, "recalibrated", flight, wingd, tmp_path / "work", at=die)
            assert flight not in lake.committed().get("recalibrated", [])
        assert task.run(lake, "recalibrated", flight, wingd, tmp_path / "work") == "done"
        assert task.run(lake, "recalibrated", flight, wingd, tmp_path / "work") == "there"
    made = {key: data for key, data in faultless.items() if "solve=recalibrated" in key}
    assert len(made) == 10 and contents(lake) == made


def test_doubled_tasks_give_the_same(wingd, lake, tmp_path, faultless):
    outcomes = []

    def work(flight):
        outcomes.append(task.run(lake, "recalibrated", flight, wingd, tmp_path / "work"))

    threads = [threading.Thread(target=work, args=(flight,)) for flight in lake.flights() for _ in range(3)]
    [thread.start() for thread in threads]
    [thread.join() for thread in threads]
    assert sorted(outcomes).count("done") == 2 and len(outcomes) == 6
    assert contents(lake) == {key: data for key, data in faultless.items() if "solve=recalibrated" in key}


def test_killed_workers_of_ray_give_the_same(wingd, recorders, installation, server, tmp_path, faultless):
    """Through the S3 server. Workers are killed at random while they have work."""
    url = "s3://fleet/killed"
    upload(wingd, recorders, url)
    lake = Lake(url)
    define(lake, wingd, installation)
    work, chance = tmp_path / "work", random.Random(5)
    killed, stop = [], threading.Event()

    def kill() -> None:
        while not stop.is_set() and len(killed) < KILLS:
            time.sleep(chance.uniform(0.05, 0.8))
            folders = list(work.glob("worker-*/f*")) if work.exists() else []
            if folders:
                worker = int(chance.choice(folders).parent.name.removeprefix("worker-"))
                try:
                    os.kill(worker, signal.SIGKILL)
                    killed.append(worker)
                except ProcessLookupError:
                    pass

    killer = threading.Thread(target=kill)
    killer.start()
    counts = {}
    try:
        for solve in ("onboard", "recalibrated"):
            # Each flight twice: as when a lost node's task is begun anew and the node was not lost.
            flights = [flight for flight in lake.flights() for _ in range(2)]
            counts[solve] = ray_driver.run(url, solve, flights, wingd, work, workers=2, said=lambda text: None)
    finally:
        stop.set()
        killer.join()
    print(f"killed: {len(killed)}")
    assert killed, "no worker was caught at work"
    assert all(count["failed"] == 0 for count in counts.values()), counts
    assert contents(lake) == faultless
    assert not work.exists(), "what killed workers left is removed"


def test_a_slurm_array_gives_the_same(wingd, lake, tmp_path, faultless):
    fleet = str(Path(sys.executable).with_name("wingd-fleet"))
    script, elements = slurm.write(tmp_path / "array", lake.url, "recalibrated", lake.flights(), wingd, fleet, 1, 1)
    assert elements == 2
    for element in ("1", "0", "1"):
        environment = {**os.environ, "SLURM_ARRAY_TASK_ID": element, "SLURM_TMPDIR": str(tmp_path)}
        subprocess.run(["bash", str(script)], env=environment, check=True, capture_output=True)
    assert contents(lake) == {key: data for key, data in faultless.items() if "solve=recalibrated" in key}


def test_slurm_chunks_take_every_flight_once(lake, tmp_path):
    flights = lake.flights() * 5
    script, elements = slurm.write(tmp_path, lake.url, "s", flights, "/bin/wingd", "echo", 3, 1)
    seen = []
    for element in range(elements):
        environment = {**os.environ, "SLURM_ARRAY_TASK_ID": str(element)}
        done = subprocess.run(["bash", str(script)], env=environment, check=True, capture_output=True, text=True)
        seen += [line.rsplit(" ", 1)[1] for line in done.stdout.splitlines()]
    assert seen == [str(flight) for flight in flights]


def test_a_flight_that_cannot_be_solved_says_why_and_has_no_tables(wingd, lake, recorders, tmp_path):
    flight = lake.flights()[0]
    only = {"D-OTHER": next(recorders[0].parent.glob("input/installation"))}
    solves.define(lake, "partial", only, [], program.version(wingd))
    for _ in range(2):
        with pytest.raises(FleetError, match="no installation for D-DEMA"):
            task.run(lake, "partial", flight, wingd, tmp_path / "work")
    said = lake.failures("partial")
    assert len(said[flight]) == 1 and "D-DEMA" in said[flight][0]["reason"]
    assert contents(lake) == {}


def test_an_object_that_was_changed_is_not_solved(wingd, lake, tmp_path):
    flight = lake.flights()[0]
    frame = lake.folder / flight.file(f"flights/{flight.flight}/s000001/0001.jpg")
    frame.write_bytes(frame.read_bytes()[:-1] + b"x")
    with pytest.raises(FleetError, match="not what the manifest says"):
        task.run(lake, "recalibrated", flight, wingd, tmp_path / "work")
    assert contents(lake) == {}


def test_a_name_stands_for_one_solve(wingd, lake, installation):
    with pytest.raises(FleetError, match="another solve already"):
        solves.define(lake, "recalibrated", {"D-DEMA": installation}, [], program.version(wingd))
    define(lake, wingd, installation)


def test_another_program_is_not_mixed_in(wingd, lake, installation, tmp_path):
    solves.define(lake, "older", {"D-DEMA": installation}, [], "wingd 0.0.9")
    with pytest.raises(Passing, match="is of wingd 0.0.9"):
        task.run(lake, "older", lake.flights()[0], wingd, tmp_path / "work")


def test_the_tables_are_of_the_results_that_were_asked_for(wingd, lake, recorders, tmp_path):
    """Also where the flight came with results of another installation that are newer."""
    flight = lake.flights()[0]
    own = recorders[0].parent / "input/installation"
    solves.define(lake, "own", {flight.aircraft: own}, [], program.version(wingd))
    solves.define(lake, "profile", {flight.aircraft: own}, ["--method", "profile"], program.version(wingd))
    import pyarrow.parquet as pq

    def column(solve, name):
        task.run(lake, solve, flight, wingd, tmp_path / "work")
        return pq.read_table(lake.folder / flight.table("shots", solve))[name].to_pylist()

    assert set(column("profile", "method")) == {"profile"}
    assert set(column("recalibrated", "method")) == {"spatial"}
    assert column("own", "inputs") == column("onboard", "inputs") != column("recalibrated", "inputs")
    assert column("own", "tip_lift_m") == column("onboard", "tip_lift_m")


def test_a_table_of_other_rows_is_never_taken_for_this_one(wingd, lake, tmp_path, faultless):
    flight = lake.flights()[0]
    key = flight.table("shots", "recalibrated")
    import io

    import pyarrow.parquet as pq

    fewer = pq.read_table(io.BytesIO(faultless[key])).slice(1)
    lake.create(key, parquet.write(fewer))
    with pytest.raises(FleetError, match="other rows or inputs"):
        task.run(lake, "recalibrated", flight, wingd, tmp_path / "work")
    assert lake.committed() == {}


def test_rounding_of_another_processor_stays_and_is_what_the_commit_names(wingd, lake, tmp_path, faultless):
    flight = lake.flights()[0]
    key = flight.table("shots", "recalibrated")
    import io

    import numpy as np
    import pyarrow as pa
    import pyarrow.parquet as pq

    content = pq.read_table(io.BytesIO(faultless[key]))
    place = content.schema.get_field_index("tip_lift_m")
    rounded = np.nextafter(content["tip_lift_m"].to_numpy(), np.inf)
    data = parquet.write(content.set_column(place, "tip_lift_m", pa.array(rounded)))
    lake.create(key, data)
    assert task.run(lake, "recalibrated", flight, wingd, tmp_path / "work") == "done"
    assert lake.need(key) == data
    assert lake.json(flight.commit("recalibrated"))["tables"]["shots"]["sha256"] == sha256(data)


def test_a_lake_that_refuses_is_said_in_a_line_without_secrets(server):
    fleet = str(Path(sys.executable).with_name("wingd-fleet"))
    secrets = {"AWS_ACCESS_KEY_ID": "KEY-OF-A-USER", "AWS_SECRET_ACCESS_KEY": "secret-of-a-user"}
    environment = {**os.environ, **secrets, "AWS_REGION": "here"}
    for place, status in (("s3://fleet/x", 1), ("http://fleet", 1)):
        environment["AWS_ENDPOINT_URL"] = server.environment["AWS_ENDPOINT_URL"]
        command = [fleet, "flights", "--lake", place]
        done = subprocess.run(command, env=environment, capture_output=True, text=True)
        assert done.returncode == status and len(done.stderr.splitlines()) == 1, done.stderr
        assert not any(secret in done.stderr for secret in secrets.values())
