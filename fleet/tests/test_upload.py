"""`wingd upload`: every object once, whatever breaks off; nothing written over; nothing told that is secret."""

from __future__ import annotations

import json
import os
import random
import shutil
import subprocess

import pytest

from demo.prepare import call
from demo.server import BUCKET
from wingd_fleet.lake import Flight, Lake, sha256

from .proxy import Proxy

BREAKS = 20
SEED = 3


def objects(lake: Lake) -> dict[str, str]:
    return {key: sha256(lake.need(key)) for key in lake.keys("flights") + lake.keys("manifests")}


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
        # Every other time the program is killed, else its connections are.
        proxy.broken = process.kill if number % 2 else lambda: None
        proxy.budget = chance.randrange(1_000, 160_000)
        assert process.wait(60) != 0, f"attempt {number} was to break off"
        assert Lake(broken).keys("manifests") == [], "published before it was whole"
    proxy.budget = None
    done = subprocess.run([*command, "--json"], env=environment, capture_output=True, text=True)
    proxy.close()
    line = json.loads(done.stdout)
    assert (done.returncode, line["status"]) == (0, "ok"), done.stderr
    assert 0 < line["sent"] < line["objects"], "it went on where it ended"
    assert objects(Lake(broken)) == objects(Lake(whole))
    again = json.loads(put(wingd, recorders[0], broken, "--json").stdout)
    assert (again["sent"], again["objects"]) == (0, line["objects"])


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
    flights = Lake(url).flights()
    assert len(flights) == 2 and len({flight.flight for flight in flights}) == 1


@pytest.mark.parametrize("kind", ["file", "s3"])
def test_what_is_there_with_other_bytes_is_neither_written_over_nor_taken(wingd, recorders, server, tmp_path, kind):
    url = f"file://{tmp_path}" if kind == "file" else f"s3://{BUCKET}/other"
    assert put(wingd, recorders[0], f"file://{tmp_path}/model").returncode == 0
    flight = Lake(f"file://{tmp_path}/model").flights()[0]
    frame = flight.file(f"flights/{flight.flight}/s000001/0001.jpg")
    lake = Lake(url)
    length = len(Lake(f"file://{tmp_path}/model").need(frame))
    lake.create(frame, b"x" * length)
    done = put(wingd, recorders[0], url)
    assert done.returncode == 1 and "other bytes" in done.stderr and "0001.jpg" in done.stderr
    assert lake.need(frame) == b"x" * length
    assert lake.keys("manifests") == []


def test_a_stranger_among_the_files_is_refused(wingd, recorders, tmp_path):
    url = f"file://{tmp_path}"
    assert put(wingd, recorders[0], url).returncode == 0
    lake = Lake(url)
    lake.create(lake.flights()[0].file("notes.txt"), b"mine")
    done = put(wingd, recorders[0], url)
    assert done.returncode == 1 and "notes.txt" in done.stderr


def test_nothing_is_published_of_a_damaged_flight(wingd, recorders, tmp_path):
    store = tmp_path / "store"
    shutil.copytree(recorders[0], store)
    frame = next(store.glob("flights/*/s000003/0001.jpg"))
    data = bytearray(frame.read_bytes())
    data[1000] ^= 1
    frame.write_bytes(data)
    done = put(wingd, store, f"file://{tmp_path}/lake", "--json")
    assert done.returncode == 1 and "0001.jpg" in done.stderr
    assert json.loads(done.stdout)["status"] == "failed"
    assert Lake(f"file://{tmp_path}/lake").keys("manifests") == []


def test_a_published_flight_is_a_sound_store(wingd, recorders, tmp_path):
    assert put(wingd, recorders[0], f"file://{tmp_path}").returncode == 0
    flight = Lake(f"file://{tmp_path}").flights()[0]
    folder = tmp_path / flight.file("store.toml")
    # Object stores know no empty folders.
    for name in ("incoming", "partial"):
        (folder.parent / name).mkdir()
    assert call(wingd, "verify", str(folder.parent)).returncode == 0


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
    assert call(wingd, "upload", str(recorders[0]), "--to", f"file://{tmp_path}").returncode == 0
    assert Lake(f"file://{tmp_path}").flights()[0].aircraft == "simulated-left-wing"
    assert Flight.parse("A/B/f0001").flight == "f0001"
