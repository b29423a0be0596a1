#!/usr/bin/env python3
"""Measures the modes that `wingd-fleet modes` finds in a real recorder's results against those of the rendered wing.

usage: tests/live/modes.py [--binary target/release/wingd] [--modes wingd-fleet] [--hz 1.3,3.7] SET
       SET: wingd simulate --output SET --size 1200 900 --markers 13 --length 28 --camera-height 3.2 --diameter 0.4 --gusts 300 --gust 0
            --modes 1.3:0.03:0.10,3.7:0.02:0.006 --tip-deflections 2.0 --remount 1 --seed 56

The set's frames are replayed once, ten a second. Exit status 1 where a frequency is off by more than 1 % or two of its standard
deviations, or a shape's MAC is below 0.99. Needs wingd for Python with `[modes]`.
"""

import argparse
import csv
import json
import pathlib
import subprocess
import sys
import tempfile

from measure import errors, listen, prepare, rms


def slopes(values, swings):
    """How values go with each of two swings: least squares with a constant."""
    mean = lambda v: sum(v) / len(v)
    about = lambda v: [x - mean(v) for x in v]
    dot = lambda a, b: sum(x * y for x, y in zip(a, b))
    y, (a, b) = about(values), [about(s) for s in swings]
    aa, ab, bb, ya, yb = dot(a, a), dot(a, b), dot(b, b), dot(y, a), dot(y, b)
    return ((ya * bb - yb * ab) / (aa * bb - ab * ab), (yb * aa - ya * ab) / (aa * bb - ab * ab))


def shapes(flight):
    """By marker its deflection per swing of either mode."""
    swings = list(zip(*(f["modes_m"] for f in flight)))
    deflections = {}
    for frame in flight:
        for marker in frame["markers"]:
            deflections.setdefault(marker["id"], []).append(marker["deflection_m"])
    return {name: slopes(values, swings) for name, values in deflections.items()}


def mac(one, other):
    dot = lambda a, b: sum(x * y for x, y in zip(a, b))
    return dot(one, other) ** 2 / (dot(one, one) * dot(other, other))


def fly(args, folder, seconds):
    with open(folder / "log", "wb") as log:
        process = subprocess.Popen([args.binary, "run", "--config", folder / "wingd.toml"], stderr=log)
    try:
        results, _ = listen(process, folder / "live.sock", seconds)
    finally:
        process.terminate()
        process.wait()
    return [result for _, result in results]


def main():
    parser = argparse.ArgumentParser(usage=__doc__.split("usage:")[1].split("\n\n")[0])
    parser.add_argument("--binary", type=pathlib.Path, default=pathlib.Path("target/release/wingd"))
    parser.add_argument("--modes", default="wingd-fleet")
    parser.add_argument("--hz", default="1.3,3.7")
    parser.add_argument("--keep", type=pathlib.Path, help="copy the export here")
    parser.add_argument("set", type=pathlib.Path, metavar="SET")
    args = parser.parse_args()
    args.binary, args.rate, args.first_frames = args.binary.resolve(), 10.0, None
    frames = json.loads((args.set / "truth.json").read_text())["frames"]
    flight = sorted((f for f in frames if f["image"] != "ground.jpg"), key=lambda f: f["image"])
    with tempfile.TemporaryDirectory() as name:
        folder = pathlib.Path(name)
        prepare(args, folder)
        results = fly(args, folder, len(flight) / args.rate)
        if len(results) < 2:
            sys.exit((folder / "log").read_text())
        export = args.keep or folder / "live.csv"
        exporting = [args.binary, "export", folder / "store", "--format", "csv", "--table", "live", "--output", export]
        subprocess.run(exporting, check=True)
        asked = [args.modes, "modes", export, "--of", "markers", "--count", "2"]
        found = list(csv.DictReader(subprocess.run(asked, check=True, capture_output=True, text=True).stdout.splitlines()))
    truth = {f["image"]: f for f in flight}
    solved = [r for r in results if r["status"] == "ok"]
    apart, normalised = errors(solved, truth)
    print(f"{len(results)} results, {len(solved)} with numbers, {results[-1]['skipped']} skipped; deflections {1e3 * rms(apart):.1f} mm rms, {rms(normalised):.2f} normalised")
    true, well = shapes(flight), len(found) == 2
    for number, (row, hz) in enumerate(zip(found, map(float, args.hz.split(",")))):
        names = [name[6:] for name in row if name.startswith("shape_") and row[name]]
        alike = mac([float(row[f"shape_{name}"]) for name in names], [true[name][number] for name in names])
        told, sigma = float(row["frequency_hz"]), float(row["sigma_frequency_hz"])
        off = (told - hz) / sigma
        well &= abs(told / hz - 1) < 0.01 and abs(off) < 2 and alike > 0.99
        print(
            f"{hz} Hz: {told:.4f} +- {sigma:.4f} ({100 * (told / hz - 1):+.2f} %, {off:+.2f} sigma), damping {float(row['damping']):.4f} +- {float(row['sigma_damping']):.4f}, MAC {alike:.4f}"
        )
    sys.exit(0 if well else 1)


if __name__ == "__main__":
    main()
