"""What was withdrawn or corrected, by whom and why: a log that only grows. Its last word on a flight counts."""

from __future__ import annotations

import datetime
import re
from dataclasses import dataclass, replace

from . import records
from .lake import NAME, Damaged, FleetError, Flight, Lake

ATTRIBUTES = ("aircraft", "aircraft_type", "wing")
DATE = re.compile(r"\d{4}-\d{2}-\d{2}")
FLIGHT = re.compile(r"f\d+")
# Characters of a recorder's id that may stand for it where no other begins so.
SHORT_ID = 4


@dataclass(frozen=True)
class About:
    """Whose wing it is, as first said and since corrected."""

    aircraft: str
    aircraft_type: str | None
    wing: str | None
    started: str

    @classmethod
    def of(cls, record: dict) -> "About":
        return cls(record["aircraft"], record["aircraft_type"], record["wing"], record["started"])


def recorder(known: list[str], text: str) -> str:
    """A recorder by its id or what it begins with."""
    found = [one for one in sorted(set(known)) if one == text or (len(text) >= SHORT_ID and one.startswith(text))]
    if len(found) != 1:
        what = "is no recorder of this lake" if not found else "begins the ids of several recorders"
        raise FleetError(f"{text!r} {what}; `wingd-fleet flights` lists them")
    return found[0]


def from_whence(text: str | None) -> str | None:
    """From a flight or a date on; None: always."""
    if text is None or FLIGHT.fullmatch(text):
        return text
    try:
        return datetime.date.fromisoformat(text).isoformat()
    except ValueError:
        raise FleetError(f"@{text}: give a flight (@f0012) or a date (@2026-11-01)") from None


def reached(since: str | None, flight: Flight, started: str) -> bool:
    """Whether a flight is at or after a flight's number or a date (UTC)."""
    if since is None:
        return True
    if FLIGHT.fullmatch(since):
        return int(flight.flight[1:]) >= int(since[1:])
    return started[:10] >= since


def target(known: list[str], text: str) -> dict:
    """`RECORDER/FLIGHT`, `RECORDER`, `RECORDER@f0012`, `RECORDER@2026-11-01` or `aircraft=NAME`."""
    if text.startswith("aircraft="):
        return {"aircraft": text.removeprefix("aircraft=")}
    who, slash, flight = text.partition("/")
    if slash:
        if not FLIGHT.fullmatch(flight):
            raise FleetError(f"{text!r}: give RECORDER/FLIGHT as `wingd-fleet flights` does")
        return {"recorder": recorder(known, who), "flight": flight}
    who, at, since = text.partition("@")
    return {"recorder": recorder(known, who)} | ({"from": from_whence(since)} if at else {})


def key(number: int) -> str:
    return f"corrections/{number:06d}.json"


def add(lake: Lake, what: str, of: dict, by: str, why: str, values: dict | None = None) -> int:
    """Writes the next correction; `what` is `withdraw`, `restore` or `set`. Its number."""
    for name, value in (values or {}).items():
        if name not in ATTRIBUTES or not (value is None or NAME.fullmatch(value)):
            raise FleetError(f"{name}={value}: give {', '.join(ATTRIBUTES)} = letters, digits, '.', '_', '-'")
    if not why.strip():
        raise FleetError("--why: say why, for those who ask later")
    at = datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds")
    record = {"what": what, "of": of, "set": values or {}, "by": by, "why": why, "at": at}
    number = len(Corrections.read(lake).records) + 1
    while not records.create_twice(lake, key(number), records.dump({**record, "number": number})):
        number += 1
    return number


@dataclass(frozen=True)
class Corrections:
    """All of them, in their order."""

    records: tuple[dict, ...]

    @classmethod
    def read(cls, lake: Lake) -> "Corrections":
        keys = records.names_twice(lake, "corrections")
        wanted = [key(number + 1) for number in range(len(keys))]
        if keys != wanted:
            gone = sorted(set(wanted) - set(keys))
            raise Damaged([f"{lake.url}/{one}: is gone, its copy too" for one in gone or keys])
        return cls(tuple(records.read_twice(lake, one) for one in keys))

    def about(self, flight: Flight, first: About) -> About:
        """Whose wing it is, after all corrections."""
        now = first
        for record in self.records:
            if record["what"] == "set" and _meets(record["of"], flight, now):
                now = replace(now, **record["set"])
        return now

    def withdrawn(self, solve: str | None, flight: Flight, first: About) -> dict | None:
        """The withdrawal that holds for a flight in a solve (None: in all), or None."""
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
