"""Withdrawals and corrections with name and reason: an append-only log. The last entry for a flight is valid."""

from __future__ import annotations

import datetime
import re
from dataclasses import dataclass, replace

from . import records
from .lake import NAME, Damaged, FleetError, Flight, Lake

ATTRIBUTES = ("aircraft", "aircraft_type", "wing")
FLIGHT = re.compile(r"f\d+")
# Minimum number of leading characters that may identify a recorder, if they are unique.
SHORT_ID = 4


@dataclass(frozen=True)
class About:
    """Aircraft, type and wing of a flight, as uploaded or as corrected."""

    aircraft: str
    aircraft_type: str | None
    wing: str | None
    started: str

    @classmethod
    def of(cls, record: dict) -> About:
        """Return what a manifest or a commit states."""
        return cls(record["aircraft"], record["aircraft_type"], record["wing"], record["started"])


def recorder(known: list[str], text: str) -> str:
    """Find a recorder by its id or the beginning of its id."""
    found = [one for one in sorted(set(known)) if one == text or (len(text) >= SHORT_ID and one.startswith(text))]
    if len(found) != 1:
        what = "is not a recorder of this lake" if not found else "is the beginning of several recorder ids"
        raise FleetError(f"{text!r} {what}; `wingd-fleet flights` lists them")
    return found[0]


def from_whence(text: str | None) -> str | None:
    """Parse the start of validity: a flight or a date; None: always."""
    if text is None or FLIGHT.fullmatch(text):
        return text
    try:
        return datetime.date.fromisoformat(text).isoformat()
    except ValueError:
        raise FleetError(f"@{text}: give a flight (@f0012) or a date (@2026-11-01)") from None


def reached(since: str | None, flight: Flight, started: str) -> bool:
    """Return whether a flight is at or after a flight number or a date (UTC)."""
    if since is None:
        return True
    if FLIGHT.fullmatch(since):
        return int(flight.flight[1:]) >= int(since[1:])
    return started[:10] >= since


def target(known: list[str], text: str) -> dict:
    """Parse a target: `RECORDER/FLIGHT`, `RECORDER`, `RECORDER@f0012`, `RECORDER@2026-11-01` or `aircraft=NAME`."""
    if text.startswith("aircraft="):
        return {"aircraft": text.removeprefix("aircraft=")}
    who, slash, flight = text.partition("/")
    if slash:
        if not FLIGHT.fullmatch(flight):
            raise FleetError(f"{text!r}: give RECORDER/FLIGHT as listed by `wingd-fleet flights`")
        return {"recorder": recorder(known, who), "flight": flight}
    who, at, since = text.partition("@")
    return {"recorder": recorder(known, who)} | ({"from": from_whence(since)} if at else {})


def key(number: int) -> str:
    """Return the key of a correction."""
    return f"corrections/{number:06d}.json"


def add(lake: Lake, what: str, of: dict, by: str, why: str, values: dict | None = None) -> int:
    """Write the next correction and return its number; `what` is `withdraw`, `restore` or `set`."""
    for name, value in (values or {}).items():
        if name not in ATTRIBUTES or not (value is None or NAME.fullmatch(value)):
            raise FleetError(f"{name}={value}: give {', '.join(ATTRIBUTES)} = letters, digits, '.', '_', '-'")
    if not why.strip():
        raise FleetError("--why: give a reason; it is stored with the correction")
    at = datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds")
    record = {"what": what, "of": of, "set": values or {}, "by": by, "why": why, "at": at}
    number = len(Corrections.read(lake).records) + 1
    while not records.create_twice(lake, key(number), records.dump({**record, "number": number})):
        number += 1
    return number


@dataclass(frozen=True)
class Corrections:
    """All corrections, in order."""

    records: tuple[dict, ...]

    @classmethod
    def read(cls, lake: Lake) -> Corrections:
        """Read the log."""
        keys = records.names_twice(lake, "corrections")
        wanted = [key(number + 1) for number in range(len(keys))]
        if keys != wanted:
            gone = sorted(set(wanted) - set(keys))
            raise Damaged([f"{lake.url}/{one}: is missing, and its copy too" for one in gone or keys])
        return cls(tuple(records.read_twice(lake, one) for one in keys))

    def about(self, flight: Flight, first: About) -> About:
        """Return aircraft, type and wing of a flight after all corrections."""
        now = first
        for record in self.records:
            if record["what"] == "set" and _meets(record["of"], flight, now):
                now = replace(now, **record["set"])
        return now

    def withdrawn(self, solve: str | None, flight: Flight, first: About) -> dict | None:
        """Return the valid withdrawal of a flight in a solve (None: in all solves), or None."""
        now, last = first, None
        for record in self.records:
            of = record["of"]
            if not _meets(of, flight, now) or of.get("solve") not in (None, solve):
                continue
            if record["what"] == "set":
                now = replace(now, **record["set"])
            else:
                last = record if record["what"] == "withdraw" else None
        return last


def _meets(of: dict, flight: Flight, now: About) -> bool:
    return (
        of.get("recorder") in (None, flight.recorder)
        and of.get("flight") in (None, flight.flight)
        and of.get("aircraft") in (None, now.aircraft)
        and reached(of.get("from"), flight, now.started)
    )
