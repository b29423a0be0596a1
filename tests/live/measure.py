#!/usr/bin/env python3
"""Measures live mode: a set of frames with truth (`wingd simulate --gusts`) is replayed through the real recorder.

usage: tests/live/measure.py [--binary target/release/wingd] [--rate 10] [--seconds 60] [--first-frames N] SET
       SET holds installation/, frames/ and truth.json.

Says results a second, latency, frames skipped, memory, processor time, and how far the deflections are from the truth. Exit
status 1 where a result has no numbers. Needs Python 3.9, nothing else.
"""

import argparse
import json
import math
import os
import pathlib
import shutil
import socket
import subprocess
import sys
import tempfile
import time

CONFIGURATION = """installation = "installation"
[camera]
kind = "replay"
folder = "frames"
[store]
path = "store"
reserve_mb = 0
[status]
socket = "wingd.sock"
[series]
interval = "10h"
shots = 1
stale_window = 0
[live]
rate_hz = {rate}
series = false
socket = "live.sock"
[live.keep]
ring_mb = 16
mount_disturbed = false
"""


def prepare(args, folder):
    """A folder with installation, frames and configuration."""
    shutil.copytree(args.set / "installation", folder / "installation", copy_function=shutil.copyfile)
    ground = args.set / "frames" / "ground.jpg"
    orient = [args.binary, "orient", "--installation", folder / "installation", ground]
    subprocess.run(orient, check=True, stdout=subprocess.DEVNULL)
    (folder / "frames").mkdir()
    flight = sorted(f for f in (args.set / "frames").iterdir() if f.name != "ground.jpg")
    for frame in flight[: args.first_frames]:
        (folder / "frames" / frame.name).symlink_to(frame.resolve())
    (folder / "wingd.toml").write_text(CONFIGURATION.format(rate=args.rate))
    return len(flight[: args.first_frames])


def used(process):
    """Resident memory, MB, and processor time, s."""
    stat = pathlib.Path(f"/proc/{process.pid}/stat").read_text().rsplit(")", 1)[1].split()
    pages = int(pathlib.Path(f"/proc/{process.pid}/statm").read_text().split()[1])
    ticks = int(stat[11]) + int(stat[12])
    return pages * os.sysconf("SC_PAGE_SIZE") / 1e6, ticks / os.sysconf("SC_CLK_TCK")


def listen(process, path, seconds):
    """Results with the moments they came at, and (time, memory, processor time) once a second."""
    stream = socket.socket(socket.AF_UNIX)
    for _ in range(600):
        try:
            stream.connect(str(path))
            break
        except OSError:
            time.sleep(0.05)
    results, samples = [], []
    begun = time.monotonic()
    with stream.makefile() as lines:
        for line in lines:
            now = time.monotonic() - begun
            results.append((now, json.loads(line)))
            if not samples or now - samples[-1][0] >= 1:
                samples.append((now, *used(process)))
            if now > seconds:
                break
    return results, samples


def errors(results, truth):
    """Deflections less the truth, m, and the same in standard deviations."""
    apart, normalised = [], []
    for result in results:
        deflections = {m["id"]: m["deflection_m"] for m in truth.get(result["image"], {}).get("markers", [])}
        for marker in result["markers"]:
            if marker["used"] and marker.get("sigma_deflection_m") and marker["id"] in deflections:
                error = marker["deflection_m"] - deflections[marker["id"]]
                apart.append(error)
                normalised.append(error / marker["sigma_deflection_m"])
    return apart, normalised


def rms(values):
    return math.sqrt(sum(v * v for v in values) / len(values)) if values else float("nan")


def quantile(values, share):
    ordered = sorted(values)
    return ordered[max(0, math.ceil(share * len(ordered)) - 1)]


def stages(results):
    """Medians of the stages, ms."""
    names = list(dict.fromkeys(name for r in results for name in r["timing_ms"]))
    times = {name: quantile([r["timing_ms"].get(name, 0.0) for r in results], 0.5) for name in names}
    return ", ".join(f"{name} {ms:.1f}" for name, ms in times.items())


def over_time(samples):
    """Resident memory at the start, after a sixth, half and all of the time."""
    at = lambda share: samples[round(share * (len(samples) - 1))]
    return ", ".join(f"{mb:.1f} MB after {s:.0f} s" for s, mb, _ in (at(0), at(1 / 6), at(1 / 2), at(1)))


def say(args, count, results, samples):
    lines = [result for _, result in results]
    solved = [r for r in lines if r["status"] == "ok"]
    guided = [r for r in solved if r["search"] == "guided"]
    whole = [r for r in solved if r["search"] == "whole"]
    elapsed = results[-1][0] - results[0][0]
    late = [r["latency_ms"] for r in lines]
    skipped = lines[-1]["skipped"] - lines[0]["skipped"]
    memory = [s[1] for s in samples]
    processor = (samples[-1][2] - samples[0][2]) / max(1, len(lines) - 1)
    load = os.getloadavg()[0]
    print(f"{count} frames replayed at {args.rate} Hz for {elapsed:.0f} s; load of the machine {load:.1f}")
    print(f"results         {(len(lines) - 1) / elapsed:.2f} a second; {len(lines) - len(solved)} without numbers")
    for reason in sorted({r["reason"] for r in lines if r["status"] != "ok"}):
        print(f"                {sum(r.get('reason') == reason for r in lines)}: {reason}")
    print(f"latency         median {quantile(late, 0.5):.0f} ms, 95 % {quantile(late, 0.95):.0f} ms, most {max(late):.0f} ms")
    print(f"skipped         {skipped}")
    print(f"memory          {max(memory):.0f} MB at most; {over_time(samples)}")
    print(f"processor       {1e3 * processor:.0f} ms a frame")
    print(f"guided          {len(guided)} frames, median ms: {stages(guided)}")
    print(f"whole search    {len(whole)} frames, median ms: {stages(whole)}")
    print(f"disturbances    {sum(r['mount_disturbed'] for r in lines)}")
    truth = {f["image"]: f for f in json.loads((args.set / "truth.json").read_text())["frames"]}
    # Later passes repeat the same noise, which no filter takes for independent.
    first = [r for r in solved if r["number"] <= count]
    for name, those in (("first pass", first), ("all", solved)):
        apart, normalised = errors(those, truth)
        print(f"deflections, {name:<11}rms {1e3 * rms(apart):.1f} mm, normalised {rms(normalised):.2f} ({len(those)} frames)")
    return len(solved) == len(lines)


def main():
    parser = argparse.ArgumentParser(usage=__doc__.split("usage:")[1].split("\n\n")[0])
    parser.add_argument("--binary", type=pathlib.Path, default=pathlib.Path("target/release/wingd"))
    parser.add_argument("--rate", type=float, default=10.0)
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--first-frames", type=int)
    parser.add_argument("set", type=pathlib.Path, metavar="SET")
    args = parser.parse_args()
    args.binary = args.binary.resolve()
    with tempfile.TemporaryDirectory() as name:
        folder = pathlib.Path(name)
        count = prepare(args, folder)
        environment = {**os.environ, "MALLOC_ARENA_MAX": "2", "MALLOC_TRIM_THRESHOLD_": "131072"}
        command = [args.binary, "run", "--config", folder / "wingd.toml"]
        with open(folder / "log", "wb") as log:
            process = subprocess.Popen(command, env=environment, stderr=log)
        try:
            results, samples = listen(process, folder / "live.sock", args.seconds)
        finally:
            process.terminate()
            process.wait()
        if len(results) < 2:
            sys.exit((folder / "log").read_text())
        well = say(args, count, results, samples)
        live = sum(f.stat().st_size for f in (folder / "store").rglob("*.rows"))
        print(f"store           {live / max(1, len(results)):.0f} bytes a result")
        verified = subprocess.run([args.binary, "verify", folder / "store"], capture_output=True, text=True)
        print(f"verify          {verified.stdout.strip()}")
    sys.exit(0 if well and verified.returncode == 0 else 1)


if __name__ == "__main__":
    main()
