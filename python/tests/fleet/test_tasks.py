"""One flight, one task, by any queue: the tables equal those of a run without faults."""

from __future__ import annotations

import json
import os
import random
import secrets
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import pyarrow.parquet as pq
import pytest

from demo.prepare import call, recorder_of
from wingd.fleet import program, run, solves, task
from wingd.fleet.lake import FleetError, Lake, Passing
from wingd.fleet.state import State

from .conftest import contents, define, of, upload

KILLS = 8
FLEET = str(Path(sys.executable).with_name("wingd-fleet"))


def test_killed_workers_give_the_same(wingd, recorders, installation, server, tmp_path, faultless):
    """Tasks through the S3 server, as with xargs. Workers are killed at random while busy; the others continue."""
    url = "s3://fleet/killed"
    upload(wingd, recorders, url)
    lake = Lake(url)
    define(lake, wingd, installation)
    work, chance, killed = tmp_path / "work", random.Random(5), 0
    environment = {**os.environ, "WINGD": wingd, "HOME": str(tmp_path)}
    for solve in ("onboard", "recalibrated"):
        while flights := State(lake).missing(solve):
            # Each flight twice, as if the task of a seemingly lost node was started again.
            commands = [
                [FLEET, "task", "--lake", url, "--solve", solve, "--work", str(work), "--flight", str(f)]
                for f in flights * 2
            ]
            workers = [subprocess.Popen(command, env=environment, stdout=subprocess.DEVNULL) for command in commands]
            if killed < KILLS:
                time.sleep(chance.uniform(0.3, 2.5))
                for worker in chance.sample(workers, 2):
                    worker.kill()
                    killed += 1
            assert all(worker.wait(120) in (0, -signal.SIGKILL) for worker in workers)
    assert killed, "no worker was caught at work"
    assert contents(lake) == faultless
    with task.Folder(work) as folder:
        assert sorted(work.iterdir()) == sorted([folder, folder.with_suffix(".lock")]), (
            "what killed workers left is removed"
        )


def test_any_queue_does(wingd, lake, tmp_path, faultless):
    """Command lines of docs/fleet.md: xargs, and an array job whose elements know their number."""
    environment = {
        **os.environ,
        "WINGD": wingd,
        "HOME": str(tmp_path),
        "PATH": f"{Path(FLEET).parent}:{os.environ['PATH']}",
    }
    script = (
        f"wingd-fleet flights --lake {lake.url} --solve recalibrated | "
        f"xargs -P 2 -I{{}} wingd-fleet task --lake {lake.url} --solve recalibrated --flight {{}}"
    )
    subprocess.run(["sh", "-euc", script], env=environment, check=True, capture_output=True)
    for element in ("2/3", "0/3", "1/3", "0/3"):
        command = [FLEET, "run", "--lake", lake.url, "--solve", "onboard", "--part", element, "--workers", "1"]
        subprocess.run(command, env=environment, check=True, capture_output=True)
    assert contents(lake) == faultless


def test_a_ray_cluster_does_as_well(wingd, lake, tmp_path, faultless):
    ray = pytest.importorskip("ray")
    assert ray.__version__
    code = (
        "import ray, sys; ray.init(num_cpus=2, include_dashboard=False, _node_ip_address='127.0.0.1', _temp_dir=sys.argv[1]);"
        "print(ray.get_runtime_context().gcs_address, flush=True); sys.stdin.read(); ray.shutdown()"
    )
    folder = Path("/tmp") / f"fleet-ray-{os.getpid()}"
    environment = {**os.environ, "WINGD": wingd, "RAY_AUTH_MODE": "token", "RAY_AUTH_TOKEN": secrets.token_hex(32)}
    cluster = subprocess.Popen(
        [sys.executable, "-c", code, str(folder)],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
        stderr=subprocess.DEVNULL,
        env=environment,
    )
    try:
        address = cluster.stdout.readline().strip()
        command = [
            FLEET,
            "run",
            "--lake",
            lake.url,
            "--solve",
            "recalibrated",
            "--ray",
            address,
            "--work",
            str(tmp_path / "work"),
        ]
        done = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=300)
        assert done.returncode == 0, done.stdout + done.stderr
    finally:
        cluster.stdin.close()
        cluster.wait(60)
        subprocess.run(["rm", "-rf", str(folder)], check=True)
    assert contents(lake) == of(faultless, "recalibrated")


def test_parts_take_every_flight_once(uploaded):
    flights = [solves.flights(uploaded)[0].__class__(f"{n:032x}", "f0001") for n in range(200)]
    parts = [run.part(flights, f"{n}/7") for n in range(7)]
    assert sorted(one for part in parts for one in part) == sorted(flights) and min(map(len, parts)) > 10
    for wrong in ("7/7", "x/2", "3", "1/0"):
        with pytest.raises(FleetError, match="I/N"):
            run.part(flights, wrong)


def test_a_flight_that_cannot_be_solved_says_why_and_has_no_tables(wingd, lake, recorders, tmp_path):
    flight = solves.flights(lake)[0]
    other = next(store for store in recorders if recorder_of(store) != flight.recorder)
    rule = ({"recorder": recorder_of(other), "from": None}, other.parent / "input/installation")
    solves.define(lake, "partial", [rule], [], program.version(wingd))
    for _ in range(2):
        with pytest.raises(FleetError, match=f"no installation for recorder {flight.recorder}"):
            task.run(lake, "partial", flight, wingd, tmp_path / "work")
    assert len(State(lake).failures("partial")[flight]) == 1
    assert contents(lake) == {}


def test_another_program_is_not_mixed_in(wingd, lake, installation, tmp_path):
    solves.define(
        lake, "older", [({"recorder": solves.flights(lake)[0].recorder, "from": None}, installation)], [], "wingd 0.0.9"
    )
    with pytest.raises(Passing, match="is of wingd 0.0.9"):
        task.run(lake, "older", solves.flights(lake)[0], wingd, tmp_path / "work")


def test_the_tables_are_of_the_results_that_were_asked_for(wingd, lake, recorders, tmp_path):
    """Also if the flight was uploaded with newer results of another installation; the recorder solves single frames."""
    flight = next(one for one in solves.flights(lake) if one.recorder == recorder_of(recorders[1]))
    own = [({"recorder": flight.recorder, "from": None}, recorders[1].parent / "input/installation")]
    solves.define(lake, "own", own, ["--single"], program.version(wingd))
    solves.define(lake, "profile", own, ["--method", "profile"], program.version(wingd))

    def column(solve, name):
        task.run(lake, solve, flight, wingd, tmp_path / "work")
        (one,) = [one for one in State(lake).published([solve]) if one.flight == flight]
        return pq.read_table(lake.folder / one.tables["shots"].key)[name].to_pylist()

    assert set(column("profile", "method")) == {"profile"}
    assert set(column("recalibrated", "method")) == {"spatial"}
    assert column("own", "inputs") == column("onboard", "inputs") != column("recalibrated", "inputs")
    assert column("own", "tip_deflection_m") == column("onboard", "tip_deflection_m")


SAID = {
    "key": ({"AWS_ACCESS_KEY_ID": "KEY-OF-A-USER"}, "AWS_ACCESS_KEY_ID"),
    "secret": ({"AWS_SECRET_ACCESS_KEY": "secret-of-a-user"}, "AWS_SECRET_ACCESS_KEY"),
    "endpoint": ({"AWS_ENDPOINT_URL": "http://127.0.0.1:9"}, "AWS_ENDPOINT_URL"),
    "name": ({"AWS_ENDPOINT_URL": "http://no-such-host.invalid"}, "AWS_ENDPOINT_URL"),
    "bucket": ({}, "bucket does not exist"),
    "nothing": ({"AWS_ACCESS_KEY_ID": "", "AWS_SECRET_ACCESS_KEY": ""}, "not both set"),
}


@pytest.mark.parametrize("what", SAID)
@pytest.mark.parametrize("who", ["wingd", "wingd-fleet"])
def test_errors_of_a_bucket_are_distinguished_within_3_s(wingd, recorders, server, what, who):
    changed, words = SAID[what]
    environment = {**os.environ, **server.environment, **changed}
    place = "s3://no-such-bucket/x" if what == "bucket" else "s3://fleet/x"
    command = (
        [wingd, "upload", str(recorders[0]), "--to", place] if who == "wingd" else [FLEET, "flights", "--lake", place]
    )
    begun = time.monotonic()
    done = subprocess.run(command, env=environment, capture_output=True, text=True)
    took = time.monotonic() - begun
    # SeaweedFS creates a requested bucket if the key permits it.
    if what != "bucket" or done.returncode:
        assert done.returncode in (1, 78) and words in done.stderr, done.stderr
    assert took < 3, f"{took:.1f} s"
    assert "Traceback" not in done.stderr
    assert not any(
        secret in done.stdout + done.stderr for secret in ("secret-of-a-user", "KEY-OF-A-USER", server.secret)
    )


def test_mistakes_are_said_in_a_line(wingd, solved, tmp_path):
    environment = {**os.environ, "HOME": str(tmp_path), "WINGD": wingd}
    readonly = tmp_path / "file"
    readonly.touch()
    for command in (
        ["query", "--lake", solved.url, "SELECT nonsense FROM frames"],
        ["query", "--lake", solved.url, "SELECT 'x'::INT FROM frames"],
        ["report", "--lake", solved.url, "--output", str(readonly / "below")],
        ["flights", "--lake", f"file://{readonly}/below"],
        ["flights", "--lake", "http://fleet"],
        ["withdraw", "--lake", solved.url, "nobody/f0001", "--why", "x"],
        ["correct", "--lake", solved.url, "aircraft=D-DEMA", "--set", "colour=red", "--why", "x"],
        ["run", "--lake", solved.url, "--solve", "unknown"],
        ["files", "--lake", solved.url, "--table", "unknown"],
    ):
        done = subprocess.run([FLEET, *command], env=environment, capture_output=True, text=True)
        assert done.returncode == 1 and len(done.stderr.splitlines()) == 1, (command, done.stderr)
        assert done.stderr.startswith("wingd-fleet: ")


def test_nobody_reading_on_is_no_fault(solved, tmp_path):
    environment = {**os.environ, "HOME": str(tmp_path)}
    for sql in ("--csv", ""):
        question = f"{FLEET} query --lake {solved.url} {sql} 'SELECT m.* FROM markers m, range(200)' | head -1"
        done = subprocess.run(
            ["bash", "-c", f"set -o pipefail; {question}"], env=environment, capture_output=True, text=True
        )
        assert "Traceback" not in done.stderr and "Broken" not in done.stderr, done.stderr


def test_no_metadata_address_is_asked_unless_wished_for(wingd, recorders, tmp_path):
    """Without credentials the libraries would request some from the metadata address."""
    environment = {k: v for k, v in os.environ.items() if not k.startswith("AWS_")} | {"HOME": str(tmp_path)}
    for command in ([FLEET, "flights", "--lake", "s3://b/x"], [wingd, "upload", str(recorders[0]), "--to", "s3://b/x"]):
        begun = time.monotonic()
        done = subprocess.run(command, env=environment, capture_output=True, text=True)
        assert done.returncode in (1, 78) and "AWS_EC2_METADATA_DISABLED=false" in done.stderr
        assert time.monotonic() - begun < 3


def test_a_flight_is_fetched_as_a_sound_store(wingd, lake, tmp_path):
    flight = solves.flights(lake)[0]
    target = tmp_path / "back"
    command = [FLEET, "fetch", "--lake", lake.url, "--flight", str(flight), "--to", str(target)]
    subprocess.run(command, check=True, capture_output=True)
    assert call(wingd, "verify", str(target)).returncode == 0
    assert json.loads(lake.need(flight.manifest))["digest"]


def test_threads_of_one_driver_give_the_same(wingd, lake, tmp_path, faultless):
    others = threading.active_count()
    counts = run.run(lake, "onboard", solves.flights(lake) * 3, wingd, tmp_path / "work", workers=3, said=str)
    assert counts["done"] + counts["there"] == 6 and not counts["failed"] and threading.active_count() <= others
    assert contents(lake) == of(faultless, "onboard")
