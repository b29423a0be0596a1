"""What demonstration and tests begin with: recorders' stores, and an installation with another calibration."""

from __future__ import annotations

import re
import shutil
import subprocess
from pathlib import Path

# The other calibration: focal lengths longer by a thousandth, what a second calibration may find.
FACTOR = 1.001


def call(wingd: str, *arguments: str, environment: dict[str, str] | None = None, check: bool = True):
    """Runs wingd; with `check` an exit other than 0 is an error that says why."""
    done = subprocess.run([wingd, *arguments], capture_output=True, text=True, env=environment)
    if check and done.returncode != 0:
        raise RuntimeError(f"wingd {' '.join(arguments)}: exit {done.returncode}: {done.stderr}")
    return done


def record(wingd: str, folder: Path) -> Path:
    """A recorder's store with the bundled flight, kept in `folder`."""
    if not (folder / "report.html").exists():
        shutil.rmtree(folder, ignore_errors=True)
        call(wingd, "demo", "--output", str(folder))
    return folder / "store"


def recalibrated(wingd: str, demo: Path, folder: Path) -> Path:
    """The demonstration's installation with the other calibration, oriented anew."""
    shutil.rmtree(folder, ignore_errors=True)
    shutil.copytree(demo / "input/installation", folder, ignore=shutil.ignore_patterns("orientation.toml"))
    camera = folder / "camera.toml"

    def longer(found: re.Match) -> str:
        return f"{found[1]}{float(found[2]) * FACTOR:.1f}"

    camera.write_text(re.sub(r"(?m)^(f[xy] = )([0-9.]+)$", longer, camera.read_text()))
    call(wingd, "orient", "--installation", str(folder), str(demo / "input/frames/ground.jpg"))
    return folder
