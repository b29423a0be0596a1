#!/usr/bin/env python3
"""Figures of README and pages: runs the commands that give them, and rewrites or checks them.

    python3 tests/validation/figures.py                  # rewrites all: make docs-figures
    python3 tests/validation/figures.py --check          # compares; exit 1 if one differs
    python3 tests/validation/figures.py --pages          # each block has its template's text; needs no program
    python3 tests/validation/figures.py --check window   # the blocks whose names begin so
    python3 tests/validation/figures.py --kept           # from the outputs of the last run

The lines of a page between `<!-- figures NAME -->` and `<!-- end -->` are the section NAME of figures.md, with the figures
in place of their names in braces. Outputs of the commands are kept in target/figures. Times are compared within a factor,
other numbers within one unit of their last digit. A command that fails is said, and the others run. Needs the programs of
`make build`, cargo and Python 3.11. benches/peers.sh installs the peers of the times, OpenCV and SciPy.
"""

import json
import os
import re
import shutil
import statistics
import subprocess
import sys
import tempfile
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))
from rendered_sets import FIXTURES, answers, rms, solved  # noqa: E402

ROOT = Path(__file__).parents[2]
WINGD = Path(os.environ.get("WINGD", ROOT / "target/release/wingd")).resolve()
# Factor within which times agree: other programs run on the machines that check them.
TIMES = 2.0
TIMED = ("benches", "recorder")
# Figures are of all draws, as in make test-long.
os.environ["WINGD_DRAWS"] = "all"


class Failed(Exception):
    """A command, or a figure that its output does not have."""


def run(*command):
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
    if done.returncode != 0:
        raise Failed(f"{' '.join(map(str, command))}: {done.stderr.strip()[-2000:]}")
    return done.stdout + done.stderr


def test(binary, *names):
    """Output of tests, in the order of their names."""
    return lambda: run("cargo", "test", "--release", "--locked", "--test", binary, "--", "--nocapture", *names)


def flights():
    """The bundled flights from frames to positions, with their installations as they are; rounded by the figures alone."""
    lines = []
    for name in ("dev", "demo"):
        directory = FIXTURES / name
        frames = json.loads((directory / "truth.json").read_text())["frames"]
        ground = [f for f in frames if f["image"].startswith("ground")]
        flight = [f for f in frames if f not in ground]
        image = [directory / "frames" / f["image"] for f in flight]
        with tempfile.TemporaryDirectory() as place:
            installation = shutil.copytree(directory / "installation", Path(place) / "installation")
            answers(WINGD, "orient", "--installation", installation, directory / "frames" / ground[0]["image"])
            for label, options in (("one frame", []), ("flight", ["--joint"])):
                across, up, over = solved(WINGD, installation, image, flight, bool(options))
                found = answers(WINGD, "solve", "--json", *options, "--installation", installation, *image)
                sigma = statistics.median(1e3 * f["tip"][key(f["tip"])] for f in found)
                tip = rms([1e3 * tip_error(f["tip"], t) for f, t in zip(found, flight, strict=True)])
                torsion = rms([f["torsion"][0]["angle_deg"] - t["torsion_deg"] for f, t in zip(found, flight, strict=True)])
                lines.append(
                    f"{name}, {label}: horizontal {across:.4f} up {up:.4f} over {over:.4f} sigma {sigma:.4f} tip {tip:.4f} torsion {torsion:.6f}"
                )
    return "\n".join(lines)


def key(tip):
    """Name of the standard deviation of the reported deflection."""
    suffix = {"survey": "", "ground": "_ground", "root": "_root"}[tip["reference"]]
    return f"sigma_deflection{suffix}_m"


def tip_error(tip, truth):
    """Error of the reported deflection, m. The three references are one in rendered flights."""
    true = next(m["deflection_m"] for m in truth["markers"] if m["id"] == tip["marker"])
    return tip[key(tip).removeprefix("sigma_")] - true


def recorder():
    """Live mode through the recorder, as in docs/live/figures.md, and the memory of a detection."""
    with tempfile.TemporaryDirectory() as place:
        options = ["--gusts", "5", "--tip-deflections", "2.3", "--remount", "1", "--seed", "38"]
        run(WINGD, "simulate", "--output", place + "/set", "--installation", FIXTURES / "dev/installation", *options)
        measure = [sys.executable, ROOT / "tests/live/measure.py", "--binary", WINGD, "--rate", "10", "--seconds", "60", place + "/set"]
        text = subprocess.run(measure, cwd=ROOT, capture_output=True, text=True).stdout
    frame = str(FIXTURES / "dev/frames/flight-1.jpg")
    child = f"import resource, subprocess; subprocess.run([{str(WINGD)!r}, 'detect', {frame!r}], capture_output=True); "
    child += "print(f'detect: {resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss / 1024:.0f} MB')"
    return text + run(sys.executable, "-c", child)


def benches():
    """Medians of the benches and of their peers, one thread, ms; the peers before and after, because other programs run too."""
    python = run("sh", "benches/peers.sh").splitlines()[0]
    os.environ["RAYON_NUM_THREADS"] = "1"

    def peers():
        opencv = run(python, "benches/opencv_peer.py", "fixtures/dev/frames/flight-1.jpg")
        scipy = run(python, "benches/scipy_peer.py")
        chain, spatial = re.search(r"chain +([\d.]+) ms", opencv)[1], re.search(r": ([\d.]+) ms", scipy)[1]
        return {"opencv": float(chain), "scipy": float(spatial)}

    before = peers()
    run("cargo", "bench", "--locked", "--bench", "frame", "--bench", "detect", "--bench", "adjust")
    after = peers()
    lines = [f"{peer}: {0.5 * (before[peer] + after[peer]):.4f}" for peer in before]
    ratio = max(max(before[p], after[p]) / min(before[p], after[p]) for p in before)
    lines.append(f"spread: {100 * (ratio - 1):.0f}")
    for file in sorted((ROOT / "target/criterion").glob("**/new/benchmark.json")):
        median = json.loads(file.with_name("estimates.json").read_text())["median"]["point_estimate"]
        lines.append(f"{json.loads(file.read_text())['full_id']}: {1e-6 * median:.4f}")
    opencv = float(lines[0].split()[1])
    ratios = [f"{line.split(': ')[0]} over opencv: {float(line.split(': ')[1]) / opencv:.4f}" for line in lines[3:]]
    return "\n".join(lines + ratios)


SOURCES = {
    "flights": flights,
    "benches": benches,
    "recorder": recorder,
    "fixtures": test("detect", "fixtures"),
    "accuracy": test("adjust", "spatial::", "flight::"),
    "window": test("adjust", "window"),
    "camera": test("adjust", "shifted_by_a_remount", "fixed_targets_determine", "mounting_known_to_be"),
    "coverage": test("adjust", "coverage::"),
    "identification": test("adjust", "identification::"),
    "live": test("adjust", "live::deflections", "live::a_mount_disturbance", "live::a_wrong_image", "live::the_last_of"),
    "dimensions": test("adjust", "uncertainties_are_in_the_sigma_of_a_frame", "deflections_keep_their_sigma", "in_400_frames"),
    "publication": test("adjust", "profile_figures::"),
}
NUMBER = r"(-?[\d.]+)"


def flight_row(name, label):
    pattern = f"{name}, {label}: horizontal # up # over #"
    return ("flights", pattern, "{:.1f} mm | {:.1f} mm | {:.2f}")


def tip_row(name):
    lines = [f"^{name}, {label}: .* sigma # tip #" for label in ("one frame", "flight")]
    return ("flights", "[\\s\\S]*?".join(lines), "{1:.0f} mm | {0:.0f} mm | {3:.0f} mm | {2:.0f} mm")


def fixture_row(name):
    pattern = f"^{name}: missed # of #, .*median # px, quadrants # .other light #., circles # .#., normalised #"
    return ("fixtures", pattern, "{:.0f} of {:.0f} | {:.3f} | {:.3f}, {:.3f} | {:.3f}, {:.3f} | {:.2f}")


def bench_row(name, form):
    escaped = re.escape(name)
    return ("benches", f"^{escaped}: #$[\\s\\S]*?^{escaped} over opencv: #", form)


def digits(value, count):
    """A number with some significant digits, without an exponent."""
    return f"{float(f'{value:.{count}g}'):g}"


def accuracy_row(line):
    pattern = f"^{line}: horizontal # mm, vertical # mm.*normalised (?:deflection )?#"
    return ("accuracy", pattern, "{:.1f} mm | {:.1f} mm | {:.2f}")


def window_row(line):
    return ("window", f"^{line}: deflection # mm rms, normalised #", "{:.1f} mm | {:.2f}")


def shift_row(flight):
    lines = [f"^flight {flight}, shift {mm} mm: normalised #, sigma # mm .fixed #" for mm in (0, 1, 2, 5)]
    return ("camera", "[\\s\\S]*?".join(lines), "{0:.2f} | {3:.2f} | {6:.2f} | {9:.2f} | {1:.1f} mm | {2:.1f} mm")


def fixed_row(line, form):
    lines = [f"^{n} fixed: {line}" for n in (0, 1, 2, 4)]
    return ("camera", "[\\s\\S]*?".join(lines), " | ".join(4 * [form]))


def live_row(begins):
    return ("live", f"^{begins}: deflection # mm rms, normalised #, sigma of the tip # mm", "{:.1f} mm | {:.2f} | {:.1f} mm")


ACCURACY = {
    "one-alone": "2 mm, 0.05 px, rotation only",
    "one": "2 mm, 0.05 px, ground observations",
    "flight": "shared shape",
    "fuel": "burning fuel",
    "flight-alone": "shared shape, rotation only",
    "fuel-alone": "burning fuel, rotation only",
}
WINDOW = {
    "undescribed": "in flight only, not described",
    "described": "in flight only, described",
    "ground": "on ground too, not described",
    "bowed": "bowed to 10 m, described as plane",
    "bow": "bowed to 10 m, described as it is, to a quarter",
    "default": "in flight only, not described, remount shift",
}
FRAME_BENCHES = {
    "read": "frame/read",
    "decode": "frame/decode",
    "full": "frame/detect full",
    "guided": "frame/detect guided",
    "orient": "frame/orient",
    "identify": "frame/identify",
    "bias": "frame/remove perspective bias",
}
ADJUST_BENCHES = {
    "profile": "profile, 21 markers",
    "spatial": "spatial, 21 markers",
    "laboratory": "spatial without in-flight effects, 21 markers",
    "flight-10": "flight/10 frames",
    "flight-85": "flight/85 frames",
}

# Name -> source, pattern (# is a number), text.
FIGURES = {
    **{f"flight-{n}-{k}": flight_row(n, l) for n in ("dev", "demo") for k, l in (("one", "one frame"), ("all", "flight"))},
    **{f"tip-{n}": tip_row(n) for n in ("dev", "demo")},
    "fixtures-dev": fixture_row("dev"),
    "fixtures-moved": fixture_row("dev, moved"),
    "fixtures-noisy": fixture_row("dev, noisy"),
    "fixtures-blurred": fixture_row("dev, blurred"),
    "fixtures-all": fixture_row("dev, all"),
    "fixtures-demo": fixture_row("demo"),
    **{f"accuracy-{k}": accuracy_row(line) for k, line in ACCURACY.items()},
    "accuracy-paper": ("accuracy", "^5 px, 5 mm: spatial # mm, profile # mm", "{:.0f} mm | {:.0f} mm"),
    **{f"window-{k}": window_row(line) for k, line in WINDOW.items()},
    "shift-one": shift_row("false"),
    "shift-flight": shift_row("true"),
    "fixed-rms": fixed_row("# mm rms, normalised [\\d.]+, largest sigma [\\d.]+ mm", "{:.1f} mm"),
    "fixed-over": fixed_row("[\\d.]+ mm rms, normalised #, largest sigma [\\d.]+ mm", "{:.2f}"),
    "fixed-sigma": fixed_row("[\\d.]+ mm rms, normalised [\\d.]+, largest sigma # mm", "{:.1f} mm"),
    "mounting-known": ("camera", "^flight false: known [\\d.]+, sigma # mm; not declared [\\d.]+, sigma # mm", "{1:.1f} mm; {0:.1f} mm"),
    "coverage": (
        "coverage",
        "^sampled over predicted: position #, deflection #, torsion #, twist #",
        "position {:.2f}, deflection {:.2f}, torsion {:.2f}, twist {:.2f}",
    ),
    "coverage-rejects": ("coverage", "^rejects # % at 5 %", "{:.1f} %"),
    "coverage-found": ("coverage", "^found # of #", "{:.0f} of {:.0f}"),
    "identified": ("identification", "^flight: Tally . visible: #, right: #, wrong: #", "{1:.0f} of {0:.0f}"),
    "oriented": ("identification", "^ground: .*error median # mrad, p95 #", "{:.2f} mrad median, {:.2f} mrad 95 %"),
    "bias-of-discs": ("identification", "^bias: rms # px before, # px after", "{:.3f} px; {:.3f} px"),
    "orientation": (
        "identification",
        "^orientation, mrad: exact pixels of all markers #, of those found #, image #",
        "{:.3f} mrad with exact pixels of all 21 markers, {:.3f} with those of the 20 that are found, {:.3f} with the pixels of the image",
    ),
    **{f"live-{n}": live_row(f"frame {n:2}") for n in (1, 5, 15, 30, 60)},
    "live-alone": live_row("alone"),
    "live-disturbed": ("live", "^mount_disturbed of .*once # of #, normalised #, 2 s later #", "{0:.0f} of {1:.0f} wings, {2:.2f} σ in that frame, {3:.2f} after 2 s"),
    "live-excluded": ("live", "^wrong images excluded: # of #", "{:.0f} of {:.0f}"),
    "live-together": ("live", "^as they came against together: # sigma apart, normalised # and #", "{0:.2f} σ from the joint adjustment, errors {1:.2f} and {2:.2f} σ"),
    "dimensions-one": ("dimensions", "^All: normalised deflection rms #, largest [\\d.]+$", "{:.2f}"),
    **{f"mountings-{k}": ("dimensions", f"^{k}: normalised deflection rms #", "{:.2f}") for k in ("Own", "Alternating", "Creeping")},
    "long-flights": (
        "dimensions",
        "^survey points removed # of 147, images removed # of #",
        "{:.0f} of 147 correct survey points and {:.0f} of {:,.0f} correct images",
    ),
    **{f"slope-{s}": ("publication", f"^slope {s}: bias # mm", "{:.1f}") for s in ("0.03", "0.06", "0.0875")},
    **{f"bench-{k}": bench_row(line, lambda ms, times: f"{digits(ms, 2)} ms | {digits(times, 2)}") for k, line in FRAME_BENCHES.items()},
    **{f"bench-{k}": bench_row(line, lambda ms, _: f"{digits(ms, 3)} ms") for k, line in ADJUST_BENCHES.items()},
    "live-results": ("recorder", "^results +# a second; # without numbers", "{:.1f}; {:.0f}"),
    "live-latency": ("recorder", "^latency +median # ms, 95 % # ms", "{:.0f} ms; {:.0f} ms"),
    "live-skipped": ("recorder", "^skipped +#", "{:.0f}"),
    "live-memory": ("recorder", "^memory +# MB", "{:.0f} MB"),
    "live-processor": ("recorder", "^processor +# ms", "{:.0f} ms"),
    "live-deflections": ("recorder", "^deflections, .*rms # mm, normalised #", "{:.1f} mm; {:.2f}"),
    "detect-memory": ("recorder", "^detect: # MB", "{:.0f} MB"),
    "bench-opencv": ("benches", "^opencv: #", "{:.0f} ms"),
    "bench-scipy": ("benches", "^scipy: #", "{:.0f} ms"),
    "bench-live": ("benches", "^live, 21 markers: #", "{:.1f} ms"),
    "bench-points": (
        "benches",
        r"^points/12: #$[\s\S]*?^points/none: #$",
        lambda points, none: f"{(points - none) / 12:.2f} ms",
    ),
    "bench-clutter": (
        "benches",
        "^detect rendered/backlight: #$[\\s\\S]*^detect rendered/dusk: #$[\\s\\S]*^detect rendered/glare: #$[\\s\\S]*^detect rendered/gradient: #$"
        "[\\s\\S]*^detect rendered/haze: #$[\\s\\S]*^detect rendered/plain: #$[\\s\\S]*^detect rendered/shadow: #$",
        "plain {5:.0f} ms, gradient {3:.0f}, dusk {1:.0f}, glare {2:.0f}, shadow {6:.0f}, back light {0:.0f}, haze {4:.0f}",
    ),
}


def found(name, outputs):
    source, pattern, form = FIGURES[name]
    text = outputs[source] if source in outputs else produced(source, outputs)
    match = re.search(pattern.replace("#", NUMBER), text, re.M)
    if not match:
        raise Failed(f"the output of {source} has no `{pattern}`; see target/figures/{source}.txt")
    values = [float(group) for group in match.groups()]
    return form(*values) if callable(form) else form.format(*values)


def produced(source, outputs):
    file = ROOT / f"target/figures/{source}.txt"
    if "--kept" not in sys.argv or not file.exists():
        print(f"running {source}", file=sys.stderr, flush=True)
        file.parent.mkdir(parents=True, exist_ok=True)
        try:
            file.write_text(SOURCES[source]())
        except Failed as error:
            print(error, file=sys.stderr, flush=True)
            file.write_text("")
    outputs[source] = file.read_text()
    return outputs[source]


def agree(old, new, name):
    """Whether two texts differ by less than their figures state."""
    words = [re.sub(r"-?\d+(\.\d+)?", "#", text) for text in (old, new)]
    if words[0] != words[1]:
        return False
    for a, b in zip(re.findall(r"-?\d+(?:\.\d+)?", old), re.findall(r"-?\d+(?:\.\d+)?", new), strict=True):
        last = 10.0 ** -len(a.partition(".")[2])
        near = abs(float(a) - float(b)) <= 1.01 * last
        times = FIGURES[name][0] in TIMED and float(b) <= TIMES * float(a) and float(a) <= TIMES * float(b)
        if not near and not times:
            return False
    return True


def templates():
    """Text of each block, by its name."""
    sections = Path(__file__).with_suffix(".md").read_text().split("\n## ")[1:]
    return {name.strip(): text.strip() for name, _, text in (section.partition("\n") for section in sections)}


def names(template):
    return re.findall(r"\{([\w.-]+)\}", template)


def shown(template, block):
    """The figures of a block by their names; None if its text is not the template's."""
    parts = re.split(r"\{[\w.-]+\}", template)
    match = re.fullmatch("(.+?)".join(map(re.escape, parts)), block.strip())
    return match and dict(zip(names(template), match.groups(), strict=True))


def pages():
    """Each page with its text."""
    return [(page, page.read_text()) for page in [ROOT / "README.md", *sorted((ROOT / "docs").glob("**/*.md"))]]


BLOCK = re.compile(r"(?ms)^<!-- figures ([\w.-]+) -->\n(.*?)^<!-- end -->$")


def check_pages():
    """Faults of the blocks that show without the program."""
    known, faults, used = templates(), [], []
    for page, text in pages():
        for name, block in BLOCK.findall(text):
            used.append(name)
            if name not in known or not shown(known[name], block):
                faults.append(f"{page.relative_to(ROOT)}: {name} differs from its template; run make docs-figures")
    figures = [figure for template in known.values() for figure in names(template)]
    faults += [f"figures.md: no page shows {name}" for name in known if name not in used]
    faults += [f"figures.md: {figure} has no command" for figure in figures if figure not in FIGURES]
    faults += [f"figures.py: no block shows {figure}" for figure in FIGURES if figure not in figures]
    return faults


def main():
    arguments = sys.argv[1:]
    if "--pages" in arguments:
        faults = check_pages()
        print("\n".join(faults) or f"{len(templates())} blocks with {len(FIGURES)} figures")
        sys.exit(1 if faults else 0)
    check = "--check" in arguments
    begins = next((a for a in arguments if not a.startswith("--")), "")
    wrong, failed, outputs, known = [], [], {}, templates()
    for page, text in pages():

        def written(match):
            name, block = match[1], match[2]
            if name not in known:
                sys.exit(f"{page.relative_to(ROOT)}: {name} is no section of figures.md")
            if not name.startswith(begins):
                return match[0]
            old, template = shown(known[name], block) or {}, known[name]
            for figure in names(template):
                before = old.get(figure, "")
                try:
                    new = found(figure, outputs)
                except Failed as error:
                    failed.append(f"{page.relative_to(ROOT)}: {figure}: {error}")
                    new = before
                if not (agree(before, new, figure) if check else before == new):
                    wrong.append(f"{page.relative_to(ROOT)}: {figure}: {before} -> {new}")
                template = template.replace(f"{{{figure}}}", new)
            return f"<!-- figures {name} -->\n{template}\n<!-- end -->"

        changed = BLOCK.sub(written, text)
        if changed != text and not check:
            page.write_text(changed)
    print("\n".join(wrong + failed) or "all figures agree with their commands")
    sys.exit(1 if failed or check and wrong else 0)


if __name__ == "__main__":
    main()
