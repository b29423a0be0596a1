"""python -m demo.growth WINGD FOLDER [FLIGHTS...]: how the time of queries and report grows with the number of (synthetic) flights."""

from __future__ import annotations

import json
import resource
import subprocess
import sys
import time
from pathlib import Path

from wingd.fleet import desk, report, snapshot, solves, task
from wingd.fleet.lake import Lake

from . import engines, synthesise
from .prepare import call, fly, record, weigh

SIZES = (20, 200, 2000)
RIGHT = ("--side", "right", "--seed", "7", "--tip-deflections", "2.4,2.2")
QUESTIONS = {
    "deflection by aircraft": "FROM deflection_by_aircraft",
    "line of type": "FROM line_of_type",
    "aircraft against type": "FROM aircraft_against_type",
    "mount by aircraft": "FROM mount_by_aircraft",
    "detection": "FROM detection",
    "reasons of markers": "FROM marker_reasons",
    "failing flights": "FROM failing_flights",
    "two solves": "FROM compared_by_aircraft('onboard', 'recalibrated')",
    "live results": "FROM live_by_flight",
}


def real(wingd: str, folder: Path) -> Lake:
    """Create a lake of two real flights, as recorded: one with aircraft data, one with live results."""
    lake = Lake(f"file://{folder / 'lake'}")
    stores = [record(wingd, folder / "recorder-left"), fly(wingd, folder / "recorder-right", *RIGHT)]
    weigh(wingd, stores[0])
    for store, name in zip(stores, ("D-DEMA", "D-DEMB"), strict=False):
        call(wingd, "upload", str(store), "--to", lake.url, "--aircraft", name)
    solves.define(lake, "onboard", None, [], "as recorded")
    for flight in solves.flights(lake):
        task.run(lake, "onboard", flight, wingd, folder / "work")
    return lake


def measure(lake: Lake, output: Path) -> dict[str, float]:
    """Return seconds of each step in a new process; later queries reuse tables that earlier ones have read."""
    clock = time.perf_counter
    begun = clock()
    asked = desk.Desk(lake)
    times = {"open, frames read": clock() - begun}
    for name, sql in QUESTIONS.items():
        begun = clock()
        asked.rows(sql)
        times[name] = clock() - begun
    begun = clock()
    report.write(asked, output, "recalibrated", "onboard", lake.is_synthetic())
    times["report of what was asked"] = clock() - begun
    times["all, elapsed"] = sum(times.values())
    times["all, processor"] = time.process_time()
    times["frames of two solves"] = asked.rows("SELECT count(*) AS n FROM frames")[0]["n"]
    times["rows of markers"] = asked.rows("SELECT sum(markers)::BIGINT AS n FROM marks")[0]["n"]
    times["report, kB"] = output.stat().st_size / 1e3
    times["most memory, MB"] = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3
    return times


def child(call: str, *arguments: str) -> dict[str, float]:
    """Run a call in a process of its own, to measure its memory."""
    code = f"import sys, json; from pathlib import Path; from wingd.fleet.lake import Lake; from demo.growth import *; print(json.dumps({call}))"
    done = subprocess.run([sys.executable, "-c", code, *arguments], capture_output=True, text=True)
    if done.returncode:
        raise RuntimeError(done.stderr)
    return json.loads(done.stdout)


def compacted(lake: Lake, work: Path) -> dict[str, float]:
    """Write a snapshot; return its time and size."""
    begun = time.perf_counter()
    id = snapshot.make(lake, work)
    sizes = lake.sizes(f"{snapshot.PLACE}/{id}")
    return {
        "compacting": time.perf_counter() - begun,
        "compacting, most memory, MB": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3,
        "files": len(sizes),
        "their MB": sum(sizes.values()) / 1e6,
    }


def main(wingd: str, folder: Path, sizes: list[int]) -> None:
    """Measure queries and report for each number of flights."""
    source, columns = real(wingd, folder), {}
    for size in sizes:
        lake = Lake(f"file://{folder / f'synthetic-{size}'}")
        if len(lake.keys("commits")) < 2 * size:
            synthesise.make(source, lake, size)
        snapshot.remove(lake, snapshot.ids(lake))
        page, work = str(folder / f"synthetic-{size}.html"), str(folder / "work")
        one = {
            f"flight by flight: {name}": v
            for name, v in child("measure(Lake(sys.argv[1]), Path(sys.argv[2]))", lake.url, page).items()
        }
        one |= child("compacted(Lake(sys.argv[1]), Path(sys.argv[2]))", lake.url, work)
        columns[size] = one | child("measure(Lake(sys.argv[1]), Path(sys.argv[2]))", lake.url, page)
    print(f"{'synthetic flights':44}" + "".join(f"{size:>12}" for size in sizes))
    for name in columns[sizes[0]]:
        print(f"{name:44}" + "".join(f"{columns[size][name]:12.2f}" for size in sizes))
    engines.compare(Lake(f"file://{folder / f'synthetic-{sizes[-1]}'}"), "recalibrated", folder / "cache")


if __name__ == "__main__":
    main(str(Path(sys.argv[1]).resolve()), Path(sys.argv[2]).resolve(), [int(n) for n in sys.argv[3:]] or list(SIZES))
