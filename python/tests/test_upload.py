"""Upload without the program: the published bytes of earlier versions, faults of servers, pace, options."""

from __future__ import annotations

import argparse
import hashlib
import json
import re
import shutil
import threading
from collections.abc import Iterator
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from urllib.parse import parse_qs, unquote, urlsplit

import pytest

pytest.importorskip("obstore")

from wingd import WingdError, objects
from wingd.commands.upload import main, parse_rate
from wingd.objects import PlaceError
from wingd.upload import Labels, Target, bundle, upload_flights
from wingd.upload.manifest import PART_BYTES, Manifest, is_name
from wingd.upload.pace import RATE_WINDOW, Pace, RateLimit

DATA = Path(__file__).parent / "data/upload"
LABELS = Labels("D-ABCD", "A320", "left")


@pytest.fixture
def store(tmp_path, monkeypatch) -> Path:
    """A sound store; `wingd verify` is tested with the program in tests/fleet."""
    monkeypatch.setattr(bundle, "verify", lambda root, flight: None)
    shutil.copytree(DATA / "store", tmp_path / "store")
    return tmp_path / "store"


def contents(folder: Path) -> dict[str, bytes]:
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def test_keys_and_records_are_those_of_earlier_lakes(store, tmp_path):
    """`published` has the bytes of the upload in Rust: the digest of its flight, and the text and seals of its records."""
    (outcome,) = upload_flights(store, ["f0001"], Target(f"file://{tmp_path}/lake"), LABELS)
    assert outcome.error is None
    there = contents(tmp_path / "lake")
    published = contents(DATA / "published")
    assert {key for key in there if key.startswith("manifests/")} == set(published)
    assert all(there[key] == data for key, data in published.items())
    for entry in json.loads(published[outcome.manifest.key])["files"]:
        place = "frames" if entry["name"].endswith(".jpg") else "flights"
        assert hashlib.sha256(there[f"{place}/{outcome.manifest.place}/{entry['name']}"]).hexdigest() == entry["sha256"]
    # A lake of an earlier version goes on.
    shutil.rmtree(tmp_path / "lake/frames")
    (tmp_path / "lake" / outcome.manifest.completion("frames")[0]).unlink()
    (again,) = upload_flights(store, ["f0001"], Target(f"file://{tmp_path}/lake"))
    assert again.error is None and again.counts.sent == 2 and contents(tmp_path / "lake") == there


def test_any_changed_byte_breaks_the_seal(store):
    text = Manifest.of(bundle.bundle(store, "f0001"), LABELS).text
    assert Manifest.parse(text).text == text
    for place in range(len(text)):
        assert Manifest.parse(text[:place] + bytes([text[place] ^ 1]) + text[place + 1 :]) is None, place


def test_labels_stay_as_first_published_and_contradictions_are_refused(store):
    there = Manifest.of(bundle.bundle(store, "f0001"), LABELS)
    own = Manifest.of(bundle.bundle(store, "f0001"), Labels())
    assert own.fields["aircraft"].startswith("recorder-") and own != there
    assert own.labelled(there, Labels()) == own.labelled(there, Labels("D-ABCD")) == there
    assert own.labelled(there, Labels("D-ABCE")) is None and own.labelled(there, Labels(wing="right")) is None
    for wrong in ("", "a b", ".x", "x" * 65, "a/b", "ä"):
        assert not is_name(wrong)
        with pytest.raises(WingdError, match="letters, digits"):
            Labels(wrong)


def test_only_frames_go_below_their_prefix_and_long_files_in_parts():
    assert bundle.is_frame("flights/f0001/s000001/0001.jpg") and bundle.is_frame("flights/f0001/s000001/12345.tif")
    for name in (
        "flights/f0001/s000001/results.jsonl",
        "store.toml",
        "flights/f0001/live-000001.rows",
        "flights/f1/s1/1.jpg",
    ):
        assert not bundle.is_frame(name), name
    data = b"\7" * (2 * PART_BYTES + 1)
    file = bundle.File("flights/f0001/s000001/0001.tif", len(data), bundle.sha256(data), data)
    whole = bundle.Bundle("ab12", "f0001", "2026-06-01T08:00:00Z", None, (file,))
    objects = Manifest.of(whole, Labels()).objects(whole)
    assert [one.length for one in objects] == [PART_BYTES, PART_BYTES, 1]
    assert b"".join(one.read() for one in objects) == data and objects[2].key.endswith("0001.tif.part-0002")
    assert all(bundle.sha256(one.read()) == one.sha256 for one in objects)


@pytest.mark.parametrize(
    ("damage", "words"),
    [
        ("flights/f0001/s000001/0001.jpg", "recorded length"),
        ("flights/f0001/chain.jsonl", "chain"),
        ("flights/f0001/SHA256SUMS", "chain"),
        ("flights/f0001/s000001/results.jsonl", "recorded length"),
        ("store.toml", "store.toml"),
    ],
)
def test_a_file_that_was_cut_is_named_and_nothing_is_sent(store, tmp_path, damage, words):
    path = store / damage
    data = path.read_bytes()
    path.write_bytes(data[40:] if path.name == "SHA256SUMS" else data[:-40])
    (outcome,) = (
        upload_flights(store, ["f0001"], Target(f"file://{tmp_path}/lake")) if damage != "store.toml" else (None,)
    )
    if outcome is None:
        with pytest.raises(bundle.StoreError, match=words):
            bundle.flights(store)
        return
    assert words in str(outcome.error) and path.name.split(".")[0] in str(outcome.error)
    assert contents(tmp_path / "lake") == {}


def test_what_a_recorder_adds_meanwhile_is_not_sent(store):
    """Files that grow are taken as SHA256SUMS has them."""
    before = bundle.bundle(store, "f0001")
    for name in ("chain.jsonl", "s000001/results.jsonl"):
        with (store / "flights/f0001" / name).open("ab") as file:
            file.write(b'{"before":"00","live":{"file":"live-0')
    after = bundle.bundle(store, "f0001")
    assert after.digest == before.digest and [file.read() for file in after.files] == [
        file.read() for file in before.files
    ]


def test_flights_are_found_by_both_names(store, capsys):
    assert bundle.flights(store) == bundle.flights(store, "first flight") == bundle.flights(store, "f0001") == ["f0001"]
    assert main([str(store), "--to", "file:///tmp/never", "--flight", "f0002"]) == 1
    assert "no flight f0002; available: f0001" in capsys.readouterr().err
    (store / "store.toml").write_text("format = 1\n")
    with pytest.raises(bundle.StoreError, match="format 1 and no id"):
        bundle.store_id(store)


class Bucket(ThreadingHTTPServer):
    """An S3 server in memory, which fails as `faults` says: a function of method and key."""

    def __init__(self) -> None:
        super().__init__(("127.0.0.1", 0), Requests)
        self.objects: dict[str, bytes] = {}
        self.digests: dict[str, str] = {}
        self.puts: list[str] = []
        self.faults = lambda method, key: None
        self.lock = threading.Lock()


class Requests(BaseHTTPRequestHandler):
    """Create-only put with SHA-256 in the metadata, get, head, list."""

    protocol_version = "HTTP/1.1"
    server: Bucket

    def log_message(self, *_: object) -> None:
        pass

    def answer(self, status: int, data: bytes = b"", **headers: str) -> None:
        self.send_response(status)
        for name, value in {"Content-Length": str(len(data)), "ETag": '"e"', **headers}.items():
            self.send_header(name.replace("_", "-"), value)
        self.send_header("Last-Modified", "Mon, 01 Jun 2026 08:00:00 GMT")
        self.end_headers()
        if self.command != "HEAD":
            self.wfile.write(data)

    def key(self) -> str:
        return unquote(urlsplit(self.path).path).removeprefix("/bucket").lstrip("/")

    def failed(self) -> bool:
        fault = self.server.faults(self.command, self.key())
        if isinstance(fault, int):
            code = {503: "SlowDown", 403: "AccessDenied"}[fault]
            self.answer(fault, f"<Error><Code>{code}</Code></Error>".encode())
        elif fault == "cut":
            self.close_connection = True
            self.connection.close()
        return fault is not None and fault != "lost"

    def do_PUT(self) -> None:
        data = self.rfile.read(int(self.headers["Content-Length"]))
        if self.failed():
            return
        with self.server.lock:
            if self.headers.get("If-None-Match") == "*" and self.key() in self.server.objects:
                self.answer(412, b"<Error><Code>PreconditionFailed</Code></Error>")
                return
            self.server.objects[self.key()] = data
            self.server.digests[self.key()] = self.headers.get("x-amz-meta-sha256", "")
            self.server.puts.append(self.key())
        if self.server.faults("LOST", self.key()) == "lost":
            self.close_connection = True
            self.connection.close()
            return
        self.answer(200)

    def do_GET(self) -> None:
        if self.failed():
            return
        query = parse_qs(urlsplit(self.path).query)
        if "list-type" in query:
            prefix = query.get("prefix", [""])[0]
            row = "<Contents><Key>{}</Key><Size>{}</Size><LastModified>2026-06-01T08:00:00Z</LastModified><ETag>e</ETag></Contents>"
            rows = [row.format(key, len(data)) for key, data in self.server.objects.items() if key.startswith(prefix)]
            self.answer(200, f"<ListBucketResult>{''.join(rows)}</ListBucketResult>".encode())
        elif self.key() in self.server.objects:
            self.answer(200, self.server.objects[self.key()], x_amz_meta_sha256=self.server.digests[self.key()])
        else:
            self.answer(404, b"<Error><Code>NoSuchKey</Code></Error>")

    do_HEAD = do_GET


@pytest.fixture
def bucket(monkeypatch) -> Iterator[Bucket]:
    server = Bucket()
    threading.Thread(target=server.serve_forever, daemon=True).start()
    settings = {
        "ACCESS_KEY_ID": "KEYOFAUSER",
        "SECRET_ACCESS_KEY": "secret-of-a-user",
        "REGION": "us-east-1",
        "ALLOW_HTTP": "true",
    }
    for name, value in {**settings, "ENDPOINT_URL": f"http://127.0.0.1:{server.server_port}"}.items():
        monkeypatch.setenv(f"AWS_{name}", value)
    monkeypatch.setattr(objects, "FIRST_PAUSE_S", 0.01)
    yield server
    server.shutdown()
    server.server_close()


def test_a_server_that_is_busy_cuts_or_loses_answers_is_asked_again(store, bucket):
    """Each key fails in turn: busy, connection cut before the object is stored, answer lost after it was."""
    seen: dict[tuple[str, str], int] = {}

    def faults(method: str, key: str) -> object:
        seen[method, key] = seen.get((method, key), 0) + 1
        if method == "PUT":
            return {1: 503, 2: "cut"}.get(seen[method, key])
        return "lost" if method == "LOST" and seen[method, key] == 1 else None

    bucket.faults = faults
    (outcome,) = upload_flights(store, ["f0001"], Target("s3://bucket/lake", retries=4), LABELS)
    assert outcome.error is None, outcome.error
    assert len(bucket.puts) == len(set(bucket.puts)) == outcome.counts.objects, "every object was stored once"
    # Its answer was lost: it is there, and counts as sent before.
    assert outcome.counts.sent == 0
    assert all(hashlib.sha256(data).hexdigest() == bucket.digests[key] for key, data in bucket.objects.items())
    order = [key.split("/")[1] + key.rsplit("/", 1)[1] * ("manifests" in key) for key in bucket.puts]
    marks = [order.index(f"manifests{name}.json") for name in ("manifest", "results", "frames")]
    assert marks[0] == 0 and marks[2] == len(order) - 1
    assert set(order[1 : marks[1]]) == {"flights"} and set(order[marks[1] + 1 : marks[2]]) == {"frames"}


def test_without_retries_the_rest_is_not_tried_and_said(store, bucket):
    shutil.copytree(store / "flights/f0001", store / "flights/f0002")
    bucket.faults = lambda method, key: 503 if method == "PUT" and "frames/" in key else None
    (outcome,) = upload_flights(store, ["f0001"], Target("s3://bucket/lake", retries=1), LABELS)
    assert "run the command again" in str(outcome.error) and "0001.jpg" in str(outcome.error)
    keys = [key.rsplit("/", 1)[1] for key in bucket.objects if "manifests" in key]
    assert sorted(keys) == ["manifest.json", "results.json"], "frames are not marked as arrived"
    bucket.faults = lambda method, key: None
    (outcome,) = upload_flights(store, ["f0001"], Target("s3://bucket/lake"))
    assert outcome.error is None and outcome.counts.sent == 2


def test_a_refusal_is_not_repeated_and_ends_all_flights(store, bucket):
    asked = []

    def refuse(method: str, key: str) -> int:
        asked.append(key)
        return 403

    bucket.faults = refuse
    first, second = upload_flights(store, ["f0001", "f0001"], Target("s3://bucket/lake"))
    assert "no permission" in str(first.error) and "AccessDenied" in str(first.error) and len(asked) == 1
    assert "was not tried" in str(second.error)


def test_secrets_and_wrong_places_are_in_no_text(store, bucket, capsys, monkeypatch):
    bucket.faults = lambda method, key: 503
    assert main([str(store), "--to", "s3://bucket/x", "--retries", "0"]) == 1
    monkeypatch.setenv("AWS_ENDPOINT_URL", "http://127.0.0.1:9/KEYOFAUSER/secret-of-a-user")
    assert main([str(store), "--to", "s3://bucket/x", "--retries", "0", "--json"]) == 1
    out, err = capsys.readouterr()
    assert "secret-of-a-user" not in out + err and "KEYOFAUSER" not in out + err
    for url in ("gs://x/y", "file://relative", "s3://", "s3://key:hidden@bucket/x"):
        assert main([str(store), "--to", url]) == 78
        assert (
            re.fullmatch(r"error: --to: [^\n]+; give [^\n]+\n", text := capsys.readouterr().err)
            and "hidden" not in text
        )
    monkeypatch.delenv("AWS_SECRET_ACCESS_KEY")
    with pytest.raises(PlaceError, match="AWS_ACCESS_KEY_ID"):
        Target("s3://bucket/x")


def test_an_object_with_other_bytes_stays_and_repair_replaces_it(store, bucket):
    upload_flights(store, ["f0001"], Target("s3://bucket/lake"))
    whole = dict(bucket.objects)
    for ending in ("manifest.json", "frames.json", "results.jsonl", "0001.jpg"):
        key = next(key for key in whole if key.endswith(ending))
        bucket.objects[key], bucket.digests[key] = whole[key][:-1] + b"?", ""
        (outcome,) = upload_flights(store, ["f0001"], Target("s3://bucket/lake"))
        assert "different content" in str(outcome.error) and key in str(outcome.error)
        assert bucket.objects[key].endswith(b"?")
        (outcome,) = upload_flights(store, ["f0001"], Target("s3://bucket/lake"), repair=True)
        assert outcome.error is None and outcome.counts.repaired == 1 and bucket.objects == whole


def test_frames_that_a_rule_deleted_stay_deleted_without_repair(store, bucket):
    upload_flights(store, ["f0001"], Target("s3://bucket/lake"))
    whole = dict(bucket.objects)
    frame = next(key for key in whole if key.startswith("lake/frames"))
    del bucket.objects[frame]
    (outcome,) = upload_flights(store, ["f0001"], Target("s3://bucket/lake"))
    assert (outcome.error, outcome.counts.expired, outcome.counts.sent) == (None, 1, 0) and frame not in bucket.objects
    upload_flights(store, ["f0001"], Target("s3://bucket/lake"), repair=True)
    assert bucket.objects == whole


def test_a_foreign_object_is_refused(store, bucket):
    upload_flights(store, ["f0001"], Target("s3://bucket/lake"))
    place = next(key for key in bucket.objects if key.startswith("lake/flights")).rsplit("/", 1)[0]
    bucket.objects[f"{place}/notes.txt"] = b"mine"
    (outcome,) = upload_flights(store, ["f0001"], Target("s3://bucket/lake"))
    assert "notes.txt: is not a file of this flight" in str(outcome.error)


def test_a_slow_link_gets_one_object_at_a_time():
    pace = Pace(4, 0.0)
    assert pace.concurrent(1_000_000) == 1, "nothing is known yet"
    pace.record(1_000_000, 4.0)
    assert pace.concurrent(1_000_000) == 1, "0.25 MB/s"
    assert pace.concurrent(100_000) == 4, "short ones finish soon"
    for n in range(1, RATE_WINDOW + 1):
        pace.record(1_000_000, 4 + 0.1 * n)
    assert pace.concurrent(4_000_000) == 4, "10 MB/s: the old rate is forgotten"


def test_objects_sent_together_share_the_rate():
    limit = RateLimit(1000)
    assert [limit.reserve(500, limit.free) - limit.free for _ in range(2)] == [0, 0]
    now = limit.free + 1
    assert [round(limit.reserve(500, now) - now, 9) for _ in range(3)] == [0.5, 1.0, 1.5]


def test_rates_are_bytes_per_second():
    assert [parse_rate(text) for text in ("250k", "2M", "9600", "1g")] == [250_000, 2_000_000, 9600, 10**9]
    for wrong in ("", "k", "fast", "-1k", "1", "99999999999999G", "2 M", "1.5M"):
        with pytest.raises(argparse.ArgumentTypeError):
            parse_rate(wrong)
