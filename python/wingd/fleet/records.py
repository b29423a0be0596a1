"""Small JSON records.

Each contains its own digest, so that a changed record is detected; records that cannot be derived from others are
stored twice.
"""

from __future__ import annotations

import hashlib
import json

from .lake import Damaged, Lake

_OPEN = "0" * 64


def sha256(data: bytes) -> str:
    """Return the SHA-256 of bytes, hex."""
    return hashlib.sha256(data).hexdigest()


def dump(value: dict) -> bytes:
    """Return canonical JSON with a seal: the SHA-256 of this text with the seal's digits set to zero."""
    text = json.dumps({**value, "seal": _OPEN}, indent=1, sort_keys=True, ensure_ascii=False) + "\n"
    data = text.encode()
    return data.replace(f'"seal": "{_OPEN}"'.encode(), f'"seal": "{sha256(data)}"'.encode(), 1)


def load(place: str, data: bytes) -> dict:
    """Parse a record and checks its seal."""
    try:
        value = json.loads(data)
        seal = value["seal"].encode()
    except (ValueError, KeyError, TypeError, AttributeError):
        raise Damaged([f"{place}: is damaged: it is not a sealed record"]) from None
    if sha256(data.replace(b'"seal": "' + seal, b'"seal": "' + _OPEN.encode(), 1)).encode() != seal:
        raise Damaged([f"{place}: is damaged: its seal does not match"])
    return value


def read(lake: Lake, key: str) -> dict:
    """Read a record and check its seal."""
    return load(f"{lake.url}/{key}", lake.need(key))


def twin(key: str) -> str:
    """Return the key of the copy of a record."""
    return f"copies/{key}"


def create_twice(lake: Lake, key: str, data: bytes) -> bool:
    """Create a record and its copy; False if another record has the name. Adds a copy that a killed call did not write."""
    made = lake.create(key, data)
    if made or lake.get(key) == data:
        lake.create(twin(key), data)
    return made


def read_twice(lake: Lake, key: str) -> dict | None:
    """Read a record or its copy; None if neither exists."""
    faults = []
    for place in (key, twin(key)):
        data = lake.get(place)
        if data is None:
            continue
        try:
            return load(f"{lake.url}/{place}", data)
        except Damaged as damage:
            faults += damage.faults
    if faults:
        raise Damaged(faults)
    return None


def names_twice(lake: Lake, prefix: str) -> list[str]:
    """Return the keys below a prefix that exist themselves or as a copy."""
    copies = [key.removeprefix("copies/") for key in lake.keys(twin(prefix))]
    return sorted({*lake.keys(prefix), *copies})
