"""The `wingd` binary, as a task calls it."""

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

# A flight of 1,000 frames takes minutes; what takes a day hangs.
TIMEOUT_S = 24 * 3600
# Exit status for configuration or installation at fault.
AT_FAULT = 78
# Of a Rust program that panicked.
PANICKED = 101
# linux/prctl.h
PR_SET_PDEATHSIG = 1
try:
    _LIBC = ctypes.CDLL("libc.so.6")
except OSError:
    _LIBC = None
_RUNNING: set[subprocess.Popen] = set()


def find(name: str | None = None) -> str:
    """The binary: as named, or WINGD, or on the path."""
    wanted = name or os.environ.get("WINGD") or "wingd"
    found = shutil.which(wanted)
    if not found:
        raise FleetError(f"{wanted}: no such program; name it with --wingd or the variable WINGD")
    return str(Path(found).resolve())


def version(wingd: str) -> str:
    """`wingd 0.1.0`."""
    return call(wingd, ["--version"])[1].strip()


def end_with_parent() -> None:
    """Linux: a child is killed when whoever began it ends, however that ends."""
    if _LIBC is not None:
        _LIBC.prctl(PR_SET_PDEATHSIG, signal.SIGKILL)


def call(wingd: str, arguments: list[str]) -> tuple[int, str, str]:
    """Exit status, output, and what was said. A signal or a panic may pass with the machine: it is tried again."""
    how = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True, "preexec_fn": end_with_parent}
    with subprocess.Popen([wingd, *arguments], **how) as done:
        _RUNNING.add(done)
        try:
            output, said = done.communicate(timeout=TIMEOUT_S)
        finally:
            done.kill()
            _RUNNING.discard(done)
    if done.returncode < 0 or done.returncode == PANICKED:
        last = said.strip().splitlines()[-1:] or ["no word"]
        raise Passing(f"wingd {arguments[0]} ended by {done.returncode}: {last[0]}")
    return done.returncode, output, said


def end_all() -> None:
    """Ends what runs now, for a driver that is told to stop."""
    for running in list(_RUNNING):
        running.kill()


def solve(wingd: str, store: Path, flight: str, installation: Path, arguments: list[str], jobs: int) -> None:
    """Solves a flight's frames beside their old results. That frames fail is a result."""
    what = ["solve", str(store), f"--flight={flight}", "--installation", str(installation), "--json"]
    status, _, said = call(wingd, [*what, f"--jobs={jobs}", *arguments])
    if status not in (0, 1) or (status == 1 and not any(store.glob(f"flights/{flight}/*/results.jsonl"))):
        raise FleetError(f"wingd solve: {said.strip() or status}")


def export(wingd: str, store: Path, flight: str, table: str, inputs: str | None) -> pa.Table:
    """A table of a flight."""
    return pq.read_table(export_file(wingd, store, flight, table, inputs))


def export_file(wingd: str, store: Path, flight: str, table: str, inputs: str | None = None) -> Path:
    """The same as a Parquet file: hours of live results are not for the memory."""
    output = store.parent / f"{table}.parquet"
    what = ["export", str(store), f"--flight={flight}", "--format=parquet", f"--table={table}"]
    what += [f"--inputs={inputs}"] if inputs else []
    status, _, said = call(wingd, [*what, "--output", str(output)])
    if status != 0:
        raise FleetError(f"wingd export: {said.strip()}")
    return output


def results(store: Path, flight: str) -> list[dict]:
    """Provenance of every result, in the order written; numbers as they are spelt."""
    found = []
    for file in sorted(store.glob(f"flights/{flight}/*/results.jsonl")):
        for line in file.read_text().splitlines():
            found.append(json.loads(line, parse_float=Spelt, parse_int=Spelt)["provenance"])
    return found


class Spelt(str):
    """A number as its file spells it."""


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
    """The name that `--inputs` takes: SHA-256 over the inputs, sorted and without spaces."""
    return hashlib.sha256(("\n" + _canonical(provenance)).encode()).hexdigest()


def chosen(before: list[dict], after: list[dict], installation: dict[str, bytes], program: str) -> str:
    """Key of the results that follow from this installation and program, also where none of them is new."""
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
        raise FleetError(f"the flight has {what} of this installation and {program}; upload it without them")
    return found.pop()
