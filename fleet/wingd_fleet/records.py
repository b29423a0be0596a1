"""Small JSON objects that say what is so. Each holds its own digest, so that a changed one is told from a whole one; those that
nothing else could give again lie there twice."""

from __future__ import annotations

import hashlib
import json

from .lake import Damaged, Lake

_OPEN = "0" * 64


def sha256(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()


def dump(value: dict) -> bytes:
    """JSON, the same bytes for the same value, with its seal: the digest of this text with the seal's digits as zeros."""
    text = json.dumps({**value, "seal": _OPEN}, indent=1, sort_keys=True, ensure_ascii=False) + "\n"
    data = text.encode()
    return data.replace(f'"seal": "{_OPEN}"'.encode(), f'"seal": "{sha256(data)}"'.encode(), 1)


def load(place: str, data: bytes) -> dict:
    """A record that its seal fits."""
    try:
        value = json.loads(data)
        seal = value["seal"].encode()
    except (ValueError, KeyError, TypeError, AttributeError):
        raise Damaged([f"{place}: is damaged: it is no sealed record"]) from None
    if sha256(data.replace(b'"seal": "' + seal, b'"seal": "' + _OPEN.encode(), 1)).encode() != seal:
        raise Damaged([f"{place}: is damaged: its seal does not fit"])
    return value


def read(lake: Lake, key: str) -> dict:
    return load(f"{lake.url}/{key}", lake.need(key))


def twin(key: str) -> str:
    return f"copies/{key}"


def create_twice(lake: Lake, key: str, data: bytes) -> bool:
    """Creates a record and its copy; False where another one has the name. The copy is made where a killed call left none."""
    made = lake.create(key, data)
    if made or lake.get(key) == data:
        lake.create(twin(key), data)
    return made


def read_twice(lake: Lake, key: str) -> dict | None:
    """A record by itself or its copy; None where there is neither."""
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
    """Keys below a place that are there themselves or as a copy."""
    copies = [key.removeprefix("copies/") for key in lake.keys(twin(prefix))]
    return sorted({*lake.keys(prefix), *copies})
