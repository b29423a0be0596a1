"""Calls of the `wingd` binary."""

from __future__ import annotations

import ctypes
import hashlib
import json
import os
import shutil
import signal
import subprocess
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq

from .lake import FleetError, Passing

# A flight of 1,000 frames takes minutes; a call that takes a day hangs.
TIMEOUT_S = 24 * 3600
# Exit status of a Rust program that panicked.
PANICKED = 101
# linux/prctl.h
PR_SET_PDEATHSIG = 1
try:
    _LIBC = ctypes.CDLL("libc.so.6")
except OSError:
    _LIBC = None
_RUNNING: set[subprocess.Popen] = set()


def find(name: str | None = None) -> str:
    """Find the binary: the given name, WINGD, or `wingd` on the path."""
    wanted = name or os.environ.get("WINGD") or "wingd"
    found = shutil.which(wanted)
    if not found:
        raise FleetError(f"{wanted}: program not found; give it with --wingd or the variable WINGD")
    return str(Path(found).resolve())


def version(wingd: str) -> str:
    """Return the version text, e.g. `wingd 0.1.0`."""
    return call(wingd, ["--version"])[1].strip()


def end_with_parent() -> None:
    """Linux: kills a child process when its parent ends for any reason."""
    if _LIBC is not None:
        _LIBC.prctl(PR_SET_PDEATHSIG, signal.SIGKILL)


def call(wingd: str, arguments: list[str]) -> tuple[int, str, str]:
    """Return exit status, standard output and standard error. Raises Passing after a signal or a panic, so that it is retried."""
    how = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True, "preexec_fn": end_with_parent}
    with subprocess.Popen([wingd, *arguments], **how) as done:
        _RUNNING.add(done)
        try:
            output, said = done.communicate(timeout=TIMEOUT_S)
        finally:
            done.kill()
            _RUNNING.discard(done)
    if done.returncode < 0 or done.returncode == PANICKED:
        last = said.strip().splitlines()[-1:] or ["no message"]
        raise Passing(f"wingd {arguments[0]} ended by {done.returncode}: {last[0]}")
    return done.returncode, output, said


def end_all() -> None:
    """Kills the running calls when the driver is stopped."""
    for running in list(_RUNNING):
        running.kill()


def solve(wingd: str, store: Path, flight: str, installation: Path, arguments: list[str], jobs: int) -> None:
    """Solves a flight's frames and adds the results to the old ones. Frames that cannot be solved are results too."""
    what = ["solve", str(store), f"--flight={flight}", "--installation", str(installation), "--json"]
    status, _, said = call(wingd, [*what, f"--jobs={jobs}", *arguments])
    if status not in (0, 1) or (status == 1 and not any(store.glob(f"flights/{flight}/*/results.jsonl"))):
        raise FleetError(f"wingd solve: {said.strip() or status}")


def export(wingd: str, store: Path, flight: str, table: str, inputs: str | None) -> pa.Table:
    """Export a table of a flight."""
    return pq.read_table(export_file(wingd, store, flight, table, inputs))


def export_file(wingd: str, store: Path, flight: str, table: str, inputs: str | None = None) -> Path:
    """Export a table of a flight to a Parquet file: hours of live results would not fit in memory."""
    output = store.parent / f"{table}.parquet"
    what = ["export", str(store), f"--flight={flight}", "--format=parquet", f"--table={table}"]
    what += [f"--inputs={inputs}"] if inputs else []
    status, _, said = call(wingd, [*what, "--output", str(output)])
    if status != 0:
        raise FleetError(f"wingd export: {said.strip()}")
    return output


def export_shape(wingd: str, store: Path, flight: str, eta: tuple[float, ...], inputs: str | None) -> Path:
    """Export the shape of a flight with its factors at fractions of the model's length, as NetCDF."""
    output = store.parent / "shape.nc"
    what = ["export", str(store), f"--flight={flight}", "--format=netcdf", "--table=shape"]
    what += ["--eta", ",".join(map(str, eta)), *([f"--inputs={inputs}"] if inputs else [])]
    status, _, said = call(wingd, [*what, "--output", str(output)])
    if status != 0:
        raise FleetError(f"wingd export: {said.strip()}")
    return output


def results(store: Path, flight: str) -> list[dict]:
    """Return the provenance of every result, in the order written, with numbers as spelt in the file."""
    found = []
    for file in sorted(store.glob(f"flights/{flight}/*/results.jsonl")):
        for line in file.read_text().splitlines():
            found.append(json.loads(line, parse_float=Spelt, parse_int=Spelt)["provenance"])
    return found


class Spelt(str):
    """A number as spelt in its file."""


def _canonical(value) -> str:
    if isinstance(value, Spelt):
        return str(value)
    if isinstance(value, dict):
        return (
            "{" + "".join(f"{json.dumps(k, ensure_ascii=False)}:{_canonical(value[k])}," for k in sorted(value)) + "}"
        )
    if isinstance(value, list):
        return "[" + "".join(f"{_canonical(item)}," for item in value) + "]"
    return json.dumps(value, ensure_ascii=False)


def key(provenance: dict) -> str:
    """Return the key for `--inputs`: SHA-256 of the inputs as sorted JSON without spaces."""
    return hashlib.sha256(("\n" + _canonical(provenance)).encode()).hexdigest()


def chosen(before: list[dict], after: list[dict], installation: dict[str, bytes], program: str) -> str:
    """Return the key of the results of this installation and program, even if none of them is new."""
    digests = {f"{name}.sha256": hashlib.sha256(data).hexdigest() for name, data in installation.items()}

    def fits(provenance: dict) -> bool:
        named = {k: v for k, v in provenance.items() if k.endswith(".sha256")}
        return provenance.get("program") == program and all(digests.get(k) == v for k, v in named.items())

    def keys(all_of: list[dict]) -> list[str]:
        return [key(provenance) for provenance in all_of if fits(provenance)]

    old, now = keys(before), keys(after)
    new = {one for one in now if now.count(one) > old.count(one)}
    found = new or set(now)
    if len(found) != 1:
        what = "no results" if not found else f"results of {len(found)} kinds of parameters"
        raise FleetError(f"the flight has {what} of this installation and {program}; upload it without its results")
    return found.pop()
