"""A solve over many flights on an existing Ray cluster: one task per flight, restarted if its worker is lost.

An extra of the package.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable
from pathlib import Path

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
    address: str,
    jobs: int = 1,
    said: Callable[[str], None] = print,
) -> Counter:
    """Return the numbers of flights `done`, `there`, `failed`."""
    try:
        import ray
    except ImportError:
        raise FleetError(
            "Ray is not installed; pip install 'wingd[ray]', or use run --part with another queue"
        ) from None
    ray.init(address=address, log_to_driver=False, logging_level="ERROR")
    # Workers take credentials from their own environment; Ray would show an argument.
    remote = ray.remote(num_cpus=jobs, max_retries=RETRIES, retry_exceptions=[Passing])(_one)
    try:
        pending = {remote.remote(url, solve, str(one), wingd, str(work), jobs): one for one in flights}
        return _collect(ray, pending, said)
    finally:
        ray.shutdown()


def _one(url: str, solve: str, flight: str, wingd: str, work: str, jobs: int) -> str:
    return task.run(Lake(url), solve, Flight.parse(flight), wingd, Path(work), jobs)


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
