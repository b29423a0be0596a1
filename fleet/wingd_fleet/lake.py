"""The object store: a bucket of S3's kind or a directory, and what lies where in it.

    manifests/aircraft=A/recorder=R/f0001.json     `wingd upload`: the flight is there
    flights/aircraft=A/recorder=R/f0001/...        its files: together a store
    installations/DIGEST/...                       what solves compute from
    solves/NAME.json                               what a solve is
    tables/v1/TABLE/solve=S/aircraft=A/recorder_id=R/flight=F/data.parquet
    commits/v1/solve=S/aircraft=A/recorder_id=R/flight=F.json   the flight's tables are there, all of them
    failures/v1/solve=S/aircraft=A/recorder_id=R/flight=F/DIGEST.json   why a task gave up

Nothing is written over and nothing deleted: an object is created where there is none.
"""

from __future__ import annotations

import hashlib
import json
import os
import re
import time
from dataclasses import dataclass
from pathlib import Path

import obstore
from obstore.exceptions import AlreadyExistsError, BaseError, GenericError
from obstore.store import LocalStore, from_url

TABLES = ("shots", "markers", "parameters", "span")
# Of layout and columns: columns may be added to it, never changed or removed.
VERSION = "v1"
NAME = re.compile(r"[A-Za-z0-9_-][A-Za-z0-9._-]{0,63}")
# Repeats of a create-only put whose answer was lost, and the first pause between them, s.
REPEATS, PAUSE_S = 5, 0.25


class FleetError(Exception):
    """What a person has to mend; the text says how."""


class Passing(FleetError):
    """What may do when tried again."""


def said(place: str, error: Exception) -> Passing:
    """A store's error as one line, without the secrets that the environment holds: servers repeat keys."""
    text = (str(error).splitlines() or ["no word"])[0]
    for name in ("AWS_SECRET_ACCESS_KEY", "AWS_SESSION_TOKEN", "AWS_ACCESS_KEY_ID"):
        secret = os.environ.get(name, "")
        text = text.replace(secret, "***") if len(secret) > 3 else text
    return Passing(f"{place}: {text}; look at the network, the AWS_* variables and what they may do")


def sha256(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()


def dump(value) -> bytes:
    """JSON, the same bytes for the same value."""
    return (json.dumps(value, indent=1, sort_keys=True, ensure_ascii=False) + "\n").encode()


@dataclass(frozen=True, order=True)
class Flight:
    """A flight of a recorder on an aircraft. Numbers count per recorder: alone they name nothing."""

    aircraft: str
    recorder: str
    flight: str

    @classmethod
    def parse(cls, text: str) -> "Flight":
        parts = text.strip().split("/")
        if len(parts) != 3 or not all(NAME.fullmatch(part) for part in parts):
            raise FleetError(f"{text!r} is no flight; give AIRCRAFT/RECORDER/FLIGHT as `wingd-fleet flights` does")
        return cls(*parts)

    def __str__(self) -> str:
        return f"{self.aircraft}/{self.recorder}/{self.flight}"

    @property
    def manifest(self) -> str:
        return f"manifests/aircraft={self.aircraft}/recorder={self.recorder}/{self.flight}.json"

    def file(self, name: str) -> str:
        return f"flights/aircraft={self.aircraft}/recorder={self.recorder}/{self.flight}/{name}"

    def _of(self, solve: str) -> str:
        return f"solve={solve}/aircraft={self.aircraft}/recorder_id={self.recorder}/flight={self.flight}"

    def table(self, table: str, solve: str) -> str:
        return f"tables/{VERSION}/{table}/{self._of(solve)}/data.parquet"

    def commit(self, solve: str) -> str:
        return f"commits/{VERSION}/{self._of(solve)}.json"

    def failure(self, solve: str, digest: str) -> str:
        return f"failures/{VERSION}/{self._of(solve)}/{digest[:16]}.json"


_KEY = re.compile(r"solve=([^/]+)/aircraft=([^/]+)/recorder_id=([^/]+)/flight=([^/]+?)(?:\.json$|/)")


def of_key(key: str) -> tuple[str, Flight] | None:
    """Solve and flight of a commit's, table's or failure's key."""
    found = _KEY.search(key)
    return (found[1], Flight(*found.groups()[1:])) if found else None


class Lake:
    """`s3://bucket/prefix` with AWS_* variables, or `file:///directory`."""

    def __init__(self, url: str):
        self.url = url.rstrip("/")
        if not self.url.startswith(("s3://", "file:///")):
            raise FleetError(f"{url}: give s3://BUCKET/PREFIX or file:///DIRECTORY")
        self.folder = Path(self.url[len("file://") :]) if self.url.startswith("file://") else None
        self.store = LocalStore(self.folder, mkdir=True) if self.folder else from_url(self.url)

    def get(self, key: str) -> bytes | None:
        """An object's bytes; None where there is none."""
        try:
            return bytes(obstore.get(self.store, key).bytes())
        except FileNotFoundError:
            return None
        except BaseError as error:
            raise said(f"{self.url}/{key}", error) from error

    def need(self, key: str) -> bytes:
        data = self.get(key)
        if data is None:
            raise FleetError(f"{self.url}/{key}: is not there")
        return data

    def json(self, key: str) -> dict:
        return json.loads(self.need(key))

    def create(self, key: str, data: bytes) -> bool:
        """Puts an object where there is none; False where one is, and that stays."""
        for attempt in range(REPEATS + 1):
            try:
                obstore.put(self.store, key, data, mode="create")
                return True
            except AlreadyExistsError:
                return attempt > 0 and self.get(key) == data
            except GenericError as error:
                if attempt == REPEATS:
                    raise said(f"{self.url}/{key}", error) from error
                time.sleep(PAUSE_S * 2**attempt)
            except BaseError as error:
                raise said(f"{self.url}/{key}", error) from error
        raise AssertionError("unreachable")

    def keys(self, prefix: str) -> list[str]:
        """Keys below a place, in their order."""
        try:
            return sorted(item["path"] for chunk in obstore.list(self.store, prefix) for item in chunk)
        except BaseError as error:
            raise said(f"{self.url}/{prefix}", error) from error

    def flights(self) -> list[Flight]:
        """Published flights."""
        found = []
        for key in self.keys("manifests"):
            match = re.fullmatch(r"manifests/aircraft=([^/]+)/recorder=([^/]+)/([^/]+)\.json", key)
            if match:
                found.append(Flight(*match.groups()))
        return found

    def committed(self, solve: str | None = None) -> dict[str, list[Flight]]:
        """Solve -> its flights whose tables are there."""
        found: dict[str, list[Flight]] = {}
        below = f"commits/{VERSION}" + (f"/solve={solve}" if solve else "")
        for key in self.keys(below):
            parsed = of_key(key)
            if parsed:
                found.setdefault(parsed[0], []).append(parsed[1])
        return found

    def failures(self, solve: str) -> dict[Flight, list[dict]]:
        """Why tasks gave up, of flights that are not committed."""
        done = set(self.committed(solve).get(solve, []))
        found: dict[Flight, list[dict]] = {}
        for key in self.keys(f"failures/{VERSION}/solve={solve}"):
            parsed = of_key(key)
            if parsed and parsed[1] not in done:
                found.setdefault(parsed[1], []).append(self.json(key))
        return found
