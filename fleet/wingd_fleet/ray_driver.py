"""A solve over many flights on Ray: one task per flight, begun again where its worker was lost."""

from __future__ import annotations

import os
import shutil
from collections import Counter
from pathlib import Path
from typing import Callable, Iterable

from . import task
from .lake import FleetError, Flight, Lake, Passing

# Attempts at a flight whose worker died or whose network failed.
RETRIES = 20


def run(
    url: str,
    solve: str,
    flights: Iterable[Flight],
    wingd: str,
    work: Path,
    workers: int | None = None,
    address: str | None = None,
    jobs: int = 1,
    said: Callable[[str], None] = print,
) -> Counter:
    """Counts of `done`, `there`, `failed`. `address`: a cluster's; without one, workers on this machine."""
    os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
    os.environ.setdefault("RAY_ACCEL_ENV_VAR_OVERRIDE_ON_ZERO", "0")
    import ray

    local = {} if address else {"num_cpus": workers or os.cpu_count(), "_node_ip_address": "127.0.0.1"}
    ray.init(address=address, include_dashboard=False, log_to_driver=False, logging_level="ERROR", **local)
    # Credentials go as the workers' own environment, not as an argument, which Ray would show.
    remote = ray.remote(num_cpus=jobs, max_retries=RETRIES, retry_exceptions=[Passing])(_one)
    try:
        pending = {remote.remote(url, solve, str(one), wingd, str(work), jobs): one for one in flights}
        return _collect(ray, pending, said)
    finally:
        ray.shutdown()
        # What killed workers left.
        shutil.rmtree(work, ignore_errors=True)


def _one(url: str, solve: str, flight: str, wingd: str, work: str, jobs: int) -> str:
    folder = Path(work) / f"worker-{os.getpid()}"
    return task.run(Lake(url), solve, Flight.parse(flight), wingd, folder, jobs)


def _collect(ray, pending: dict, said: Callable[[str], None]) -> Counter:
    counts, whole = Counter(), len(pending)
    while pending:
        for reference in ray.wait(list(pending), num_returns=1)[0]:
            flight = pending.pop(reference)
            try:
                outcome = ray.get(reference)
                said(f"{sum(counts.values()) + 1}/{whole}  {flight}  {outcome}")
            except (FleetError, ray.exceptions.RayError) as error:
                outcome = "failed"
                cause = getattr(error, "cause", None) or error
                said(f"{sum(counts.values()) + 1}/{whole}  {flight}  failed: {str(cause).splitlines()[0]}")
            counts[outcome] += 1
    return counts
