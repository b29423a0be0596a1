"""python -m demo WINGD FOLDER"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

from .prepare import recalibrated, record
from .server import BUCKET, Server

LAKE = f"s3://{BUCKET}/demo"
AIRCRAFT = ("D-DEMA", "D-DEMB")


def main(wingd: str, folder: Path) -> None:
    fleet = str(Path(sys.executable).with_name("wingd-fleet"))
    recorders = [record(wingd, folder / f"recorder-{name}") for name in AIRCRAFT]
    installation = recalibrated(wingd, recorders[0].parent, folder / "recalibrated")
    shutil.rmtree(folder / "server", ignore_errors=True)
    shutil.rmtree(folder / "cache", ignore_errors=True)
    with Server(folder / "server") as server:
        environment = {**os.environ, **server.environment, "WINGD": wingd}

        def step(*command: str) -> None:
            print("\n$ " + " ".join(command), flush=True)
            subprocess.run(command, env=environment, check=True)

        for store, name in zip(recorders, AIRCRAFT):
            step(wingd, "upload", str(store), "--to", LAKE, "--aircraft", name, "--aircraft-type", "DEMO")
        step(fleet, "flights", "--lake", LAKE)
        step(fleet, "define", "--lake", LAKE, "--solve", "onboard", "--kept")
        other = [part for name in AIRCRAFT for part in ("--installation", f"{name}={installation}")]
        step(fleet, "define", "--lake", LAKE, "--solve", "recalibrated", *other)
        for solve in ("onboard", "recalibrated"):
            step(fleet, "run", "--lake", LAKE, "--solve", solve, "--workers", "2")
        catalogue = folder / "catalogue.db"
        catalogue.unlink(missing_ok=True)
        for solve in ("onboard", "recalibrated"):
            step(fleet, "iceberg", "--lake", LAKE, "--solve", solve, "--catalogue", f"sqlite:///{catalogue}")
        cache = ["--cache", str(folder / "cache")]
        asked = "SELECT aircraft, frames, round(1000 * mean_m, 2) AS mean_mm FROM compared_by_aircraft('onboard', 'recalibrated')"
        step(fleet, "query", "--lake", LAKE, *cache, asked)
        report = ["--solve", "recalibrated", "--against", "onboard", "--output", str(folder / "fleet.html")]
        step(fleet, "report", "--lake", LAKE, *cache, *report)
    print(f"\nReport: {folder / 'fleet.html'}")


if __name__ == "__main__":
    main(str(Path(sys.argv[1]).resolve()), Path(sys.argv[2]).resolve())
