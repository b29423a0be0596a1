"""Whether a layout that `wingd plan --want` proposes keeps what it promises: for each of five wings the proposal is written,
aircraft that its widths allow are drawn and rendered (`wingd simulate --drawn`), oriented and solved, and the errors of the tip's
deflection are set against the standard deviations that were planned and that were solved.

usage: python3 tests/validation/planned_wings.py WINGD FOLDER [AIRCRAFT]

AIRCRAFT are drawn for each wing, 3 unless stated. Python 3.11 alone.
"""
import json
import math
import re
import subprocess
import sys
from pathlib import Path

# span, height, chord, mm, sensor, markers, fixed, frames, wanted
WINGS = [
    (33, 2.5, 4.0, 12, "4000x3000x1.54", 20, 2, 6, "6mm"),
    (28, 2.2, 3.5, 12, "4000x3000x1.85", 20, 4, 6, "6mm"),
    (24, 1.8, 3.0, 8, "3000x2200x1.85", 18, 2, 5, "8mm"),
    (17, 2.0, 2.6, 8, "4000x3000x1.54", 16, 2, 4, "5mm"),
    (31, 2.8, 4.5, 16, "4000x3000x2.4", 24, 4, 8, "6mm"),
]
# What no scene shows (crates/measure/src/render/drawn.rs): known, so that plan, drawing and solution are of one world.
UNDRAWN = {
    "camera": "readout_s = 0\n",
    "wing": "skin_motion_m = 0\nconstant_bend_sigma_m = 0\nin_plane_sigma_m = 0\ntorque_sigma_deg = 0\nroot_flexibility_sigma_m = 0\n",
}


def wingd(program, *arguments):
    done = subprocess.run([program, *map(str, arguments)], capture_output=True, text=True)
    if done.returncode != 0:
        sys.exit(f"{arguments}: {done.stderr}")
    return done.stdout


def rms(values):
    return math.sqrt(sum(v * v for v in values) / len(values)) if values else float("nan")


def assume(layout):
    """Takes the plan's assumptions, which are comments, as true."""
    file = layout / "installation.toml"
    lines = (line.removesuffix(" # assumed").removeprefix("# ") if line.endswith(" # assumed") else line for line in file.read_text().splitlines())
    file.write_text("\n".join(lines) + "\n")


def in_world(folder):
    """Holds the undrawn widths at 0 in a layout's installation."""
    file = folder / "installation.toml"
    text = file.read_text()
    for section, lines in UNDRAWN.items():
        text = re.sub(rf"(?m)^\[{section}\]\n", f"[{section}]\n{lines}", text)
    file.write_text(text)


def aircraft(program, layout, folder, seed, deflections):
    """Errors of the tip's deflection against the survey and the ground frame with their standard deviations, m, one per frame."""
    wingd(program, "simulate", "--installation", layout, "--drawn", "--seed", seed, "--output", folder, f"--tip-deflections={deflections}")
    ground = folder / "frames/ground.jpg"
    wingd(program, "orient", "--installation", folder / "installation", ground)
    frames = sorted((folder / "frames").glob("flight-*.jpg"))
    said = wingd(program, "solve", "--installation", folder / "installation", "--joint", "--json", "--sigma", "prior", *frames)
    truth = {f["image"]: {m["id"]: m["deflection_m"] for m in f["markers"]} for f in json.loads((folder / "truth.json").read_text())["frames"]}
    found = []
    for result in map(json.loads, said.splitlines()):
        tip = result["tip"]
        deflection = truth[result["image"]][tip["marker"]]
        against_ground = deflection - truth["ground.jpg"][tip["marker"]]
        found.append(((tip["deflection_m"] - deflection, tip["sigma_deflection_m"]), (tip["deflection_ground_m"] - against_ground, tip["sigma_deflection_ground_m"])))
    return found


def main(program, root, count):
    print("| wing | wanted | proposal planned | the same, undrawn known | solved: survey, ground | error rms: survey, ground | normalised: survey, ground |")
    print("|---|---|---|---|---|---|---|")
    everything = [[], []]
    for k, (span, height, chord, focal, sensor, markers, fixed, frames, want) in enumerate(WINGS):
        layout = root / f"layout-{k + 1}"
        options = ["--reach", span, "--height", height, "--chord", chord, "--focal", focal, "--sensor", sensor]
        options += ["--markers", markers, "--fixed", fixed, "--frames", frames, "--want", want, "--layout", layout, "--json"]
        plan = json.loads(wingd(program, "plan", *options))
        assume(layout)
        in_world(layout)
        frames = plan["proposal_frames"]
        again = json.loads(wingd(program, "plan", "--installation", layout, "--frames", max(frames, 2), "--json"))
        planned = again["flight"]["expected"]["sigma_tip_deflection_m"]
        # As the plan takes a flight: from 40 % of the deflection to all of it.
        deflections = ",".join(f"{2.5 * (0.4 + 0.6 * i / max(frames - 1, 1)):.3f}" for i in range(frames))
        found = [aircraft(program, layout, root / f"wing-{k + 1}-{n + 1}", 100 * (k + 1) + n, deflections) for n in range(count)]
        of = lambda which: [frame[which] for flight in found for frame in flight]
        errors = [rms([e for e, _ in of(w)]) for w in (0, 1)]
        sigmas = [rms([s for _, s in of(w)]) for w in (0, 1)]
        normal = [rms([e / s for e, s in of(w)]) for w in (0, 1)]
        for w in (0, 1):
            everything[w] += [e / s for e, s in of(w)]
        pair = lambda values, scale: ", ".join(f"{scale * v:.2f}" if scale == 1 else f"{scale * v:.1f}" for v in values)
        proposal = f"{1e3 * plan['proposal_sigma_m']:.1f} mm{'' if plan['proposal_reached'] else ', not reached'}"
        print(f"| {span} m, {frames} frames | {want} | {proposal} | {1e3 * planned:.1f} mm | {pair(sigmas, 1e3)} mm | {pair(errors, 1e3)} mm | {pair(normal, 1)} |", flush=True)
    print(f"\nall: normalised {rms(everything[0]):.2f} against the survey, {rms(everything[1]):.2f} against the ground frame")


if __name__ == "__main__":
    if len(sys.argv) < 3:
        sys.exit(__doc__)
    main(sys.argv[1], Path(sys.argv[2]), int(sys.argv[3]) if len(sys.argv) > 3 else 3)
