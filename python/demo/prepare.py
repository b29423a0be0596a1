"""Test data of demonstration and tests: recorders' stores, aircraft data, and an installation with another calibration."""

from __future__ import annotations

import csv
import datetime
import os
import re
import shutil
import signal
import socket
import subprocess
import time
from pathlib import Path

# Factor on the focal lengths of the other calibration, a plausible difference of a second calibration.
FACTOR = 1.001
# Simulated flight: number of series, interval between them, s, and rate of live results, Hz.
SERIES, INTERVAL_S, LIVE_HZ = 4, 3, 4
# The invented aircraft: deflection of the tip, m per t of weight times load factor, and at 60 t.
SLOPE_M_PER_T, DEFLECTION_AT_60_T_M = 0.060, 1.5
# Weight in the simulated flight, kg.
WEIGHT_KG = 72_000

CONFIGURATION = """installation = "installation"
[camera]
kind = "replay"
folder = "frames"
[store]
path = "store"
reserve_mb = 0
[status]
socket = "wingd.sock"
[series]
interval = "{interval}s"
shots = 2
stale_window = 0
[live]
rate_hz = {rate}
socket = "live.sock"
[live.keep]
ring_mb = 16
mount_disturbed = false
[live.aircraft_data]
udp = "127.0.0.1:{port}"
[[live.aircraft_data.column]]
field = 34
quantity = "weight_kg"
[[live.aircraft_data.column]]
field = 35
quantity = "load_factor"
"""


def call(wingd: str, *arguments: str, environment: dict[str, str] | None = None, check: bool = True):
    """Run wingd; with `check`, a non-zero exit status raises an error with the messages of wingd."""
    done = subprocess.run([wingd, *arguments], capture_output=True, text=True, env=environment)
    if check and done.returncode != 0:
        raise RuntimeError(f"wingd {' '.join(arguments)}: exit {done.returncode}: {done.stderr}")
    return done


def record(wingd: str, folder: Path) -> Path:
    """Create a recorder's store with the bundled flight in `folder`, unless it exists."""
    if not (folder / "report.html").exists():
        shutil.rmtree(folder, ignore_errors=True)
        call(wingd, "demo", "--output", str(folder))
    return folder / "store"


def solve_jointly(wingd: str, folder: Path) -> Path:
    """Create a store as :func:`record`, with aircraft data, and solve it with an installation that has a stiffness and CAD axes."""
    store, installation = record(wingd, folder), folder / "installation"
    if installation.exists():
        return store
    weigh(wingd, store)
    kept = next((store / "installations").iterdir())
    shutil.copytree(kept, installation, ignore=shutil.ignore_patterns("SHA256SUMS"))
    main = installation / "installation.toml"
    more = '\n[structure]\nstiffness = "structure.csv"\n\n[cad]\ntie_points = "tie_points.csv"\nup = "z"\n'
    main.write_text(main.read_text() + more)
    sections = "s_m,ei_n_m2,sigma_ei_n_m2\n2,4.0e8,1.2e7\n10,1.6e8,4.8e6\n"
    (installation / "structure.csv").write_text(sections)
    # The CAD model's origin is elsewhere.
    with (installation / "survey.csv").open() as survey:
        points = [(row["id"], *(float(row[f"{axis}_m"]) for axis in "xyz")) for row in csv.DictReader(survey)][:12]
    tie_points = (f"{name},{x},{y},{z},{x - 30},{y - 50},{z + 1}" for name, x, y, z in points)
    header = "id,x_m,y_m,z_m,cad_x_m,cad_y_m,cad_z_m"
    (installation / "tie_points.csv").write_text("\n".join([header, *tie_points]) + "\n")
    call(wingd, "solve", str(store), "--joint", "--installation", str(installation))
    return store


def fly(wingd: str, folder: Path, *simulated: str) -> Path:
    """Create a recorder's store with a simulated flight, with live results between its series, in `folder`, unless it exists."""
    if (folder / "flown").exists():
        return folder / "store"
    shutil.rmtree(folder, ignore_errors=True)
    call(wingd, "simulate", "--output", str(folder), *simulated)
    if not (folder / "installation/orientation.toml").exists():
        ground = str(folder / "frames/ground.jpg")
        call(wingd, "orient", "--installation", str(folder / "installation"), ground)
    (folder / "frames/ground.jpg").rename(folder / "ground.jpg")
    recorded(wingd, folder)
    (folder / "flown").touch()
    return folder / "store"


def recorded(wingd: str, folder: Path) -> None:
    """Run the recorder on a folder's frames with a feed of aircraft data until it has recorded its series."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as feed:
        feed.bind(("127.0.0.1", 0))
        port = feed.getsockname()[1]
    (folder / "wingd.toml").write_text(CONFIGURATION.format(interval=INTERVAL_S, rate=LIVE_HZ, port=port))
    recorder = subprocess.Popen(
        [wingd, "run", "--config", str(folder / "wingd.toml")], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
    )
    end = time.monotonic() + 60 * INTERVAL_S
    while len(list(folder.glob("store/flights/*/*/results.jsonl"))) < SERIES and time.monotonic() < end:
        send_aircraft_data(port)
        time.sleep(0.2)
    recorder.send_signal(signal.SIGINT)
    recorder.wait(60)
    call(wingd, "verify", str(folder / "store"))


def send_aircraft_data(port: int) -> None:
    """Send a line of aircraft data: the 33 fields of IWG1, then weight and load factor."""
    tag = datetime.datetime.now(datetime.UTC).isoformat().replace("+00:00", "")
    fields = ["IWG1", tag, *[""] * 9, "0.78", *[""] * 21, f"{WEIGHT_KG}", "1.0"]
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as feed:
        feed.sendto((",".join(fields) + "\r\n").encode(), ("127.0.0.1", port))


def weigh(wingd: str, store: Path, off_m: float = 0.0) -> None:
    """Import aircraft data for a store's flight: the weight that its deflections imply, up to an offset of `off_m`."""
    if (store.parent / "weighed").exists():
        return
    text = call(wingd, "export", str(store), "--format", "csv", "--table", "shots").stdout
    lines = ["utc,weight_kg,load_factor,mach"]
    for number, row in enumerate(csv.DictReader(text.splitlines())):
        if row["tip_deflection_m"]:
            load = 60 + (float(row["tip_deflection_m"]) - off_m - DEFLECTION_AT_60_T_M) / SLOPE_M_PER_T
            factor = 1 + 0.02 * (number % 3 - 1)
            at = datetime.datetime.fromisoformat(row["exposure_time"] or row["utc"])
            for seconds in (-0.2, 0.2):
                tag = (at + datetime.timedelta(seconds=seconds)).isoformat().replace("+00:00", "Z")
                lines.append(f"{tag},{1000 * load / factor:.1f},{factor:.3f},0.78")
    flight = next((store / "flights").iterdir()).name
    table = store.parent / "aircraft.csv"
    table.write_text("\n".join(lines) + "\n")
    call(wingd, "aircraft-data", str(store), str(table), "--flight", flight)
    (store.parent / "weighed").touch()


def recalibrated(wingd: str, demo: Path, folder: Path) -> Path:
    """Create a recorder's installation with the other calibration and orients it again."""
    shutil.rmtree(folder, ignore_errors=True)
    source = demo / "input" if (demo / "input").exists() else demo
    ground = next(path for path in (source / "frames/ground.jpg", source / "ground.jpg") if path.exists())
    shutil.copytree(source / "installation", folder, ignore=shutil.ignore_patterns("orientation.toml"))
    camera = folder / "camera.toml"

    def longer(found: re.Match) -> str:
        return f"{found[1]}{float(found[2]) * FACTOR:.1f}"

    camera.write_text(re.sub(r"(?m)^(f[xy] = )([0-9.]+)$", longer, camera.read_text()))
    call(wingd, "orient", "--installation", str(folder), str(ground))
    return folder


def recorder_of(store: Path) -> str:
    """Read a store's id."""
    return re.search(r'(?m)^id = "([^"]+)"', (store / "store.toml").read_text())[1]


def path_with(program: str) -> str:
    """Return PATH with the folder of a program first."""
    return f"{Path(program).parent}:{os.environ['PATH']}"
