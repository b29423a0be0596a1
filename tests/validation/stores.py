"""Large stores from bundled frames, written with their chain and sums, and verified."""

import datetime
import hashlib
import json
import shutil
import subprocess
from pathlib import Path

REPOSITORY = Path(__file__).resolve().parents[2]
ID = 32 * "1"
BEGUN = datetime.datetime(2026, 3, 1, 8, tzinfo=datetime.timezone.utc)


def sha256(data):
    return hashlib.sha256(data).hexdigest()


def canonical(value):
    """JSON with sorted keys, as docs/store.md's `inputs` are hashed over."""
    if isinstance(value, dict):
        return "{" + "".join(f"{json.dumps(k)}:{canonical(v)}," for k, v in sorted(value.items())) + "}"
    if isinstance(value, list):
        return "[" + "".join(canonical(v) + "," for v in value) + "]"
    return json.dumps(value)


def stamp(second):
    utc = (BEGUN + datetime.timedelta(seconds=second)).strftime("%Y-%m-%dT%H:%M:%SZ")
    return {"utc": utc, "utc_synchronised": True, "boot_id": "boot", "since_boot_s": float(second)}


def result(frame, digest, template, deflection_m):
    record = json.loads(json.dumps(template["record"]))
    record["image"] = frame
    record["tip"]["deflection_m"] = deflection_m
    inputs = sha256(f"{digest}\n{canonical(template['provenance'])}".encode())
    return {"frame": frame, "frame_sha256": digest, "inputs": inputs,
            "provenance": template["provenance"], "record": record}


def make(wingd, root, series, shots, frames, template=None, installation=None):
    """A store of one flight: `series` of `shots`, frames in turn, each unlike the others by bytes after its end."""
    root = Path(root)
    flight = root / "flights/f0001"
    flight.mkdir(parents=True)
    for name in ["incoming", "partial"]:
        (root / name).mkdir()
    (root / "store.toml").write_text(f'format = 2\nid = "{ID}"\n')
    (root / "counter.json").write_text(json.dumps({"next_flight": 2, "next_series": series + 1}) + "\n")
    head = json.dumps({"flight": "f0001", "started": stamp(0), "because": "first series of the store"})
    (flight / "flight.json").write_text(head)
    events = [{"flight": {"store": ID, "flight": "f0001", "sha256": sha256(head.encode())}}]
    if installation:
        shutil.copytree(installation, root / "installations" / Path(installation).name)
        events.append({"installation": {"sha256": Path(installation).name}})
    for number in range(1, series + 1):
        name = f"s{number:06}"
        folder = flight / name
        folder.mkdir()
        begun = 600 * number
        taken, lines = [], []
        for shot in range(1, shots + 1):
            data = frames[(number * shots + shot) % len(frames)] + f"{number} {shot}".encode()
            file = f"{shot:04}.jpg"
            (folder / file).write_bytes(data)
            entry = {"file": file, "sha256": sha256(data), "bytes": len(data), "format": {"kind": "jpeg"}}
            taken.append({"shot": shot, "stamp": stamp(begun + 2 * shot), "duration_s": 0.4, "frame": entry})
            if template:
                lines.append(json.dumps(result(file, entry["sha256"], template, 2.5 + 0.4 * (number % 50) / 50)))
        manifest = {"format": 1, "series": name, "flight": "f0001", "state": "complete", "cause": "scheduled",
                    "started": stamp(begun), "ended": stamp(begun + 2 * shots + 2), "planned_shots": shots,
                    "camera": {"name": "bundled"}, "shots": taken}
        manifest = json.dumps(manifest, indent=2)
        (folder / "series.json").write_text(manifest)
        events.append({"series": {"series": name, "sha256": sha256(manifest.encode())}})
        results = b"".join(line.encode() + b"\n" for line in lines)
        if results:
            (folder / "results.jsonl").write_bytes(results)
            events.append({"results": {"series": name, "bytes": len(results), "sha256": sha256(results)}})
    write_evidence(flight, events)
    subprocess.run([wingd, "verify", root], check=True, stdout=subprocess.DEVNULL)
    return root


def write_evidence(flight, events):
    """The chain of these events, and the sums of all files of a flight."""
    before, lines = 64 * "0", []
    for event in events:
        lines.append(json.dumps({"before": before, **event}))
        before = sha256(lines[-1].encode())
    (flight / "chain.jsonl").write_text("".join(line + "\n" for line in lines))
    files = sorted(str(path.relative_to(flight)) for path in flight.rglob("*") if path.is_file())
    sums = [f"{sha256((flight / name).read_bytes())}  {name}\n" for name in files]
    (flight / "SHA256SUMS").write_text("".join(sums))


def bundled_frames():
    return [p.read_bytes() for p in sorted((REPOSITORY / "fixtures/dev/frames").glob("flight-*.jpg"))]


def demo(wingd, work):
    """A store of the demonstration and a result of it to copy."""
    subprocess.run([wingd, "demo", "--output", work / "demo"], check=True,
                   stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    store = work / "demo/store"
    lines = (store / "flights/f0001/s000003/results.jsonl").read_text().splitlines()
    return store, json.loads(lines[0])
