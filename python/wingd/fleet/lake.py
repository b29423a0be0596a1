"""The object store: an S3 bucket or a directory, and its layout.

    manifests/recorder=R/flight=F/manifest.json      written by `wingd upload`; results.json, frames.json: that stage is uploaded
    flights/recorder=R/flight=F/...                  its files, which form a store
    frames/recorder=R/flight=F/...                   its frames, which a rule of the bucket may expire
    installations/DIGEST/...                         installations used by solves
    solves/NAME.json                                 definition of a solve
    corrections/000001.json                          a withdrawal or correction, with name and reason
    copies/...                                       copies of records that have no other source
    tables/v3/TABLE/solve=S/recorder=R/flight=F/DIGEST.parquet
    commits/v3/solve=S/recorder=R/flight=F/0001.json the tables of a flight; the highest number is valid
    failures/v3/solve=S/recorder=R/flight=F/DIGEST.json   reason why a task failed
    snapshots/v3/NUMBER-DIGEST/...                   all published rows in a few files

Commits and corrections alone define what is published. An object is created if it does not exist; it is replaced only if its
bytes do not match its name or seal.
"""

from __future__ import annotations

import hashlib
import re
from dataclasses import dataclass
from pathlib import Path

import obstore

from .. import WingdError
from ..objects import ObjectStore, PlaceError

# Version of layout and columns: columns may be added, never changed or removed.
VERSION = "v3"
NAME = re.compile(r"[A-Za-z0-9_-][A-Za-z0-9._-]{0,63}")
# A snapshot file of 100 MB takes 15 min at 1 Mbit/s.
TIMEOUT = "3600s"


class FleetError(WingdError):
    """An error that the user has to correct; the text gives the remedy."""


class Passing(FleetError):
    """An error that may disappear if the operation is repeated."""


class Damaged(FleetError):
    """Damaged or missing objects: no result is computed from them."""

    def __init__(self, faults: list[str]):
        self.faults = faults
        more = f" and {len(faults) - 5} more" if len(faults) > 5 else ""
        super().__init__(f"{'; '.join(faults[:5])}{more}; run `wingd-fleet verify`, then `wingd-fleet repair`")


@dataclass(frozen=True, order=True)
class Flight:
    """A flight of a recorder. Flight numbers are unique per recorder only. The aircraft is not part of the name."""

    recorder: str
    flight: str

    @classmethod
    def parse(cls, text: str) -> Flight:
        """Parse RECORDER/FLIGHT."""
        parts = text.strip().split("/")
        if len(parts) != 2 or not all(NAME.fullmatch(part) for part in parts):
            raise FleetError(f"{text!r} is not a flight; give RECORDER/FLIGHT as listed by `wingd-fleet flights`")
        return cls(*parts)

    def __str__(self) -> str:
        return f"{self.recorder}/{self.flight}"

    @property
    def place(self) -> str:
        """Part of a key that names the flight."""
        return f"recorder={self.recorder}/flight={self.flight}"

    @property
    def manifest(self) -> str:
        """Key of the manifest."""
        return f"manifests/{self.place}/manifest.json"

    def mark(self, stage: str) -> str:
        """Return the key of the object that shows that a stage is complete."""
        return f"manifests/{self.place}/{stage}.json"

    def file(self, name: str) -> str:
        """Return the key of a file of the flight."""
        return f"{'frames' if is_frame(name) else 'flights'}/{self.place}/{name}"

    def table(self, table: str, solve: str, digest: str) -> str:
        """Return the key of a table."""
        return f"tables/{VERSION}/{table}/solve={solve}/{self.place}/{digest[:16]}.parquet"

    def commit(self, solve: str, number: int) -> str:
        """Return the key of a commit."""
        return f"commits/{VERSION}/solve={solve}/{self.place}/{number:04d}.json"

    def failure(self, solve: str, digest: str) -> str:
        """Return the key of a failure."""
        return f"failures/{VERSION}/solve={solve}/{self.place}/{digest[:16]}.json"


_PLACE = re.compile(r"recorder=([^/]+)/flight=([^/]+)/")
_SOLVE = re.compile(r"/solve=([^/]+)/")


def flight_of(key: str) -> Flight | None:
    """Return the flight in a key; None if it has none."""
    found = _PLACE.search(key)
    return Flight(*found.groups()) if found else None


def solve_of(key: str) -> str | None:
    """Return the solve in a key; None if it has none."""
    found = _SOLVE.search(key)
    return found[1] if found else None


def is_frame(name: str) -> bool:
    """Return whether a file is a frame, as in `wingd upload`: a numbered image in a series."""
    parts = name.split("/")
    return len(parts) == 4 and parts[0] == "flights" and parts[3].split(".")[0].isdigit()


# Object that marks a lake of synthetic flights.
SYNTHETIC = "synthetic.json"


class Lake(ObjectStore):
    """`s3://bucket/prefix` with AWS_* variables, or `file:///directory`."""

    refusal, failure = FleetError, Passing

    def __init__(self, url: str):
        try:
            super().__init__(url, "--lake", TIMEOUT)
        except PlaceError as error:
            raise FleetError(str(error)) from None

    def is_synthetic(self) -> bool:
        """Return whether the flights are synthetic."""
        return self.get(SYNTHETIC) is not None

    def need(self, key: str) -> bytes:
        """Return the bytes of an object that must exist."""
        data = self.get(key)
        if data is None:
            raise Damaged([f"{self.shown(key)}: is missing"])
        return data

    def download(self, key: str, path: Path) -> str | None:
        """Write an object into a file piece by piece and return its SHA-256; None if it does not exist."""

        def copied() -> str:
            digest = hashlib.sha256()
            with path.open("wb") as file:
                for piece in obstore.get(self.store, key).stream():
                    file.write(piece)
                    digest.update(piece)
            return digest.hexdigest()

        try:
            return self._again(key, copied)
        except FileNotFoundError:
            return None

    def create(self, key: str, data: bytes) -> bool:
        """Create an object; False if another one exists, which is kept."""
        return super().create(key, data) is not None

    def settle(self, key: str, data: bytes) -> None:
        """Ensure that an object has the bytes that its name requires."""
        if not self.create(key, data):
            self.replace(key, data)

    def delete(self, keys: list[str]) -> None:
        """Delete objects; those that do not exist count as deleted."""
        for key in keys:
            try:
                self._again(key, lambda key=key: obstore.delete(self.store, key))
            except FileNotFoundError:
                pass

    def keys(self, prefix: str) -> list[str]:
        """Return the keys below a prefix, sorted."""
        return list(self.sizes(prefix))
