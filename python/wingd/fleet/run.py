"""A solve over many flights on this machine. For several machines, any queue that calls `wingd-fleet task` or `run --part` works."""

from __future__ import annotations

import threading
import time
from collections import Counter
from collections.abc import Callable, Iterable
from concurrent.futures import FIRST_COMPLETED, ThreadPoolExecutor, wait
from pathlib import Path

from . import program, task
from .lake import FleetError, Flight, Lake, Passing
from .records import sha256

# Attempts at a flight whose worker died or whose network failed, and the pause between them, s.
ATTEMPTS, PAUSE_S = 4, 1.0


def part(flights: list[Flight], text: str) -> list[Flight]:
    """Return part `I/N` of the flights, I from 0, for N parallel runs; the name of a flight determines its part."""
    index, _, count = text.partition("/")
    if not (index.isdigit() and count.isdigit() and int(index) < int(count)):
        raise FleetError(f"--part {text}: give I/N with I from 0 to N - 1, as 3/100")
    return [one for one in flights if int(sha256(str(one).encode())[:8], 16) % int(count) == int(index)]


def run(
    lake: Lake,
    solve: str,
    flights: Iterable[Flight],
    wingd: str,
    work: Path,
    workers: int,
    jobs: int = 1,
    said: Callable[[str], None] = print,
) -> Counter:
    """Return the numbers of flights `done`, `there`, `withdrawn`, `failed`."""
    counts, stop, flights = Counter(), threading.Event(), list(flights)

    def one(flight: Flight) -> str:
        for attempt in range(ATTEMPTS):
            if stop.is_set():
                raise Passing("stopped")
            try:
                return task.run(lake, solve, flight, wingd, work, jobs)
            except Passing:
                if attempt == ATTEMPTS - 1:
                    raise
                time.sleep(PAUSE_S * 2**attempt)
        raise AssertionError("unreachable")

    with ThreadPoolExecutor(workers) as pool:
        pending = {pool.submit(one, flight): flight for flight in flights}
        try:
            while pending:
                for future in wait(pending, return_when=FIRST_COMPLETED).done:
                    _count(counts, pending.pop(future), future, len(flights), said)
        except BaseException:
            stop.set()
            program.end_all()
            pool.shutdown(wait=False, cancel_futures=True)
            raise
    return counts


def _count(counts: Counter, flight: Flight, future, whole: int, said: Callable[[str], None]) -> None:
    number = sum(counts.values()) + 1
    try:
        outcome = future.result()
        said(f"{number}/{whole}  {flight}  {outcome}")
    except FleetError as error:
        outcome = "failed"
        said(f"{number}/{whole}  {flight}  failed: {str(error).splitlines()[0]}")
    counts[outcome] += 1
