"""Target of an upload: an S3 bucket or a directory, whose objects are created and never overwritten."""

from __future__ import annotations

import time

import obstore

from .. import WingdError
from ..objects import DIGEST_KEY, ObjectStore
from .bundle import sha256
from .pace import RateLimit

# Time limit for a request: an object of 4 MiB takes 9 min at 64 kbit/s.
REQUEST_TIMEOUT = "600s"


class Failed(WingdError):
    """A request failed after all retries: the target is not reachable or refuses access, which concerns all flights."""


class Target(ObjectStore):
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

    refusal = failure = Failed

    def __init__(self, url: str, jobs: int = 4, retries: int = 5, limit: int | None = None):
        super().__init__(url, "--to", REQUEST_TIMEOUT, retries)
        self.jobs = jobs
        self.limit = RateLimit(limit) if limit and not self.folder else None

    def _put(self, key: str, data: bytes, mode: str) -> bool:
        """Put an object within the rate limit."""
        end = self.limit.reserve(len(data), time.monotonic()) if self.limit else None
        try:
            return super()._put(key, data, mode)
        finally:
            if self.limit and end is not None:
                self.limit.wait(end)

    def _equals(self, key: str, data: bytes) -> bool:
        return self.has(key, len(data), sha256(data))

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

        try:
            return self._again(key, compare)
        except FileNotFoundError:
            return False
