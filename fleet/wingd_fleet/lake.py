"""The object store: a bucket of S3's kind or a directory, and what lies where in it.

    manifests/recorder=R/flight=F/manifest.json      `wingd upload`: the flight exists; results.json, frames.json: they came
    flights/recorder=R/flight=F/...                  its files: together a store
    frames/recorder=R/flight=F/...                   its frames, which a rule of the bucket may age
    installations/DIGEST/...                         what solves compute from
    solves/NAME.json                                 what a solve is
    corrections/000001.json                          what was withdrawn or corrected, by whom and why
    copies/...                                       the same again of what has no other source
    tables/v3/TABLE/solve=S/recorder=R/flight=F/DIGEST.parquet
    commits/v3/solve=S/recorder=R/flight=F/0001.json which tables are a flight's; the highest number counts
    failures/v3/solve=S/recorder=R/flight=F/DIGEST.json   why a task gave up
    snapshots/v3/NUMBER-DIGEST/...                   all that is published, again in few files

What is published is what commits and corrections say, and nothing else. An object is created where there is none; only
where its bytes are not the ones that its name or seal tells are they replaced by those.
"""

from __future__ import annotations

import hashlib
import os
import re
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Callable, TypeVar

import obstore
from obstore.exceptions import AlreadyExistsError, BaseError, GenericError
from obstore.store import LocalStore, S3Store

# Of layout and columns: columns may be added to it, never changed or removed.
VERSION = "v3"
NAME = re.compile(r"[A-Za-z0-9_-][A-Za-z0-9._-]{0,63}")
# Repeats of a request after the first one that was answered, and the first pause between them, s.
REPEATS, PAUSE_S = 5, 0.25
# A wrong endpoint is said within 3 s; a file of a snapshot, 100 MB, takes a quarter of an hour at 1 Mbit/s.
CONNECT_TIMEOUT, TIMEOUT = "2500ms", "3600s"
SECRETS = ("AWS_SECRET_ACCESS_KEY", "AWS_SESSION_TOKEN", "AWS_ACCESS_KEY_ID")
ELSEWHERE = (
    "AWS_WEB_IDENTITY_TOKEN_FILE",
    "AWS_CONTAINER_CREDENTIALS_RELATIVE_URI",
    "AWS_CONTAINER_CREDENTIALS_FULL_URI",
)
# What servers of S3's kind answer (https://docs.aws.amazon.com/AmazonS3/latest/API/ErrorResponses.html).
ANSWERS = {
    "InvalidAccessKeyId": "the server does not know this access key; look at AWS_ACCESS_KEY_ID",
    "SignatureDoesNotMatch": "the secret is not that of the access key; look at AWS_SECRET_ACCESS_KEY (or AWS_REGION)",
    "RequestTimeTooSkewed": "this machine's clock and the server's differ too much; set the clock",
    "RequestExpired": "this machine's clock and the server's differ too much; set the clock",
    "ExpiredToken": "the session token has run out; get a new AWS_SESSION_TOKEN",
    "InvalidToken": "the session token is not one of the server's; look at AWS_SESSION_TOKEN",
    "NoSuchBucket": "there is no such bucket; make it, or name another",
    "AccessDenied": "the access key may not do this; let it list, get and put below the prefix, and look at the bucket's name",
    "AuthorizationHeaderMalformed": "the bucket is in another region; look at AWS_REGION",
}

T = TypeVar("T")


class FleetError(Exception):
    """What a person has to mend; the text says how."""


class Passing(FleetError):
    """What may do when tried again."""


class Damaged(FleetError):
    """Objects that are not what they were, or are gone: no answer is given from them."""

    def __init__(self, faults: list[str]):
        self.faults = faults
        more = f" and {len(faults) - 5} more" if len(faults) > 5 else ""
        super().__init__(f"{'; '.join(faults[:5])}{more}; see `wingd-fleet verify`, then `wingd-fleet repair`")


def redacted(text: str) -> str:
    """A text in one line, without the secrets that the environment holds: servers repeat keys."""
    for name in SECRETS:
        secret = os.environ.get(name, "")
        text = text.replace(secret, "***") if len(secret) > 3 else text
    return " ".join(text.split())


def said(place: str, error: Exception) -> FleetError:
    """A store's error in words, with what to look at."""
    text = str(error)
    for code, words in ANSWERS.items():
        if code in text:
            return FleetError(f"{place}: {words} ({code})")
    if isinstance(error, GenericError) and "S3" in text:
        what = "nobody answers there as a store does; look at the network, AWS_ENDPOINT_URL and AWS_REGION"
        return Passing(f"{place}: {what} ({redacted(text)[:300]})")
    return Passing(f"{place}: {redacted(text)[:300] or 'no word'}; look at the place and at what may be done there")


@dataclass(frozen=True, order=True)
class Flight:
    """A flight of a recorder. Numbers count per recorder: alone they name nothing. The aircraft is no part of it."""

    recorder: str
    flight: str

    @classmethod
    def parse(cls, text: str) -> "Flight":
        parts = text.strip().split("/")
        if len(parts) != 2 or not all(NAME.fullmatch(part) for part in parts):
            raise FleetError(f"{text!r} is no flight; give RECORDER/FLIGHT as `wingd-fleet flights` does")
        return cls(*parts)

    def __str__(self) -> str:
        return f"{self.recorder}/{self.flight}"

    @property
    def place(self) -> str:
        return f"recorder={self.recorder}/flight={self.flight}"

    @property
    def manifest(self) -> str:
        return f"manifests/{self.place}/manifest.json"

    def mark(self, stage: str) -> str:
        return f"manifests/{self.place}/{stage}.json"

    def file(self, name: str) -> str:
        return f"{'frames' if is_frame(name) else 'flights'}/{self.place}/{name}"

    def table(self, table: str, solve: str, digest: str) -> str:
        return f"tables/{VERSION}/{table}/solve={solve}/{self.place}/{digest[:16]}.parquet"

    def commit(self, solve: str, number: int) -> str:
        return f"commits/{VERSION}/solve={solve}/{self.place}/{number:04d}.json"

    def failure(self, solve: str, digest: str) -> str:
        return f"failures/{VERSION}/solve={solve}/{self.place}/{digest[:16]}.json"


_PLACE = re.compile(r"recorder=([^/]+)/flight=([^/]+)/")
_SOLVE = re.compile(r"/solve=([^/]+)/")


def flight_of(key: str) -> Flight | None:
    found = _PLACE.search(key)
    return Flight(*found.groups()) if found else None


def solve_of(key: str) -> str | None:
    found = _SOLVE.search(key)
    return found[1] if found else None


def is_frame(name: str) -> bool:
    """As `wingd upload` tells frames: what lies in a series and is a numbered picture."""
    parts = name.split("/")
    return len(parts) == 4 and parts[0] == "flights" and parts[3].split(".")[0].isdigit()


def _bucket(url: str) -> S3Store:
    bucket, _, prefix = url.removeprefix("s3://").partition("/")
    if not re.fullmatch(r"[A-Za-z0-9._-]+", bucket):
        # The text is not repeated: what stands before an @ may be a secret.
        raise FleetError("--lake names no bucket; give s3://BUCKET/PREFIX, credentials in AWS_* variables")
    pair = os.environ.get("AWS_ACCESS_KEY_ID") and os.environ.get("AWS_SECRET_ACCESS_KEY")
    metadata = os.environ.get("AWS_EC2_METADATA_DISABLED", "").lower() == "false"
    if not pair and not any(os.environ.get(name) for name in ELSEWHERE) and not metadata:
        raise FleetError(
            "AWS_ACCESS_KEY_ID and AWS_SECRET_ACCESS_KEY are not both set, and no other credentials are in the "
            "environment; export them, or AWS_EC2_METADATA_DISABLED=false where the machine's role counts"
        )
    options = {"connect_timeout": CONNECT_TIMEOUT, "timeout": TIMEOUT}
    if os.environ.get("AWS_ALLOW_HTTP", "").lower() == "true":
        options["allow_http"] = True
    return S3Store(bucket, prefix=prefix or None, client_options=options, retry_config={"max_retries": 0})


# Says of a lake that its flights are synthetic.
SYNTHETIC = "synthetic.json"


class Lake:
    """`s3://bucket/prefix` with AWS_* variables, or `file:///directory`."""

    def __init__(self, url: str):
        self.url = url.rstrip("/")
        self.met = False
        if not self.url.startswith(("s3://", "file:///")):
            raise FleetError(f"{redacted(url)}: give s3://BUCKET/PREFIX or file:///DIRECTORY")
        self.folder = Path(self.url.removeprefix("file://")) if self.url.startswith("file://") else None
        try:
            self.store = LocalStore(self.folder, mkdir=True) if self.folder else _bucket(self.url)
        except BaseError as error:
            raise said(self.url, error) from error

    def _again(self, place: str, work: Callable[[], T]) -> T:
        """What may pass is tried again, once somebody has answered at all."""
        for attempt in range(REPEATS + 1):
            try:
                done = work()
                self.met = True
                return done
            except (FileNotFoundError, AlreadyExistsError) as error:
                if "NoSuchBucket" in str(error):
                    raise said(self.url, error) from None
                self.met = True
                raise
            except (BaseError, OSError) as error:
                fault = said(f"{self.url}/{place}", error)
                if not isinstance(error, GenericError) or not isinstance(fault, Passing) or not self.met:
                    raise fault from None
                if attempt == REPEATS:
                    raise fault from None
                time.sleep(PAUSE_S * 2**attempt)
        raise AssertionError("unreachable")

    def is_synthetic(self) -> bool:
        """Whether its flights are synthetic."""
        return self.get(SYNTHETIC) is not None

    def get(self, key: str) -> bytes | None:
        """An object's bytes; None where there is none."""
        try:
            return self._again(key, lambda: bytes(obstore.get(self.store, key).bytes()))
        except FileNotFoundError:
            return None

    def need(self, key: str) -> bytes:
        data = self.get(key)
        if data is None:
            raise Damaged([f"{self.url}/{key}: is not there"])
        return data

    def download(self, key: str, path: Path) -> str | None:
        """Writes an object into a file, piece by piece; its SHA-256. None where there is none."""

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
        """Puts an object where there is none; False where another one is, and that stays."""
        try:
            self._again(key, lambda: obstore.put(self.store, key, data, mode="create", use_multipart=False))
            return True
        except AlreadyExistsError:
            # It may be ours, of an attempt whose answer was lost.
            return self.get(key) == data

    def replace(self, key: str, data: bytes) -> None:
        """Puts the right bytes in place of wrong ones, in one step."""
        self._again(key, lambda: obstore.put(self.store, key, data, mode="overwrite", use_multipart=False))

    def settle(self, key: str, data: bytes) -> None:
        """Sees to it that an object has the bytes that its name tells."""
        if not self.create(key, data):
            self.replace(key, data)

    def delete(self, keys: list[str]) -> None:
        for key in keys:
            try:
                self._again(key, lambda: obstore.delete(self.store, key))
            except FileNotFoundError:
                pass

    def sizes(self, prefix: str) -> dict[str, int]:
        """Keys below a place with their lengths, in their order."""

        def listed() -> dict[str, int]:
            found = [item for chunk in obstore.list(self.store, prefix) for item in chunk]
            return {item["path"]: item["size"] for item in sorted(found, key=lambda item: item["path"])}

        try:
            return self._again(prefix, listed)
        except FileNotFoundError:
            return {}

    def keys(self, prefix: str) -> list[str]:
        return list(self.sizes(prefix))
