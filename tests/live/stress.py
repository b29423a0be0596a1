#!/usr/bin/env python3
"""Measures the damage that `wingd stress --live` tells of a real recorder's results against the dense history of the rendered wing.

usage: tests/live/stress.py [--binary target/release/wingd] [--seconds 180] [--hole 1200] {whole,skipped,hole} SET
       SET: wingd simulate --output SET --gusts 60 --gust 0 --modes 0.95:0.03:0.15 --tip-deflections 2.3 --remount 1 --seed 55

The set's frames are replayed forwards and backwards, ten a second, so that the wing swings on without a jump.
  whole    all of them
  skipped  the solver is kept from the processor every few seconds, until 3 % of the frames are skipped
  hole     the pictures are gone for --hole seconds, with --seconds before and after it

Truth: tip deflections of the set, interpolated to 200 a second, by a cantilever to moments, by rainflow (ASTM E1049-85, 5.4.4) to damage
over that of a ground-air-ground cycle. Only the moment's shape over the deflection enters, in which cantilevers hardly differ.
Exit status 1 where damage is off by more than two of its standard deviations. Needs Python 3.9, Linux, nothing else.
"""

import argparse
import json
import math
import multiprocessing
import os
import pathlib
import re
import subprocess
import sys
import tempfile
import time

from measure import listen, prepare

RATE_HZ, DENSE = 10.0, 20
SLOPES = (3, 5, 10)
STRUCTURE = "s_m,ei_n_m2,sigma_ei_n_m2\n2,4.0e8,1.2e7\n10,1.6e8,4.8e6\n20,3.0e7,9.0e5\n"
SHARES = (2 / 30, 10 / 30, 20 / 30)
# A solver is kept from the processor for so long, s, so often: 3 % of ten frames a second.
HELD_S, EVERY_S = 0.25, 5.0


def swinging(folder, images):
    """The set's frames forwards and backwards, by name."""
    frames = folder / "frames"
    links = [(link.name, link.resolve()) for link in sorted(frames.iterdir())]
    assert [name for name, _ in links] == images
    for number, (name, target) in enumerate(links[-2:0:-1], len(links) + 1):
        (frames / f"flight-{number:05}.jpg").symlink_to(target)
    for number, (name, target) in enumerate(links, 1):
        (frames / name).unlink()
        (frames / f"flight-{number:05}.jpg").symlink_to(target)


def hold(cpu, until):
    """Keeps everything else from a processor for a quarter of a second now and then."""
    os.sched_setaffinity(0, {cpu})
    os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(1))
    while time.monotonic() < until:
        time.sleep(EVERY_S - HELD_S)
        end = time.monotonic() + HELD_S
        while time.monotonic() < end:
            pass


def hinder(process, seconds):
    """All threads of the solver on one processor, which is taken from them; the camera's stays free."""
    cpu, others = 0, set(os.sched_getaffinity(0)) - {0}
    time.sleep(3)
    for task in pathlib.Path(f"/proc/{process.pid}/task").iterdir():
        name = (task / "comm").read_text().strip()
        solves = re.match(r"(live|solv|worker|rayon)", name)
        os.sched_setaffinity(int(task.name), {cpu} if solves else others)
        print(f"thread {name}: processor {'held' if solves else 'free'}")
    holder = multiprocessing.Process(target=hold, args=(cpu, time.monotonic() + seconds), daemon=True)
    holder.start()


def fly(args, folder):
    """Runs the recorder; results and how many frames were skipped."""
    command = [args.binary, "run", "--config", folder / "wingd.toml"]
    with open(folder / "log", "wb") as log:
        process = subprocess.Popen(command, stderr=log)
    try:
        if args.run == "skipped":
            hinder(process, args.seconds)
        results, _ = listen(process, folder / "live.sock", args.seconds)
        if args.run == "hole":
            (folder / "frames").rename(folder / "away")
            time.sleep(args.hole)
            (folder / "away").rename(folder / "frames")
            more, _ = listen(process, folder / "live.sock", args.seconds + 60)
            results += more
    finally:
        process.terminate()
        process.wait()
    return [result for _, result in results]


def dense(deflections):
    """Cubic through four neighbours (Catmull and Rom do not suffice: Lagrange's), DENSE values an interval."""
    out = []
    for k in range(1, len(deflections) - 2):
        a, b, c, d = deflections[k - 1 : k + 3]
        for j in range(DENSE):
            t = j / DENSE
            out.append(
                -a * t * (t - 1) * (t - 2) / 6
                + b * (t + 1) * (t - 1) * (t - 2) / 2
                - c * (t + 1) * t * (t - 2) / 2
                + d * (t + 1) * t * (t - 1) / 6
            )
    return out


def moments(deflections, share):
    """Moment at a share of the length, any unit, of a cantilever of 30 m whose tip is deflected so."""
    n, length = 200, 30.0
    step = length / n
    eta = [k / n for k in range(n + 1)]
    shear = [0.0] * (n + 1)
    for k in reversed(range(n)):
        shear[k] = shear[k + 1] + step * math.sqrt(1 - (0.5 * (eta[k] + eta[k + 1])) ** 2)
    ground = 0.08

    def at(deflection):
        slope, amplitude = [0.0] * (n + 1), 1e-6
        for _ in range(60):
            moment = [0.0] * (n + 1)
            for k in reversed(range(n)):
                moment[k] = moment[k + 1] + step * 0.5 * (shear[k] + shear[k + 1]) * math.cos(ground + slope[k])
            bent = [m / (1 - 0.7 * e) ** 3.5 for m, e in zip(moment, eta)]
            slope, rise = [0.0], 0.0
            for k in range(n):
                slope.append(slope[k] + amplitude * step * 0.5 * (bent[k] + bent[k + 1]))
                rise += step * (math.sin(ground + 0.5 * (slope[k] + slope[k + 1])) - math.sin(ground))
            if abs(rise - deflection) < 1e-10:
                break
            amplitude *= deflection / rise
        return amplitude * moment[round(share * n)]

    # Smooth in the deflection: three values are a parabola.
    low, high = min(deflections), max(deflections)
    mid = 0.5 * (low + high)
    a, b, c = at(low), at(mid), at(high)
    curve = lambda t: b + 0.5 * (c - a) * t + 0.5 * (a - 2 * b + c) * t * t
    return [curve((deflection - mid) / (high - mid)) for deflection in deflections]


def rainflow(values):
    """Ranges with their counts, 1 or 0.5 (ASTM E1049-85, 5.4.4)."""
    turns = [values[0]]
    for k in range(1, len(values)):
        if values[k] != turns[-1]:
            if len(turns) > 1 and (turns[-1] - turns[-2]) * (values[k] - turns[-1]) > 0:
                turns[-1] = values[k]
            else:
                turns.append(values[k])
    stack, ranges = [], []
    for turn in turns:
        stack.append(turn)
        while len(stack) >= 3 and abs(stack[-1] - stack[-2]) >= abs(stack[-2] - stack[-3]):
            size = abs(stack[-2] - stack[-3])
            if len(stack) == 3:
                ranges.append((size, 0.5))
                stack.pop(0)
            else:
                ranges.append((size, 1.0))
                del stack[-3:-1]
    ranges += [(abs(b - a), 0.5) for a, b in zip(stack, stack[1:])]
    return ranges


def damages(history):
    whole = max(max(history), 0.0) - min(min(history), 0.0)
    ranges = rainflow([0.0, *history, 0.0])
    return {slope: sum(count * (size / whole) ** slope for size, count in ranges) for slope in SLOPES}


def judge(args, folder, results, truth):
    """Prints what is told and how far it is off; whether all is within two standard deviations."""
    (folder / "structure.csv").write_text(STRUCTURE)
    ask = lambda hz: subprocess.run(
        [args.binary, "stress", folder / "store", "--live", "--structure", folder / "structure.csv", "--bending-hz", str(hz), "--json"],
        capture_output=True,
        text=True,
    )
    lines = [json.loads(line) for line in ask(args.bending_hz).stdout.splitlines()]
    solved = sum(r["status"] == "ok" for r in results)
    print(f"{args.run}: {len(results)} results, {solved} with numbers, {results[-1]['skipped']} skipped; load {os.getloadavg()[0]:.1f}")
    first, last = results[0]["exposure_since_boot_s"], results[-1]["exposure_since_boot_s"]
    # What the wing did from the first frame to the last, seen or not.
    count = round((last - first) * RATE_HZ) + 1
    deflections = dense([truth[k % len(truth)] for k in range(-1, count + 2)])
    well = len(lines) == 1
    for line in lines:
        print(f"  {line['frames']} frames, {line['rate_hz']} a second, gaps {json.dumps(line['gaps'])}; {line['no_cycles_because']}")
        for station, share in zip(line["stations"], SHARES):
            dense_damage = damages(moments(deflections, share))
            for told in station["damage"] or []:
                true = dense_damage[told["slope"]]
                off = (told["relative"] - true) / told["sigma_relative"]
                well &= abs(off) < 2
                print(
                    f"  {station['s_m']:4} m, slope {told['slope']:2.0f}: {told['relative']:.4f} +- {told['sigma_relative']:.4f}, true {true:.4f}: {off:+.2f} sigma"
                )
    refused = json.loads(ask(1.9).stdout.splitlines()[0])
    print(f"  a wing that bends at 1.9 Hz: {refused['no_cycles_because']}")
    return well and refused["no_cycles_because"]


def main():
    parser = argparse.ArgumentParser(usage=__doc__.split("usage:")[1].split("\n\n")[0])
    parser.add_argument("--binary", type=pathlib.Path, default=pathlib.Path("target/release/wingd"))
    parser.add_argument("--seconds", type=float, default=180.0)
    parser.add_argument("--hole", type=float, default=1200.0)
    parser.add_argument("--bending-hz", type=float, default=0.95)
    parser.add_argument("run", choices=["whole", "skipped", "hole"])
    parser.add_argument("set", type=pathlib.Path, metavar="SET")
    args = parser.parse_args()
    args.binary, args.rate, args.first_frames = args.binary.resolve(), RATE_HZ, None
    frames = json.loads((args.set / "truth.json").read_text())["frames"]
    flight = sorted((f for f in frames if f["image"] != "ground.jpg"), key=lambda f: f["image"])
    truth = [f["tip_deflection_m"] for f in flight]
    truth += truth[-2:0:-1]
    with tempfile.TemporaryDirectory() as name:
        folder = pathlib.Path(name)
        prepare(args, folder)
        swinging(folder, [f["image"] for f in flight])
        results = fly(args, folder)
        if len(results) < 2:
            sys.exit((folder / "log").read_text())
        well = judge(args, folder, results, truth)
    sys.exit(0 if well else 1)


if __name__ == "__main__":
    main()
