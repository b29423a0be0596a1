"""``python -m demo WINGD FOLDER``: a fleet from recorders to a report on this machine.

Two different aircraft, one with both wings, a ground trial that is withdrawn, and an object that is damaged and repaired.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import time
from pathlib import Path

from wingd.fleet.lake import Lake

from .prepare import fly, path_with, recalibrated, record, recorder_of, weigh
from .server import BUCKET, Server

LAKE = f"s3://{BUCKET}/demo"
# Difference of tip deflection between the second and the first aircraft at the same load, m.
DIFFERS_M = 0.15


def prepared(wingd: str, folder: Path) -> dict[str, tuple[Path, str, str]]:
    """Create the stores of four recorders, with aircraft and wing: three bundled flights and a simulated right wing."""
    stores = {
        "left": (record(wingd, folder / "recorder-left"), "D-DEMA", "left"),
        "right": (
            fly(wingd, folder / "recorder-right", "--side", "right", "--seed", "7", "--tip-deflections", "2.4,2.2"),
            "D-DEMA",
            "right",
        ),
        "other": (record(wingd, folder / "recorder-other"), "D-DEMB", "left"),
        "trial": (record(wingd, folder / "recorder-trial"), "D-DEMB", "right"),
    }
    weigh(wingd, stores["left"][0])
    weigh(wingd, stores["other"][0], DIFFERS_M)
    return stores


def damage(environment: dict[str, str]) -> None:
    """Flips one bit of a table, like a bad disk of the object store."""
    os.environ.update(environment)
    lake = Lake(LAKE)
    key = next(key for key in lake.keys("tables") if "/shots/" in key)
    data = bytearray(lake.need(key))
    data[len(data) // 3] ^= 1
    lake.replace(key, bytes(data))
    print(f"\n(one bit of {key} was flipped)", flush=True)


def main(wingd: str, folder: Path) -> None:
    """Run the demonstration with the program `wingd` in `folder`."""
    begun = time.monotonic()
    fleet = str(Path(sys.executable).with_name("wingd-fleet"))
    stores = prepared(wingd, folder)
    for name in ("server", "cache", "work"):
        shutil.rmtree(folder / name, ignore_errors=True)
    with Server(folder / "server") as server:
        environment = {**os.environ, **server.environment, "WINGD": wingd, "HOME": str(folder / "cache")}
        environment["PATH"] = path_with(sys.executable)

        def step(*command: str, check: bool = True) -> None:
            print("\n$ " + " ".join(part if " " not in part else f'"{part}"' for part in command), flush=True)
            subprocess.run(command, env=environment, check=check)

        def ask(word: str, *more: str, check: bool = True) -> None:
            step(fleet, word, "--lake", LAKE, *more, check=check)

        for store, aircraft, wing in stores.values():
            kind = "DEMO-A" if wing == "right" and aircraft == "D-DEMA" else "DEMO"
            step(
                wingd,
                "upload",
                str(store),
                "--to",
                LAKE,
                "--aircraft",
                aircraft,
                "--aircraft-type",
                kind,
                "--wing",
                wing,
            )
        ask(
            "correct",
            "aircraft=D-DEMA",
            "--set",
            "aircraft_type=DEMO",
            "--why",
            "the right wing was uploaded with a wrong type",
        )
        ask("flights")
        ask("define", "--solve", "onboard", "--kept")
        own = []
        for name, (store, *_) in stores.items():
            installation = recalibrated(wingd, store.parent, folder / f"recalibrated-{name}")
            own += ["--installation", f"{recorder_of(store)[:8]}={installation}"]
        ask("define", "--solve", "recalibrated", *own)
        for solve in ("onboard", "recalibrated"):
            ask("run", "--solve", solve, "--workers", "2")
        trial = f"{recorder_of(stores['trial'][0])[:8]}/f0001"
        ask("withdraw", trial, "--why", "a trial on ground, not a flight")
        damage(environment)
        asked = "SELECT aircraft, wing, flights, round(deflection_m, 3) AS deflection_m FROM deflection_by_aircraft WHERE solve = 'onboard'"
        ask("query", asked, check=False)
        ask("verify", check=False)
        ask("repair")
        ask("compact", "--prune")
        ask("query", asked)
        ask(
            "query",
            "SELECT aircraft, wing, frames, round(1000 * mean_m, 2) AS mean_mm FROM compared_by_aircraft('onboard', 'recalibrated')",
        )
        ask(
            "query",
            "SELECT aircraft, wing, results, round(rate_hz, 1) AS rate_hz, round(deflection_m, 3) AS deflection_m FROM live_by_flight",
        )
        along = (
            "SELECT aircraft, wing, eta, arc_length_m, round(deflection_m, 3) AS deflection_m, round(1000 * sigma_m, 1) AS sigma_mm "
            "FROM shape_by_wing WHERE solve = 'recalibrated' ORDER BY ALL"
        )
        ask("query", along)
        ask("corrections")
        ask("report", "--solve", "recalibrated", "--against", "onboard", "--output", str(folder / "fleet.html"))
    # The lake cannot be used without its server.
    shutil.rmtree(folder / "server")
    print(f"\nReport: {folder / 'fleet.html'} ({time.monotonic() - begun:.0f} s)")


if __name__ == "__main__":
    main(str(Path(sys.argv[1]).resolve()), Path(sys.argv[2]).resolve())
