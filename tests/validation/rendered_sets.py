"""Rendered wings measured against their truth: docs/validation/data/rendered-sets.csv.

    python3 tests/validation/rendered_sets.py target/release/wingd FOLDER               # those of the page
    python3 tests/validation/rendered_sets.py target/release/wingd FOLDER all           # all of rendered_sets.txt
    python3 tests/validation/rendered_sets.py target/release/wingd FOLDER 51 fixtures/dev

A set is a number of rendered_sets.txt, rendered below FOLDER unless it is there already (half a minute and 7 MB each), or a
directory with installation/, frames/ and truth.json. The table's columns, a row per set, then the means. Nothing but Python
and wingd is needed.
"""

import json
import math
import re
import shutil
import subprocess
import sys
import tempfile
import tomllib
from pathlib import Path

LIGHTS = "plain,gradient,shadow,glare,dusk,backlight,haze"
DEFLECTIONS = "2.8,2.4,2.1,1.8,1.2,0.6,-0.5"
# Number -> options beside lights and deflections; the seed is the number, unless they say otherwise.
SETS = {}
PAGE = []
for line in Path(__file__).with_suffix(".txt").read_text().splitlines():
    number, *options = line.split()
    if number.isdigit():
        SETS[number] = [option for option in options if option != "*"]
        PAGE += [number] if "*" in options else []
FIXTURES = Path(__file__).parents[2] / "fixtures"
# A detection farther from a marker's true image is not that marker's, px.
NEAR = 5.0


def rms(values):
    return math.sqrt(sum(v * v for v in values) / len(values)) if values else math.nan


def rendered(wingd, folder, number):
    """The directory of a set, rendered where it is not there."""
    directory = folder / number
    if not (directory / "truth.json").exists():
        options = SETS[number]
        usual = {"--seed": number, "--lights": LIGHTS, "--tip-deflections": DEFLECTIONS}
        usual = [word for pair in usual.items() if pair[0] not in options for word in pair]
        answers(wingd, "simulate", "--output", directory, *usual, *options)
    return directory


def answers(wingd, *args):
    """The JSON lines of a command; exit status 1 says that some frame has no answer."""
    done = subprocess.run([wingd, *args], capture_output=True, text=True)
    if done.returncode not in (0, 1):
        sys.exit(f"wingd {' '.join(map(str, args))}: {done.stderr.strip()}")
    return [json.loads(line) for line in done.stdout.splitlines() if line.startswith("{")]


class Tally:
    def __init__(self):
        self.visible = self.missed = self.extra = self.wrong = self.frames = 0
        self.off = {"quadrant": [], "circle": []}
        self.normalised = []

    def add(self, truth, found):
        """The detections of a frame, each held against the marker that it is named as."""
        self.frames += 1
        markers = {m["id"]: m for m in truth["markers"]}
        named = {m["id"]: m for m in found if m.get("id")}
        for name, marker in markers.items():
            if not marker["visible"]:
                continue
            self.visible += 1
            seen = named.get(name)
            off = seen and [seen["u_px"] - marker["u"], seen["v_px"] - marker["v"]]
            if not off or math.hypot(*off) > NEAR:
                self.missed += 1
                continue
            self.off[marker["shape"]].append(math.hypot(*off))
            self.normalised += [d / seen[f"sigma_{k}_px"] for k, d in zip("uv", off, strict=True)]
        for seen in found:
            near = [m for m in markers.values() if math.hypot(seen["u_px"] - m["u"], seen["v_px"] - m["v"]) < NEAR]
            self.extra += not any(m["visible"] for m in near)
            self.wrong += bool(seen.get("id")) and seen["id"] not in [m["id"] for m in near]


def solved(wingd, installation, frames, truth, flight):
    """Positions across and up, mm rms, and deflection errors over their standard deviations, rms."""
    options = ["--joint"] if flight else []
    across, up, deflection = [], [], []
    found = answers(wingd, "solve", "--json", *options, "--installation", installation, *frames)
    for frame, answer in zip(truth, found, strict=True):
        markers = {m["id"]: m for m in frame["markers"]}
        for m in answer.get("markers", []):
            true = markers.get(m.get("id"))
            if not true or not m.get("used"):
                continue
            x, y, z = (a - b for a, b in zip(m["position_m"], true["position_m"], strict=True))
            across.append(1e3 * math.hypot(x, y))
            up.append(1e3 * z)
            if m.get("sigma_deflection_m"):
                deflection.append((m["deflection_m"] - true["deflection_m"]) / m["sigma_deflection_m"])
    return rms(across), rms(up), rms(deflection)


def figures(wingd, directory):
    """The figures of a set, in the order of the table."""
    frames = json.loads((directory / "truth.json").read_text())["frames"]

    def image(frame):
        return directory / "frames" / frame["image"]

    with tempfile.TemporaryDirectory() as place:
        installation = shutil.copytree(directory / "installation", Path(place) / "installation")
        file = installation / "installation.toml"
        text = file.read_text()
        # Rendered wings' bending axes are known to some mm, as `wingd simulate` states; other sets' may not say so.
        if "skin_height_sigma_m" not in text:
            file.write_text(re.sub(r"(?m)^(skin_height_m = .*)$", r"\1\nskin_height_sigma_m = 0.003", text))
        ground = [image(f) for f in frames if f["image"].startswith("ground")]
        answers(wingd, "orient", "--installation", installation, *ground)
        found = tomllib.loads((installation / "orientation.toml").read_text())["camera_from_survey"]
        true = next(f for f in frames if f["image"].startswith("ground"))["camera_from_survey"]
        trace = sum(a * b for row, other in zip(found, true, strict=True) for a, b in zip(row, other, strict=True))
        tally = Tally()
        found = answers(wingd, "detect", "--json", "--installation", installation, *map(image, frames))
        for frame, answer in zip(frames, found, strict=True):
            tally.add(frame, answer.get("markers", []))
        flight = [f for f in frames if not f["image"].startswith("ground")]
        one = solved(wingd, installation, map(image, flight), flight, False)
        all_together = solved(wingd, installation, map(image, flight), flight, True)
    every = sorted(tally.off["quadrant"] + tally.off["circle"])
    return [
        100 * tally.missed / tally.visible,
        rms(tally.off["quadrant"]),
        rms(tally.off["circle"]),
        every[len(every) // 2],
        rms(tally.normalised),
        tally.extra / tally.frames,
        tally.wrong,
        1e3 * math.acos(min(1.0, 0.5 * (trace - 1.0))),
        *one,
        *all_together[1:],
    ]


COLUMNS = [
    ("missed_percent", ".1f"),
    ("quadrants_rms_px", ".3f"),
    ("discs_rms_px", ".3f"),
    ("median_px", ".3f"),
    ("normalised", ".2f"),
    ("extra_per_frame", ".2f"),
    ("misidentified", ".0f"),
    ("orientation_mrad", ".2f"),
    ("frame_horizontal_mm", ".1f"),
    ("frame_vertical_mm", ".1f"),
    ("frame_normalised_deflection", ".2f"),
    ("flight_vertical_mm", ".2f"),
    ("flight_normalised_deflection", ".2f"),
]


def row(name, values):
    texts = (format(v, form) if v == v else "not solved" for v, (_, form) in zip(values, COLUMNS, strict=True))
    return ",".join([name, *texts])


def mean(values):
    """Of the sets that were solved."""
    known = [v for v in values if v == v]
    return sum(known) / len(known) if known else math.nan


def main():
    if len(sys.argv) < 3:
        sys.exit(__doc__)
    wingd, folder = Path(sys.argv[1]).resolve(), Path(sys.argv[2])
    if not wingd.is_file():
        sys.exit(f"{wingd} is not there; build it by `make build`")
    names = sys.argv[3:] or [*(str(FIXTURES / name) for name in ("dev", "demo")), *PAGE]
    names = list(SETS) if names == ["all"] else names
    unknown = [name for name in names if name not in SETS and not (Path(name) / "truth.json").exists()]
    if unknown:
        sys.exit(
            f"{unknown[0]} is neither a set of rendered_sets.txt nor a directory with truth.json; give one of them"
        )
    print(",".join(["set", *(name for name, _ in COLUMNS)]))
    all_values = []
    for name in names:
        directory = rendered(wingd, folder, name) if name in SETS else Path(name)
        all_values.append(figures(wingd, directory))
        title = " ".join([directory.name, *SETS.get(name, [])])
        print(row(title, all_values[-1]), flush=True)
    print(row("mean", [mean(column) for column in zip(*all_values, strict=True)]))


if __name__ == "__main__":
    main()
