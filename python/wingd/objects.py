"""Object store, an S3 bucket or a directory, of `wingd.upload` and `wingd.fleet`.

Credentials, region and endpoint come from the environment alone (``AWS_*``). No secret of the environment is in any text.
"""

from __future__ import annotations

import hashlib
import os
import re
import time
from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

from . import WingdError

try:
    import obstore
    from obstore.exceptions import (
        AlreadyExistsError,
        BaseError,
        GenericError,
        JoinError,
        PermissionDeniedError,
        UnauthenticatedError,
    )
    from obstore.store import LocalStore, S3Store
except ImportError as missing:
    raise WingdError(f"{missing.name} is not installed; pip install 'wingd[fleet]'") from None

# A wrong endpoint is reported within 3 s. By satellite (0.7 s round trip) connecting takes 2.1 s.
CONNECT_TIMEOUT = "2500ms"
# Pause before the first retry, doubled before each further one up to the longest, s.
FIRST_PAUSE_S, LONGEST_PAUSE_S = 0.25, 8.0
# Metadata of an object that allows comparison without reading it.
DIGEST_KEY = "sha256"
SECRETS = ("AWS_SECRET_ACCESS_KEY", "AWS_SESSION_TOKEN", "AWS_ACCESS_KEY_ID")
# Variables that refer to credentials other than a key pair.
CREDENTIAL_VARIABLES = (
    "AWS_WEB_IDENTITY_TOKEN_FILE",
    "AWS_CONTAINER_CREDENTIALS_RELATIVE_URI",
    "AWS_CONTAINER_CREDENTIALS_FULL_URI",
)
# Error codes of S3 servers with explanation and remedy (https://docs.aws.amazon.com/AmazonS3/latest/API/ErrorResponses.html).
SERVER_ERRORS = {
    "InvalidAccessKeyId": "the server does not know this access key; check AWS_ACCESS_KEY_ID",
    "SignatureDoesNotMatch": "the secret does not match the access key; check AWS_SECRET_ACCESS_KEY (or AWS_REGION)",
    "RequestTimeTooSkewed": "this machine's clock and the server's differ too much; set the clock",
    "RequestExpired": "this machine's clock and the server's differ too much; set the clock",
    "ExpiredToken": "the session token has expired; get a new AWS_SESSION_TOKEN",
    "InvalidToken": "the server does not accept the session token; check AWS_SESSION_TOKEN",
    "NoSuchBucket": "the bucket does not exist; create it, or name another",
    "AccessDenied": "the access key has no permission for this; permit list, get and put below the prefix; check the name of the bucket",
    "AuthorizationHeaderMalformed": "the bucket is in another region; check AWS_REGION",
}
ENVIRONMENT = "AWS_ACCESS_KEY_ID and AWS_SECRET_ACCESS_KEY"

T = TypeVar("T")


class PlaceError(WingdError):
    """A URL or an environment that gives no object store."""


def is_set(name: str, value: str) -> bool:
    """Return whether a variable of the environment has a value, in any case."""
    return os.environ.get(name, "").lower() == value


def open_bucket(url: str, option: str, timeout: str) -> S3Store:
    """Open the bucket of ``s3://BUCKET/PREFIX``, whose server checks the bytes of each put; no request is sent.

    Parameters
    ----------
    url
        The URL.
    option
        Option of the command that gave it, for messages.
    timeout
        Time limit of a request, for example ``600s``.

    Raises
    ------
    PlaceError
        The URL names no bucket, or the environment has no credentials.
    """
    bucket, _, prefix = url.removeprefix("s3://").partition("/")
    if not re.fullmatch(r"[A-Za-z0-9._-]+", bucket):
        # The text is not repeated: the part before an @ may be a secret.
        raise PlaceError(
            f"{option}: names no bucket (only letters, digits, '.', '-', '_'); give s3://BUCKET/PREFIX, credentials in "
            "AWS_* variables"
        )
    pair = os.environ.get("AWS_ACCESS_KEY_ID") and os.environ.get("AWS_SECRET_ACCESS_KEY")
    # Without this check the metadata service of the network would be asked.
    metadata = is_set("AWS_EC2_METADATA_DISABLED", "false")
    if not pair and not any(os.environ.get(name) for name in CREDENTIAL_VARIABLES) and not metadata:
        raise PlaceError(
            f"environment: {ENVIRONMENT} are not both set, and no other credentials are in the environment; export them, "
            "for your own server also AWS_ENDPOINT_URL and AWS_REGION, for the role of an EC2 machine set "
            "AWS_EC2_METADATA_DISABLED=false"
        )
    options: dict = {"connect_timeout": CONNECT_TIMEOUT, "timeout": timeout}
    if is_set("AWS_ALLOW_HTTP", "true"):
        options["allow_http"] = True
    config = {"retry_config": {"max_retries": 0}, "checksum_algorithm": "sha256"}
    try:
        return S3Store(bucket, prefix=prefix or None, client_options=options, **config)
    except BaseError as error:
        raise PlaceError(f"environment: AWS_*: {redacted(str(error))[:300]}; set them as in docs/fleet.md") from None


def open_directory(folder: Path, option: str) -> LocalStore:
    """Open a directory as an object store; it is created.

    Raises
    ------
    PlaceError
        It cannot be created.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        return LocalStore(folder)
    except (OSError, BaseError) as error:
        text = getattr(error, "strerror", None) or redacted(str(error))[:300]
        raise PlaceError(f"{option}: {folder}: {text}; give file:///DIRECTORY, a writable directory") from None


def redacted(text: str) -> str:
    """Return a text in one line without the secrets of the environment: servers repeat keys in their answers."""
    for name in SECRETS:
        secret = os.environ.get(name, "")
        text = text.replace(secret, "***") if len(secret) > 3 else text
    return " ".join(text.split())


def server_error(error: Exception) -> str | None:
    """Return explanation and remedy of a refusal by the server that stays if the request is repeated; None if it is another."""
    text = str(error)
    for code, words in SERVER_ERRORS.items():
        if code in text:
            return f"{words} ({code})"
    return None


class ObjectStore:
    """Objects below a prefix of an S3 bucket, or in a directory.

    A request is repeated while its error is transient, with growing pauses, once the server has answered at all: a wrong
    endpoint or secret is reported at once.

    Parameters
    ----------
    url
        ``s3://BUCKET/PREFIX``, credentials in the environment, or ``file:///DIRECTORY``.
    option
        Option of the command that gave it, for messages.
    timeout
        Time limit of a request, for example ``600s``.
    retries
        Retries of a failed request.

    Raises
    ------
    PlaceError
        The URL or the environment is wrong.
    """

    #: Errors of a request: the server refuses it, and others, which may disappear if it is repeated.
    refusal: type[WingdError] = WingdError
    failure: type[WingdError] = WingdError

    def __init__(self, url: str, option: str, timeout: str, retries: int = 5):
        self.url = re.sub(r"(?<=[^/:])/+$", "", url)
        self.retries, self.answered = retries, False
        self.folder: Path | None = None
        self._durable: set[Path] = set()
        self.store: LocalStore | S3Store
        if self.url.startswith("file://"):
            self.folder = Path(self.url.removeprefix("file://"))
            if not self.folder.is_absolute():
                raise PlaceError(f"{option}: names no absolute directory; give file:///DIRECTORY, a writable directory")
            self.store = open_directory(self.folder, option)
        elif self.url.startswith("s3://"):
            self.store = open_bucket(self.url, option, timeout)
        else:
            what = "is neither a bucket nor a directory; give s3://BUCKET/PREFIX or file:///DIRECTORY"
            raise PlaceError(f"{option}: {what}")

    def shown(self, key: str) -> str:
        """Return the URL of a key, for messages."""
        return f"{self.url}/{key}"

    def get(self, key: str) -> bytes | None:
        """Return an object's bytes; None if it does not exist."""
        try:
            return self._again(key, lambda: bytes(obstore.get(self.store, key).bytes()))
        except FileNotFoundError:
            return None

    def sizes(self, prefix: str) -> dict[str, int]:
        """Return the keys below a prefix with their lengths in bytes, sorted."""

        def listed() -> dict[str, int]:
            found = [item for chunk in obstore.list(self.store, prefix) for item in chunk]
            return {item["path"]: item["size"] for item in sorted(found, key=lambda item: item["path"])}

        # A directory that does not exist yet is empty; a bucket that does not exist is an error.
        try:
            return self._again(prefix, listed)
        except FileNotFoundError:
            return {}

    def create(self, key: str, data: bytes) -> bool | None:
        """Create an object.

        Returns
        -------
        bool or None
            True: it was put. False: it existed with the same bytes, perhaps from an attempt whose answer was lost. None: it
            exists with other bytes, which stay.
        """
        if self._again(key, lambda: self._put(key, data, "create")):
            return True
        return False if self._equals(key, data) else None

    def replace(self, key: str, data: bytes) -> None:
        """Replace the bytes of an object in one step."""
        self._again(key, lambda: self._put(key, data, "overwrite"))

    def _equals(self, key: str, data: bytes) -> bool:
        return self.get(key) == data

    def _put(self, key: str, data: bytes, mode: str) -> bool:
        """Put an object once; False if it must not exist and does."""
        attributes = None if self.folder else {DIGEST_KEY: hashlib.sha256(data).hexdigest()}
        try:
            obstore.put(self.store, key, data, mode=mode, attributes=attributes, use_multipart=False)
        except AlreadyExistsError:
            return False
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

    def _again(self, key: str, work: Callable[[], T]) -> T:
        """Run a request and repeat it while its error is transient; a missing object is a FileNotFoundError."""
        pause = FIRST_PAUSE_S
        for left in range(self.retries, -1, -1):
            try:
                done = work()
                self.answered = True
                return done
            except (BaseError, OSError, NotImplementedError) as error:
                known = server_error(error)
                if isinstance(error, FileNotFoundError) and known is None:
                    self.answered = True
                    raise
                transient = isinstance(error, GenericError | JoinError) and known is None and self.answered
                if left == 0 or not transient:
                    raise self._described(key, error, known) from None
                time.sleep(pause)
                pause = min(2 * pause, LONGEST_PAUSE_S)
        raise AssertionError("unreachable")

    def _described(self, key: str, error: Exception, known: str | None) -> WingdError:
        """Describe the error of a request, with a remedy."""
        if known:
            return self.refusal(f"{self.shown(key)}: {known}")
        if isinstance(error, PermissionError | PermissionDeniedError | UnauthenticatedError):
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
        return self.failure(f"{self.shown(key)}: {text[:300] or 'no message'}; {remedy}")


def read_object(url: str) -> bytes:
    """Return the bytes of ``s3://BUCKET/KEY``.

    Raises
    ------
    WingdError
        There is no such object, or the server refuses it.
    """
    place, _, name = url.rpartition("/")
    data = ObjectStore(place, url, "600s").get(name)
    if data is None:
        raise WingdError(f"{url}: no such object; check the name")
    return data
