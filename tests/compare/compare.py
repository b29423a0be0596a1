#!/usr/bin/env python3
"""Runs an older and the present program over the same pictures and prints where their detections differ.

compare.py BASE; see README.md beside it. Standard library only.
"""

import hashlib
import json
import math
import os
import shutil
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
CACHE = ROOT / "target" / "compare"
PICTURES = {".jpg", ".jpeg", ".png"}
LIGHTS = ["plain", "gradient", "shadow", "glare", "dusk", "backlight", "haze"]
SEEDS = 35
QUICK_SEEDS = 7
# Farther apart, px, two answers are not one that moved.
NEAR_PX = 5.0
# Lines printed of one picture.
LINES = 12


def run(*command, **options):
    return subprocess.run([str(c) for c in command], check=True, **options)


def said(*command):
    return run(*command, capture_output=True, text=True).stdout.strip()


def build_options():
    return ["build", "--release", "--locked", "--bins", "--test", "layers"]


def base_program(revision):
    """The program of a revision, built in a work tree and a target folder of its own; kept by its commit."""
    try:
        commit = said("git", "-C", ROOT, "rev-parse", "--verify", "--quiet", revision + "^{commit}")
    except subprocess.CalledProcessError:
        sys.exit(f"{revision} is no revision of this repository; git log lists them")
    home = CACHE / commit
    program = home / "wingd"
    if program.exists():
        return program
    home.mkdir(parents=True, exist_ok=True)
    tree, target = home / "tree", home / "target"
    run("git", "-C", ROOT, "worktree", "prune")
    if not tree.exists():
        run("git", "-C", ROOT, "worktree", "add", "--quiet", "--detach", tree, commit)
    try:
        if not target.exists():
            copy_dependencies(target)
        run(os.environ.get("CARGO", "cargo"), *build_options(), "--target-dir", target, cwd=tree)
        shutil.copy2(target / "release" / "wingd", program)
    finally:
        run("git", "-C", ROOT, "worktree", "remove", "--force", tree)
        shutil.rmtree(target, ignore_errors=True)
    return program


def copy_dependencies(target):
    """What is already built need not be built again."""
    (target / "release").mkdir(parents=True)
    for part in ["deps", "build", ".fingerprint"]:
        built = ROOT / "target" / "release" / part
        if built.exists():
            run("cp", "-a", "--reflink=auto", built, target / "release" / part)


def present_program():
    if "WINGD" in os.environ:
        return Path(os.environ["WINGD"]).resolve()
    run(os.environ.get("CARGO", "cargo"), *build_options(), cwd=ROOT)
    return ROOT / "target" / "release" / "wingd"


def pictures_in(folder):
    return sorted(p for p in folder.iterdir() if p.suffix.lower() in PICTURES)


def sets_in(folder):
    """(name, pictures, installation or None) of each folder below that holds pictures."""
    out = []
    for place in sorted([folder, *(p for p in folder.rglob("*") if p.is_dir())]):
        pictures = pictures_in(place)
        installation = place.parent / "installation"
        if pictures:
            known = place.name == "frames" and installation.is_dir()
            out.append((str(place), pictures, installation if known else None))
    return out


def simulated(program, seeds):
    """Sets that the present program renders once: a ground and a flight frame each, the lights in turn."""
    out = []
    for seed in range(1, seeds + 1):
        home = CACHE / "simulated" / f"{seed:02}-{LIGHTS[seed % len(LIGHTS)]}"
        if not (home / "truth.json").exists():
            shutil.rmtree(home, ignore_errors=True)
            home.parent.mkdir(parents=True, exist_ok=True)
            options = ["--seed", seed, "--lights", LIGHTS[seed % len(LIGHTS)], "--tip-deflections", "2.0"]
            run(program, "simulate", "--output", home, *options, stdout=subprocess.DEVNULL,
                stderr=subprocess.DEVNULL)
        out.append((f"simulated {home.name}", pictures_in(home / "frames"), home / "installation"))
    return out


def oriented(program, name, pictures, installation):
    """A copy of an installation with an orientation, or None where the ground frame does not tell one."""
    home = program.parent / "oriented" / name.replace("/", "_").replace(" ", "_")
    ground = [p for p in pictures if p.stem.startswith("ground")]
    if not (home / "orientation.toml").exists():
        shutil.rmtree(home, ignore_errors=True)
        shutil.copytree(installation, home)
        if not ground:
            return None
        done = subprocess.run([program, "orient", "--installation", home, *ground], capture_output=True)
        if done.returncode != 0:
            return None
    return home


def detected(program, pictures, installation):
    """Per picture the program's JSON object."""
    options = ["--json"]
    if "--rejected" in said(program, "detect", "--help"):
        options.append("--rejected")
    if installation:
        options += ["--installation", installation]
    done = subprocess.run([program, "detect", *options, *pictures], capture_output=True, text=True)
    lines = [json.loads(line) for line in done.stdout.splitlines() if line.startswith("{")]
    if len(lines) != len(pictures):
        sys.exit(f"{program} detect answered {len(lines)} of {len(pictures)} pictures: {done.stderr.strip()}")
    for line in lines:
        line.pop("timing_ms", None)
    return lines


def kept(program, pictures, installation):
    """The older program's answers, kept beside it as long as the pictures stay the same."""
    files = [(str(p), p.stat().st_size, p.stat().st_mtime_ns) for p in pictures]
    key = hashlib.sha256(repr((files, str(installation))).encode()).hexdigest()[:16]
    file = program.parent / "answers" / f"{key}.json"
    if not file.exists():
        answers = detected(program, pictures, installation)
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(json.dumps(answers))
    return json.loads(file.read_text())


def apart(one, other):
    return math.hypot(one["u_px"] - other["u_px"], one["v_px"] - other["v_px"])


def paired(old, new):
    """Pairs of answers for one thing, nearest first; then those of the old and of the new alone."""
    near = [(apart(a, b), i, j) for i, a in enumerate(old) for j, b in enumerate(new)
            if a.get("shape") == b.get("shape") and apart(a, b) < NEAR_PX]
    pairs, left, right = [], set(range(len(old))), set(range(len(new)))
    for _, i, j in sorted(near):
        if i in left and j in right:
            pairs.append((old[i], new[j]))
            left.discard(i)
            right.discard(j)
    return pairs, [old[i] for i in sorted(left)], [new[j] for j in sorted(right)]


def place(thing):
    what = thing.get("id") or thing.get("shape") or thing.get("reason")
    return f"{what} at ({thing['u_px']:.2f}, {thing['v_px']:.2f})"


def in_sigmas(old, new):
    """The greatest move along u or v in the old standard deviations, and the greatest ratio of the deviations."""
    moves = [abs(new[f"{k}_px"] - old[f"{k}_px"]) / max(old[f"sigma_{k}_px"], 1e-9) for k in "uv"]
    ratios = [new[f"sigma_{k}_px"] / max(old[f"sigma_{k}_px"], 1e-9) for k in "uv"]
    return max(moves), max(ratios, key=lambda r: abs(math.log(max(r, 1e-9))))


def known(old, new):
    """Of an answer what the older program says too."""
    return {key: new.get(key) for key in old}


class Tally:
    """What differs, over all pictures."""

    def __init__(self, tolerance):
        self.tolerance = tolerance
        self.pictures = self.markers = self.missing = self.extra = self.moved = 0
        self.rejections = self.other = self.differing = 0
        self.most = 0.0

    def differs(self, old, new):
        """Whether one thing's two answers differ by more than is allowed, standard deviations (0: at all)."""
        if self.tolerance == 0.0:
            return old != known(old, new)
        moves, ratio = in_sigmas(old, new)
        same_name = old.get("id") == new.get("id")
        return not same_name or moves > self.tolerance or abs(math.log(ratio)) > self.tolerance

    def picture(self, name, old, new):
        """Prints and counts what differs in one picture."""
        lines = self.markers_of(old["markers"], new["markers"])
        if "rejected" in old and "rejected" in new:
            lines += self.rejected_of(old["rejected"], new["rejected"])
        for key in ["status", "reason", "width", "height", "missing"]:
            if old.get(key) != new.get(key):
                self.other += 1
                lines.append(f"{key}: {old.get(key)} -> {new.get(key)}")
        self.pictures += 1
        self.differing += bool(lines)
        if lines:
            more = [f"... {len(lines) - LINES} more"] if len(lines) > LINES else []
            print(f"{name}\n  " + "\n  ".join(lines[:LINES] + more), flush=True)

    def markers_of(self, old, new):
        pairs, gone, come = paired(old, new)
        self.markers += len(old)
        self.missing += len(gone)
        self.extra += len(come)
        lines = [f"missing: {place(m)}" for m in gone] + [f"extra: {place(m)}" for m in come]
        for a, b in pairs:
            if self.differs(a, b):
                moves, ratio = in_sigmas(a, b)
                self.moved += 1
                self.most = max(self.most, moves)
                name = "" if a.get("id") == b.get("id") else f", {a.get('id')} -> {b.get('id')}"
                lines.append(f"moved: {place(a)} by {apart(a, b):.2g} px, {moves:.2g} standard deviations,"
                             f" sigma x {ratio:.4g}{name}")
        if not lines and self.tolerance == 0.0 and old != [known(a, b) for a, b in zip(old, new)]:
            self.other += 1
            lines.append("the order of the markers")
        return lines

    def rejected_of(self, old, new):
        if old == new or self.tolerance > 0.0 and sorted(map(place, old)) == sorted(map(place, new)):
            return []
        gone = [r for r in old if r not in new]
        come = [r for r in new if r not in old]
        self.rejections += max(len(gone) + len(come), 1)
        return [f"no longer turned down: {place(r)}: {r['reason']}" for r in gone] + [
            f"turned down: {place(r)}: {r['reason']}" for r in come]

    def summary(self):
        return (f"{self.pictures} pictures, {self.markers} markers: {self.differing} pictures differ;"
                f" {self.missing} missing, {self.extra} extra, {self.moved} moved"
                f" (at most {self.most:.2g} standard deviations), {self.rejections} rejections,"
                f" {self.other} other")


def sets(program, quick):
    shared = [Path(s) for s in os.environ.get("SETS", "../shared").split()]
    out = [s for folder in ["fixtures", "tests/pictures", "tests/detect/boards"] for s in sets_in(Path(folder))]
    out += [s for folder in shared if folder.is_dir() for s in sets_in(folder)]
    if quick:
        # Of like pictures a few.
        out = [(n, p if len(p) < 12 and "demo" not in n else p[::6], i) for n, p, i in out]
    return out + simulated(program, QUICK_SEEDS if quick else SEEDS)


def main():
    if len(sys.argv) != 2:
        sys.exit("make compare BASE=revision")
    os.chdir(ROOT)
    quick = os.environ.get("QUICK", "") not in ("", "0")
    tally = Tally(float(os.environ.get("TOLERANCE", "0")))
    base, present = base_program(sys.argv[1]), present_program()
    for name, pictures, installation in sets(present, quick):
        known = oriented(base, name, pictures, installation) if installation else None
        if installation and not known:
            print(f"{name}: without installation only, its ground frame tells no orientation")
        for with_one in [None, known] if known else [None]:
            before, now = kept(base, pictures, with_one), detected(present, pictures, with_one)
            for picture, old, new in zip(pictures, before, now):
                tally.picture(f"{name}: {picture.name}{', with installation' if with_one else ''}", old, new)
    print(tally.summary())
    sys.exit(1 if tally.differing else 0)


if __name__ == "__main__":
    main()
