"""Target of an upload: an S3 bucket or a directory, whose objects are created and never overwritten."""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

import obstore
from obstore.exceptions import (
    AlreadyExistsError,
    BaseError,
    GenericError,
    JoinError,
    NotFoundError,
    PermissionDeniedError,
    UnauthenticatedError,
)

from .. import WingdError
from ..objects import PlaceError, open_bucket, open_directory, redacted, server_error
from .bundle import sha256
from .pace import RateLimit

# Time limit for a request: an object of 4 MiB takes 9 min at 64 kbit/s.
REQUEST_TIMEOUT = "600s"
# Pause before the first retry, doubled before each further one up to the longest, s.
FIRST_PAUSE_S, LONGEST_PAUSE_S = 0.25, 8.0
# Metadata of an object that allows comparison without reading it.
DIGEST_KEY = "sha256"

T = TypeVar("T")


class Failed(WingdError):
    """A request failed after all retries: the target is not reachable or refuses access, which concerns all flights."""


class Target:
    """Bucket and prefix, or directory.

    Parameters
    ----------
    url
        ``s3://BUCKET/PREFIX``, credentials in the environment, or ``file:///DIRECTORY``.
    jobs
        Maximum number of concurrent objects.
    retries
        Retries of a failed request.
    limit
        Maximum mean rate over the network, bytes per second; None for no limit. A directory has none.

    Raises
    ------
    PlaceError
        The URL or the environment is wrong.
    """

    def __init__(self, url: str, jobs: int = 4, retries: int = 5, limit: int | None = None):
        self.url = url.rstrip("/") if url != "file:///" else url
        self.jobs, self.retries = jobs, retries
        self.folder: Path | None = None
        self.limit = None
        self._durable: set[Path] = set()
        if self.url.startswith("file://"):
            self.folder = Path(self.url.removeprefix("file://"))
            if not self.folder.is_absolute():
                raise PlaceError("--to: names no absolute directory; give file:///DIRECTORY, a writable directory")
            self.store = open_directory(self.folder, "--to")
        elif self.url.startswith("s3://"):
            self.store = open_bucket(self.url, "--to", REQUEST_TIMEOUT, checksum="sha256")
            self.limit = RateLimit(limit) if limit else None
        else:
            raise PlaceError("--to: is neither a bucket nor a directory; give s3://BUCKET/PREFIX or file:///DIRECTORY")

    def shown(self, key: str) -> str:
        """Return the URL of a key, for messages."""
        return f"{self.url}/{key}"

    def check_access(self, prefix: str) -> None:
        """List a prefix once, without retries: a wrong endpoint or secret is reported at once."""
        try:
            self._list(prefix)
        except (BaseError, OSError, NotImplementedError) as error:
            raise self._failed(prefix, error) from None

    def _list(self, prefix: str) -> dict[str, int]:
        try:
            return {item["path"]: item["size"] for chunk in obstore.list(self.store, prefix) for item in chunk}
        except FileNotFoundError as error:
            # A bucket that does not exist; a directory that does not exist yet is empty.
            if server_error(error):
                raise
            return {}

    def sizes(self, prefix: str) -> dict[str, int]:
        """Return the keys below a prefix with their lengths, bytes."""
        return self._again(prefix, lambda: self._list(prefix))

    def read(self, key: str) -> bytes | None:
        """Return an object's bytes; None if it does not exist."""

        def get() -> bytes | None:
            try:
                return bytes(obstore.get(self.store, key).bytes())
            except (FileNotFoundError, NotFoundError) as error:
                if server_error(error):
                    raise
                return None

        return self._again(key, get)

    def create(self, key: str, data: bytes, digest: str) -> bool | None:
        """Create an object.

        Returns
        -------
        bool or None
            True: it was put. False: it existed with the same bytes, perhaps from an attempt whose answer was lost. None: it
            exists with other bytes, which stay.
        """
        if self._again(key, lambda: self._put(key, data, "create", digest)):
            return True
        return False if self.has(key, len(data), digest) else None

    def replace(self, key: str, data: bytes, digest: str) -> None:
        """Replace a damaged object."""
        self._again(key, lambda: self._put(key, data, "overwrite", digest))

    def _put(self, key: str, data: bytes, mode: str, digest: str) -> bool:
        """Put an object within the rate limit, once; False if it must not exist and does."""
        attributes = None if self.folder else {DIGEST_KEY: digest}
        end = self.limit.reserve(len(data), time.monotonic()) if self.limit else None
        try:
            obstore.put(self.store, key, data, mode=mode, attributes=attributes, use_multipart=False)
        except AlreadyExistsError:
            return False
        finally:
            if self.limit and end is not None:
                self.limit.wait(end)
        if self.folder:
            self._make_durable(self.folder / key)
        return True

    def _make_durable(self, path: Path) -> None:
        """Write a file's bytes, its name, and the names of new folders above it to the disk."""
        above = [parent for parent in path.parents[1:] if parent not in self._durable]
        for place in (path, path.parent, *above):
            handle = os.open(place, os.O_RDONLY)
            try:
                os.fsync(handle)
            finally:
                os.close(handle)
        self._durable.update(above)

    def has(self, key: str, length: int, digest: str) -> bool:
        """Return whether an object has a length and a digest; reads it if it has no digest in its metadata."""

        def compare() -> bool:
            if not self.folder:
                found = obstore.get(self.store, key, options={"head": True})
                if found.meta["size"] != length:
                    return False
                if stored := found.attributes.get(DIGEST_KEY):
                    return stored == digest
            data = bytes(obstore.get(self.store, key).bytes())
            return len(data) == length and sha256(data) == digest

        return self._again(key, compare)

    def _again(self, key: str, work: Callable[[], T]) -> T:
        """Run a request and repeat it while its error is transient, with growing pauses."""
        pause = FIRST_PAUSE_S
        for left in range(self.retries, -1, -1):
            try:
                return work()
            except (BaseError, OSError, NotImplementedError) as error:
                passing = isinstance(error, GenericError | JoinError) and server_error(error) is None
                if left == 0 or not passing:
                    raise self._failed(key, error) from None
                time.sleep(pause)
                pause = min(2 * pause, LONGEST_PAUSE_S)
        raise AssertionError("unreachable")

    def _failed(self, key: str, error: Exception) -> Failed:
        """Describe the error of a request, with a remedy."""
        if known := server_error(error):
            return Failed(f"{self.shown(key)}: {known}")
        if isinstance(error, FileNotFoundError | NotFoundError):
            remedy = "check the name and AWS_ENDPOINT_URL"
        elif isinstance(error, PermissionError | PermissionDeniedError | UnauthenticatedError):
            remedy = "check the credentials and their permissions"
        elif self.folder:
            remedy = "check the directory and its disk"
        elif isinstance(error, NotImplementedError):
            remedy = "the server must support conditional puts"
        else:
            remedy = (
                "no S3 server answers there: check the network, AWS_ENDPOINT_URL and AWS_REGION (AWS_ALLOW_HTTP=true for "
                "http), and run the command again to continue"
            )
        text = redacted(str(error).split("Debug source:")[0])
        return Failed(f"{self.shown(key)}: {text[:300] or 'no message'}; {remedy}")
