#!/usr/bin/env python3
"""Detections of a set of frames against its truth: detections.py WINGD SET [plain].

SET has installation/, frames/ and truth.json (`frames`: `image`, `markers` with `id`, `u`, `v`, `visible`). `plain` is without
the installation. Of each frame: markers found, errors, errors over their standard deviations, what else was found, what was
missed and why. Hidden markers that are found and named rightly are nothing extra. Plain Python, no packages."""
import json
import math
import os
import shutil
import subprocess
import sys
import tempfile

wingd, folder = sys.argv[1:3]
plain = "plain" in sys.argv[3:]
frames = json.load(open(os.path.join(folder, "truth.json")))["frames"]
image = lambda frame: os.path.join(folder, "frames", frame["image"])
rms = lambda values: math.sqrt(sum(v * v for v in values) / max(len(values), 1))
lines = lambda out: [json.loads(line) for line in out.splitlines() if line.startswith("{")]


def run(*arguments):
    return subprocess.run([wingd, *arguments], capture_output=True, text=True, check=False).stdout


def near(found, marker):
    off = lambda d: math.hypot(d["u_px"] - marker["u"], d["v_px"] - marker["v"])
    best = min(found, key=off, default=None)
    return best if best and off(best) < 5 else None


total = missed = extra = wrong = 0
errors, normalised = [], []
with tempfile.TemporaryDirectory() as temporary:
    installation = os.path.join(temporary, "installation")
    shutil.copytree(os.path.join(folder, "installation"), installation)
    os.chmod(installation, 0o755)
    where = [] if plain else ["--installation", installation]
    if not plain:
        run("orient", *where, *[image(f) for f in frames if f["image"].startswith("ground.")])
    seen = lines(run("detect", "--json", *where, *map(image, frames)))
for frame, answer in zip(frames, seen):
    left, own, ratios, gone = list(answer.get("markers", [])), [], [], []
    # Visible ones first: a hidden one may lie beside.
    for marker in sorted(frame["markers"], key=lambda m: not m["visible"]):
        best = near(left, marker)
        if best:
            left.remove(best)
            wrong += best.get("id") not in (None, marker["id"])
        if not marker["visible"]:
            continue
        total += 1
        if not best:
            missed += 1
            gone.append(marker["id"])
            continue
        off = [best[k + "_px"] - marker[k] for k in "uv"]
        ratio = [e / best[f"sigma_{k}_px"] for e, k in zip(off, "uv")]
        own.append(math.hypot(*off))
        ratios += ratio
        if max(map(abs, ratio)) > 5:
            print(f"  {frame['image']} {marker['id']}: off by {off[0]:.2f} {off[1]:.2f} px, {max(map(abs, ratio)):.1f} sigma, {marker.get('disturbed', '')}")
    extra += len(left)
    errors += own
    normalised += ratios
    print(f"{frame['image']}: found {len(own)}, rms {rms(own):.3f} px, normalised {rms(ratios):.2f}, extra {len(left)}, missed {' '.join(gone) or 'none'}, ms {answer.get('timing_ms')}")
print(f"missed {missed} of {total}, rms {rms(errors):.3f} px, normalised {rms(normalised):.2f}, extra {extra}, misidentified {wrong}")
