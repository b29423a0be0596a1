"""Access to an object store, an S3 bucket or a directory, shared by `wingd.upload` and `wingd.fleet`.

Credentials, region and endpoint come from the environment alone (``AWS_*``). No secret of the environment is in any text.
"""

from __future__ import annotations

import os
import re
from pathlib import Path

from . import WingdError

try:
    from obstore.exceptions import BaseError
    from obstore.store import LocalStore, S3Store
except ImportError as missing:
    raise WingdError(f"{missing.name} is not installed; pip install 'wingd[fleet]'") from None

# A wrong endpoint is reported within 3 s. By satellite (0.7 s round trip) connecting takes 2.1 s.
CONNECT_TIMEOUT = "2500ms"
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


class PlaceError(WingdError):
    """A URL or an environment that gives no object store."""


def is_set(name: str, value: str) -> bool:
    """Return whether a variable of the environment has a value, in any case."""
    return os.environ.get(name, "").lower() == value


def open_bucket(url: str, option: str, timeout: str, checksum: str | None = None) -> S3Store:
    """Open the bucket of ``s3://BUCKET/PREFIX``; no request is sent.

    Parameters
    ----------
    url
        The URL.
    option
        Option of the command that gave it, for messages.
    timeout
        Time limit of a request, for example ``600s``.
    checksum
        Algorithm by which the server checks the bytes of each put.

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
    config = {"checksum_algorithm": checksum} if checksum else {}
    try:
        return S3Store(bucket, prefix=prefix or None, client_options=options, retry_config={"max_retries": 0}, **config)
    except BaseError as error:
        raise PlaceError(f"environment: AWS_*: {redacted(str(error))[:300]}; set them as in docs/fleet.md") from None


def read_object(url: str) -> bytes:
    """Return the bytes of ``s3://BUCKET/KEY``.

    Raises
    ------
    WingdError
        There is no such object, or the server refuses it.
    """
    place, _, name = url.rpartition("/")
    try:
        return bytes(open_bucket(place, url, "600s").get(name).bytes())
    except (BaseError, OSError) as error:
        missing = isinstance(error, FileNotFoundError) and "no such object"
        text = server_error(error) or missing or redacted(str(error))[:300]
        raise WingdError(f"{url}: {text}") from None


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
