"""`wingd upload`: every object once despite interruptions; nothing overwritten; no secret printed."""

from __future__ import annotations

import json
import os
import random
import shutil
import subprocess
import time
from pathlib import Path

import pytest

from demo.prepare import call, recorded
from demo.server import BUCKET
from wingd.fleet import solves
from wingd.fleet.lake import Flight, Lake, is_frame
from wingd.fleet.records import sha256
from wingd.fleet.state import State
from wingd.fleet.task import fetch, keys_of

from .proxy import Proxy

BREAKS = 20
SEED = 3


def objects(lake: Lake) -> dict[str, str]:
    return {key: sha256(lake.need(key)) for place in ("flights", "frames", "manifests") for key in lake.keys(place)}


def put(wingd, store, url, *more, environment=None):
    return call(
        wingd, "upload", str(store), "--to", url, "--aircraft", "D-DEMA", *more, environment=environment, check=False
    )


def test_broken_off_twenty_times_every_object_is_there_once(wingd, recorders, server):
    whole, broken = f"s3://{BUCKET}/whole", f"s3://{BUCKET}/broken"
    assert put(wingd, recorders[0], whole).returncode == 0
    proxy, chance = Proxy(server.s3), random.Random(SEED)
    environment = {**os.environ, "AWS_ENDPOINT_URL": f"http://127.0.0.1:{proxy.port}"}
    command = [
        wingd,
        "upload",
        str(recorders[0]),
        "--to",
        broken,
        "--aircraft",
        "D-DEMA",
        "--retries",
        "0",
        "--jobs",
        "2",
    ]
    for number in range(BREAKS):
        process = subprocess.Popen(command, env=environment, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        # The program and its connections are killed alternately.
        proxy.broken = process.kill if number % 2 else lambda: None
        proxy.budget = chance.randrange(1_000, 160_000)
        assert process.wait(60) != 0, f"attempt {number} was to break off"
        _marks_are_true(Lake(broken))
    proxy.budget = None
    done = subprocess.run([*command, "--json"], env=environment, capture_output=True, text=True)
    proxy.close()
    line = json.loads(done.stdout)
    assert (done.returncode, line["status"]) == (0, "ok"), done.stderr
    assert 0 < line["sent"] < line["objects"], "it went on where it ended"
    assert objects(Lake(broken)) == objects(Lake(whole))
    again = json.loads(put(wingd, recorders[0], broken, "--json").stdout)
    assert (again["sent"], again["objects"]) == (0, line["objects"])


def _marks_are_true(lake: Lake) -> None:
    """A stage is reported as uploaded only if it is."""
    state = State(lake)
    for flight in state.flights:
        for entry in state.manifest(flight)["files"]:
            stage = "frames" if is_frame(entry["name"]) else "results"
            if stage in state.marks[flight]:
                assert all(sha256(lake.need(key)) == digest for key, digest, _ in keys_of(flight, entry))


def test_what_exists_comes_first_then_results_then_frames(wingd, recorders, server):
    """Results first, also for several flights: a link that breaks early has transferred what is needed first."""
    proxy = Proxy(server.s3)
    environment = {**os.environ, "AWS_ENDPOINT_URL": f"http://127.0.0.1:{proxy.port}"}
    lake, order = Lake(f"s3://{BUCKET}/order"), []
    command = ("upload", str(recorders[0]), "--to", lake.url, "--retries", "0")
    for budget in range(15_000, 6_000_000, 120_000):
        proxy.budget = budget
        if call(wingd, *command, environment=environment, check=False).returncode == 0:
            break
        state = State(lake)
        order += [state.arrived(flight) for flight in state.flights]
        assert not lake.keys("frames") or order[-1] == "results"
    proxy.close()
    assert order == sorted(order, key=["announced", "results", "whole"].index) and len(set(order)) == 2


def test_retries_pass_over_a_break(wingd, recorders, server):
    proxy = Proxy(server.s3)
    environment = {**os.environ, "AWS_ENDPOINT_URL": f"http://127.0.0.1:{proxy.port}"}
    proxy.budget = 300_000
    proxy.broken = lambda: setattr(proxy, "budget", None)
    done = put(wingd, recorders[0], f"s3://{BUCKET}/retried", environment=environment)
    proxy.close()
    assert done.returncode == 0, done.stderr


def test_equal_flights_of_two_recorders_never_meet(wingd, recorders, tmp_path):
    url = f"file://{tmp_path}"
    for store in recorders:
        assert put(wingd, store, url).returncode == 0
    flights = solves.flights(Lake(url))
    assert len(flights) == 2 and len({flight.flight for flight in flights}) == 1


@pytest.mark.parametrize("kind", ["file", "s3"])
def test_what_is_there_with_other_bytes_is_neither_written_over_nor_taken(wingd, recorders, server, tmp_path, kind):
    url = f"file://{tmp_path}" if kind == "file" else f"s3://{BUCKET}/other"
    assert put(wingd, recorders[0], f"file://{tmp_path}/model").returncode == 0
    flight = solves.flights(Lake(f"file://{tmp_path}/model"))[0]
    frame = flight.file(f"flights/{flight.flight}/s000001/0001.jpg")
    lake = Lake(url)
    length = len(Lake(f"file://{tmp_path}/model").need(frame))
    lake.create(frame, b"x" * length)
    done = put(wingd, recorders[0], url)
    assert done.returncode == 1 and "different content" in done.stderr and "0001.jpg" in done.stderr
    assert lake.need(frame) == b"x" * length
    assert State(lake).arrived(flight) == "results"
    done = put(wingd, recorders[0], url, "--repair")
    assert done.returncode == 0 and "1 replacing damaged ones" in done.stdout, done.stderr
    assert objects(lake) == objects(Lake(f"file://{tmp_path}/model"))


@pytest.mark.parametrize("kind", ["file", "s3"])
def test_what_was_changed_after_it_was_whole_is_found(wingd, recorders, server, tmp_path, kind):
    lake = Lake(f"file://{tmp_path}" if kind == "file" else f"s3://{BUCKET}/changed")
    assert put(wingd, recorders[0], lake.url).returncode == 0
    whole = objects(lake)
    flight = solves.flights(lake)[0]
    for key in (flight.file(f"flights/{flight.flight}/s000002/0001.jpg"), flight.file("store.toml"), flight.manifest):
        data = lake.need(key)
        lake.replace(key, data[:-1] + bytes([data[-1] ^ 1]))
        done = put(wingd, recorders[0], lake.url)
        assert done.returncode == 1 and key.rsplit("/", 1)[1] in done.stderr, done.stderr
        assert put(wingd, recorders[0], lake.url, "--repair").returncode == 0
        assert objects(lake) == whole


def test_a_stranger_among_the_files_is_refused(wingd, recorders, tmp_path):
    url = f"file://{tmp_path}"
    assert put(wingd, recorders[0], url).returncode == 0
    lake = Lake(url)
    lake.create(solves.flights(lake)[0].file("notes.txt"), b"mine")
    done = put(wingd, recorders[0], url)
    assert done.returncode == 1 and "notes.txt" in done.stderr


def test_a_damaged_flight_is_refused_and_the_others_are_uploaded(wingd, recorders, tmp_path):
    """`wingd verify` comes first: nothing of a damaged flight is published, not even its name."""
    store = tmp_path / "store"
    shutil.copytree(recorders[0], store)
    frame = next(store.glob("flights/*/s000003/0001.jpg"))
    whole = frame.read_bytes()
    frame.write_bytes(whole[:1000] + bytes([whole[1000] ^ 1]) + whole[1001:])
    done = put(wingd, store, f"file://{tmp_path}/lake", "--json")
    assert done.returncode == 1 and "0001.jpg" in done.stderr and "wingd verify" in done.stderr
    assert json.loads(done.stdout)["status"] == "failed"
    assert solves.flights(Lake(f"file://{tmp_path}/lake")) == []
    frame.write_bytes(whole)
    assert put(wingd, store, f"file://{tmp_path}/lake").returncode == 0


def test_long_files_go_in_parts_and_come_back(wingd, recorders, tmp_path):
    """A frame of 9 MB is stored as three objects, each with its digest."""
    store = long_frames(wingd, recorders[0], tmp_path / "recorder", 9_000_000)
    lake = Lake(f"file://{tmp_path}/lake")
    assert put(wingd, store, lake.url).returncode == 0
    parts = [key for key in lake.keys("frames") if ".part-" in key]
    assert len(parts) % 3 == 0 and parts[0].endswith("0001.jpg.part-0000")
    (flight,) = solves.flights(lake)
    fetch(lake, flight, State(lake).manifest(flight), tmp_path / "back")
    assert call(wingd, "verify", str(tmp_path / "back")).returncode == 0
    assert {path.stat().st_size for path in (tmp_path / "back").rglob("*.jpg")} == {9_000_000}


def long_frames(wingd: str, template: Path, folder: Path, length: int) -> Path:
    """Creates a recorder's store of eight long frames: images with extra bytes after their end."""
    shutil.copytree(template.parent / "input/installation", folder / "installation")
    (folder / "frames").mkdir()
    for number, frame in enumerate(sorted((template.parent / "input/frames").glob("flight-*.jpg"))[:8]):
        data = frame.read_bytes()
        (folder / "frames" / frame.name).write_bytes(data + random.Random(number).randbytes(length - len(data)))
    recorded(wingd, folder)
    return folder / "store"


def test_secrets_are_in_no_text(wingd, recorders, server):
    wrong = {**os.environ, "AWS_SECRET_ACCESS_KEY": "wrong-secret-of-a-user", "AWS_SESSION_TOKEN": "token-of-a-user"}
    for environment in (wrong, {**wrong, "AWS_ENDPOINT_URL": "http://127.0.0.1:9"}):
        done = put(wingd, recorders[0], f"s3://{BUCKET}/secret", "--retries", "0", environment=environment)
        assert done.returncode == 1
        for secret in ("wrong-secret-of-a-user", "token-of-a-user", server.key):
            assert secret not in done.stdout + done.stderr
    done = put(wingd, recorders[0], f"s3://key:{'secret' * 3}@{BUCKET}/x")
    assert done.returncode == 78 and "secretsecret" not in done.stderr


@pytest.mark.parametrize("url, status", [("gs://x/y", 78), ("file://relative", 78), ("s3://", 78)])
def test_wrong_targets_are_named(wingd, recorders, url, status):
    done = put(wingd, recorders[0], url)
    assert done.returncode == status and "--to" in done.stderr


def test_without_credentials_nothing_is_asked_elsewhere(wingd, recorders):
    environment = {k: v for k, v in os.environ.items() if not k.startswith("AWS_")}
    done = put(wingd, recorders[0], f"s3://{BUCKET}/x", environment=environment)
    assert done.returncode == 78 and "AWS_ACCESS_KEY_ID" in done.stderr


def test_names_that_keys_cannot_hold_are_refused(wingd, recorders, tmp_path):
    for name in ("a/b", "..", "D ABCD", "x=y", ""):
        done = call(wingd, "upload", str(recorders[0]), "--to", f"file://{tmp_path}", "--aircraft", name, check=False)
        assert done.returncode == 2, name
    assert Flight.parse("B/f0001").flight == "f0001"


def test_a_limit_of_the_rate_is_kept(wingd, recorders, server):
    begun = time.monotonic()
    done = put(wingd, recorders[0], f"s3://{BUCKET}/limited", "--limit-rate", "1500k", "--json")
    took = time.monotonic() - begun
    sent = json.loads(done.stdout)["sent_bytes"]
    assert 0.9 * sent / 1.5e6 < took, f"{sent / took / 1e6:.2f} MB/s"
    assert objects(Lake(f"s3://{BUCKET}/limited")).keys()


@pytest.mark.skipif("FLEET_SLOW_LINK" in os.environ, reason="the long one runs")
def test_a_slow_link_that_breaks_all_the_time_finishes(wingd, recorders, server, tmp_path):
    """Long upload at ten times the speed: 60 MB over 20 Mbit/s, killed every 2 to 12 s."""
    slow_link(wingd, recorders[0], server, tmp_path, 60e6, 2.5e6, (2, 12))


@pytest.mark.skipif("FLEET_SLOW_LINK" not in os.environ, reason="ten minutes: FLEET_SLOW_LINK=1")
def test_100_mb_over_2_mbit_s(wingd, recorders, server, tmp_path):
    slow_link(wingd, recorders[0], server, tmp_path, 100e6, 0.25e6, (20, 120))


def slow_link(wingd, template, server, tmp_path, size: float, rate: float, kills: tuple[float, float]) -> None:
    store = long_frames(wingd, template, tmp_path / "recorder", int(size / 8))
    proxy, chance = Proxy(server.s3, rate), random.Random(SEED)
    environment = {**os.environ, "AWS_ENDPOINT_URL": f"http://127.0.0.1:{proxy.port}"}
    url, killed, begun = f"s3://{BUCKET}/slow-{int(size)}", 0, time.monotonic()
    while True:
        process = subprocess.Popen(
            [wingd, "upload", str(store), "--to", url, "--json"], env=environment, stdout=subprocess.PIPE
        )
        try:
            said, _ = process.communicate(timeout=chance.uniform(*kills))
            assert process.returncode == 0, said
            break
        except subprocess.TimeoutExpired:
            process.kill()
            process.communicate()
            killed += 1
    whole = json.loads(said)["bytes"]
    proxy.close()
    print(
        f"{whole / 1e6:.1f} MB in {time.monotonic() - begun:.0f} s, killed {killed} times, sent {proxy.passed / whole:.2f} times"
    )
    assert killed > 1 and proxy.passed < 1.5 * whole
