"""Manifest of a published flight: aircraft, wing, files with digests, and the keys of its objects.

``manifests/recorder=R/flight=F/manifest.json`` announces the flight; ``results.json`` and ``frames.json`` beside it show the
stages that have arrived. The same flight always gives the same bytes: nothing depends on time or machine.
"""

from __future__ import annotations

import json
import re
from dataclasses import dataclass, replace
from typing import Any

from .. import WingdError
from .bundle import Bundle, File, is_frame, sha256

#: Format of the manifest.
FORMAT = 2
#: Maximum length of an object, bytes. A longer file is uploaded in parts, which bounds the cost of an interruption: a part takes
#: 17 s at 0.25 MB/s.
PART_BYTES = 4 << 20
#: Stages in their order, with the prefix of their keys. Frames have their own, so that a rule of the bucket can delete them.
STAGES = {"results": "flights", "frames": "frames"}
_EMPTY_SEAL = "0" * 64
_NAME = re.compile(r"[A-Za-z0-9_-][A-Za-z0-9._-]{0,63}")


def is_name(text: str) -> bool:
    """Return whether a text is 1 to 64 letters, digits, ``.``, ``_``, ``-``, with no ``.`` first.

    Every object store, file system and table engine takes such a name without quoting.
    """
    return _NAME.fullmatch(text) is not None


@dataclass(frozen=True)
class Labels:
    """Aircraft and wing of a flight: labels that can be corrected later and do not identify the flight.

    Attributes
    ----------
    aircraft
        Registration; None: a name derived from the recorder's id.
    aircraft_type
        Type of the aircraft; None if unknown.
    wing
        ``left``, ``right`` or another name; None: the side in the installation.

    Raises
    ------
    WingdError
        A name is not one of :func:`is_name`.
    """

    aircraft: str | None = None
    aircraft_type: str | None = None
    wing: str | None = None

    def __post_init__(self) -> None:
        for key, value in vars(self).items():
            if value is not None and not is_name(value):
                raise WingdError(f"{key} {value!r}: give letters, digits, '.', '_', '-' (64 at most, not '.' first)")


@dataclass(frozen=True)
class Object:
    """Object of a flight: a file, or a part of a long one."""

    key: str
    stage: str
    offset: int
    length: int
    sha256: str
    file: File

    def read(self) -> bytes:
        """Return the bytes, after checking the digest of the file."""
        return self.file.read()[self.offset : self.offset + self.length]


@dataclass(frozen=True)
class Manifest:
    """Manifest of a flight; `fields` are those of its JSON, in order, with the seal last."""

    fields: dict[str, Any]

    @classmethod
    def of(cls, bundle: Bundle, labels: Labels) -> Manifest:
        """Make the manifest of a local flight; reads files that are uploaded in parts for their digests."""
        side = bundle.side if bundle.side and is_name(bundle.side) else None
        files = [_entry(file) for file in bundle.files]
        fields = {
            "format": FORMAT,
            "recorder": bundle.recorder,
            "flight": bundle.flight,
            "aircraft": labels.aircraft or f"recorder-{bundle.recorder[:8]}",
            "aircraft_type": labels.aircraft_type,
            "wing": labels.wing or side,
            "started": bundle.started,
            "digest": bundle.digest,
            "bytes": sum(file["length"] for file in files),
            "files": files,
        }
        return cls(_sealed(fields))

    @classmethod
    def parse(cls, data: bytes) -> Manifest | None:
        """Parse a manifest; None if its seal does not match."""
        fields = _parse_sealed(data)
        return None if fields is None else cls(fields)

    @property
    def text(self) -> bytes:
        """The JSON text, as it is published."""
        return _text(self.fields)

    @property
    def place(self) -> str:
        """Part of the keys that names the flight."""
        return f"recorder={self.fields['recorder']}/flight={self.fields['flight']}"

    @property
    def key(self) -> str:
        """Key of the manifest."""
        return f"manifests/{self.place}/manifest.json"

    def labelled(self, there: Manifest, labels: Labels) -> Manifest | None:
        """Return this manifest with the labels of the published one; None if the call gave others."""
        given = vars(labels)
        if any(value is not None and value != there.fields.get(key) for key, value in given.items()):
            return None
        return Manifest(_sealed({**self.fields, **{key: there.fields.get(key) for key in given}}))

    def completion(self, stage: str) -> tuple[str, bytes]:
        """Return key and text of the object that shows that a stage is complete."""
        fields = {"format": FORMAT, "stage": stage, "manifest": sha256(self.text)}
        return f"manifests/{self.place}/{stage}.json", _text(_sealed(fields))

    def prefixes(self) -> list[str]:
        """Return the prefixes of the keys of its files."""
        return [f"{prefix}/{self.place}" for prefix in STAGES.values()]

    def objects(self, bundle: Bundle) -> list[Object]:
        """Return all objects of its files, in sending order."""
        found = []
        for entry, file in zip(self.fields["files"], bundle.files, strict=True):
            stage = "frames" if is_frame(file.name) else "results"
            key = f"{STAGES[stage]}/{self.place}/{file.name}"
            whole = Object(key, stage, 0, file.length, file.sha256, file)
            parts = entry.get("parts", [])
            for number, digest in enumerate(parts):
                offset = number * PART_BYTES
                length = min(PART_BYTES, file.length - offset)
                part = f"{key}.part-{number:04d}"
                found.append(replace(whole, key=part, offset=offset, length=length, sha256=digest))
            if not parts:
                found.append(whole)
        return sorted(found, key=lambda one: one.stage == "frames")


def _entry(file: File) -> dict[str, Any]:
    entry: dict[str, Any] = {"name": file.name, "length": file.length, "sha256": file.sha256}
    if file.length > PART_BYTES:
        data = file.read()
        entry["parts"] = [sha256(data[k : k + PART_BYTES]) for k in range(0, len(data), PART_BYTES)]
    return entry


def _text(fields: dict[str, Any]) -> bytes:
    return (json.dumps(fields, indent=2, ensure_ascii=False) + "\n").encode()


def _sealed(fields: dict[str, Any]) -> dict[str, Any]:
    """Add the seal: the SHA-256 of the text with 64 zeros in its place."""
    return {**fields, "seal": sha256(_text({**fields, "seal": _EMPTY_SEAL}))}


def _parse_sealed(data: bytes) -> dict[str, Any] | None:
    try:
        fields = json.loads(data)
        seal = fields["seal"]
        opened = data.replace(seal.encode(), _EMPTY_SEAL.encode(), 1)
    except (ValueError, KeyError, TypeError, AttributeError):
        return None
    return fields if sha256(opened) == seal else None
