"""python -m demo.growth WINGD FOLDER [FLIGHTS...]: how questions and report grow with the number of (synthetic) flights."""

from __future__ import annotations

import json
import resource
import subprocess
import sys
import time
from pathlib import Path

from wingd_fleet import desk, engines, report, solves, synthesise, task
from wingd_fleet.lake import Lake

from .prepare import call, record

SIZES = (20, 200, 2000)
QUESTIONS = {
    "lift by aircraft": "FROM lift_by_aircraft",
    "line of type": "FROM line_of_type",
    "aircraft against type": "FROM aircraft_against_type",
    "mount by aircraft": "FROM mount_by_aircraft",
    "detection": "FROM detection",
    "reasons of markers": "FROM marker_reasons",
    "failing flights": "FROM failing_flights",
    "two solves": "FROM compared_by_aircraft('onboard', 'recalibrated')",
}


def real(wingd: str, folder: Path) -> Lake:
    """A lake of two real flights, as recorded."""
    lake = Lake(f"file://{folder / 'lake'}")
    for name in ("D-DEMA", "D-DEMB"):
        store = record(wingd, folder / f"recorder-{name}")
        call(wingd, "upload", str(store), "--to", lake.url, "--aircraft", name)
    solves.define(lake, "onboard", None, [], "as recorded")
    for flight in lake.flights():
        task.run(lake, "onboard", flight, wingd, folder / "work")
    return lake


def measure(lake: Lake, output: Path) -> dict[str, float]:
    """Seconds of each step, as a new process does it: what a question reads first it need not read again."""
    clock = time.perf_counter
    begun = clock()
    asked = desk.Desk(lake)
    times = {"open, frames read": clock() - begun}
    for name, sql in QUESTIONS.items():
        begun = clock()
        asked.rows(sql)
        times[name] = clock() - begun
    begun = clock()
    report.write(asked, output, "recalibrated", "onboard", synthesise.is_made(lake))
    times["report of what was asked"] = clock() - begun
    times["all, elapsed"] = sum(times.values())
    times["all, processor"] = time.process_time()
    times["frames of two solves"] = asked.rows("SELECT count(*) AS n FROM frames")[0]["n"]
    times["rows of markers"] = asked.rows("SELECT sum(markers)::BIGINT AS n FROM marks")[0]["n"]
    times["report, kB"] = output.stat().st_size / 1e3
    times["most memory, MB"] = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3
    return times


def main(wingd: str, folder: Path, sizes: list[int]) -> None:
    source, columns = real(wingd, folder), {}
    for size in sizes:
        lake = Lake(f"file://{folder / f'synthetic-{size}'}")
        if len(lake.committed().get("recalibrated", [])) < size:
            synthesise.make(source, lake, size)
        # In a process of its own: its memory is the measure.
        code = (
            "import sys, json; from pathlib import Path; from wingd_fleet.lake import Lake; from demo.growth import measure;"
            "print(json.dumps(measure(Lake(sys.argv[1]), Path(sys.argv[2]))))"
        )
        done = subprocess.run(
            [sys.executable, "-c", code, lake.url, str(folder / f"synthetic-{size}.html")],
            capture_output=True,
            text=True,
            check=True,
        )
        columns[size] = json.loads(done.stdout)
    print(f"{'synthetic flights':26}" + "".join(f"{size:>12}" for size in sizes))
    for name in columns[sizes[0]]:
        print(f"{name:26}" + "".join(f"{columns[size][name]:12.2f}" for size in sizes))
    engines.compare(Lake(f"file://{folder / f'synthetic-{sizes[-1]}'}"), "recalibrated")


if __name__ == "__main__":
    main(str(Path(sys.argv[1]).resolve()), Path(sys.argv[2]).resolve(), [int(n) for n in sys.argv[3:]] or list(SIZES))
