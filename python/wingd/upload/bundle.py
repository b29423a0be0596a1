"""Files of a flight as one state: what is published of it, read from the files of its store.

Files that grow are taken up to the length in the flight's SHA256SUMS, so that the recorder may continue. ``docs/store.md``
describes the files.
"""

from __future__ import annotations

import hashlib
import json
import os
import re
import shutil
import subprocess
import tomllib
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path, PurePosixPath

from .. import WingdError

#: Format of a store whose flights have chains of digests.
FORMAT = 2
_FLIGHT = re.compile(r"f\d{4,}")
_FRAME = re.compile(r"\d{4,}\.[a-z0-9]{1,8}")
_REMEDY = "run `wingd verify` for other damage, and restore it from a copy"
# Closed files of a flight in its chain: aircraft data, live results, manual marks.
_CLOSED = ("aircraft", "live", "marks")


class StoreError(WingdError):
    """A file of a store is missing or damaged, or the folder is no store."""


def sha256(data: bytes) -> str:
    """Return the SHA-256 of bytes, hex."""
    return hashlib.sha256(data).hexdigest()


def is_frame(name: str) -> bool:
    """Return whether a path in a store is a frame: a numbered image in a series."""
    parts = name.split("/")
    return len(parts) == 4 and parts[0] == "flights" and _FRAME.fullmatch(parts[3]) is not None


@dataclass(frozen=True)
class File:
    """File of a flight.

    Attributes
    ----------
    name
        Path from the root of the store, with ``/``.
    length
        Length, bytes; the file on disk may have grown since.
    sha256
        SHA-256 of that many bytes, hex.
    source
        The file on disk, or its bytes.
    """

    name: str
    length: int
    sha256: str
    source: Path | bytes = field(repr=False)

    def read(self) -> bytes:
        """Return the bytes.

        Raises
        ------
        StoreError
            They do not have the digest.
        """
        if isinstance(self.source, bytes):
            return self.source
        with self.source.open("rb") as file:
            data = file.read(self.length)
        if sha256(data) != self.sha256:
            raise StoreError(f"{self.source}: does not match its SHA-256, so the flight is not uploaded; {_REMEDY}")
        return data


@dataclass(frozen=True)
class Bundle:
    """All files of a flight; together they are a store.

    Attributes
    ----------
    recorder
        Id of the store.
    flight
        Name of the flight in it.
    started
        Beginning of the flight, UTC, as in its manifest.
    side
        Wing of the last installation that results came from; None if it names none.
    files
        Files in the order in which they are written.
    """

    recorder: str
    flight: str
    started: str
    side: str | None
    files: tuple[File, ...]

    @property
    def digest(self) -> str:
        """SHA-256 over digests, lengths and names, hex."""
        lines = (f"{file.sha256} {file.length} {file.name}\n" for file in self.files)
        return sha256("".join(lines).encode())


def flights(root: Path, wanted: str | None = None) -> list[str]:
    """Return the names of a store's flights, or of the one requested by its name or the user's name for it.

    Raises
    ------
    StoreError
        The folder is no store, or has no such flight.
    """
    store_id(root)
    folder = root / "flights"
    found = sorted(path.name for path in folder.iterdir() if _FLIGHT.fullmatch(path.name)) if folder.is_dir() else []
    if wanted is None:
        return found
    named = [flight for flight in found if wanted in (flight, _json(folder / flight / "flight.json").get("name"))]
    if not named:
        raise StoreError(f"{root}: there is no flight {wanted}; available: {', '.join(found) or 'none'}")
    return named


def store_id(root: Path) -> str:
    """Return the id of a store, which distinguishes its flights from those of other recorders.

    Raises
    ------
    StoreError
        The folder is no store, or one of format 1, which has no id.
    """
    file = root / "store.toml"
    if not file.is_file():
        raise StoreError(f"{root}: is not a store: it has no store.toml")
    try:
        about = tomllib.loads(file.read_text())
    except (ValueError, OSError) as error:
        raise StoreError(f"{file}: cannot be read ({error}); restore it from a copy") from None
    number, id = about.get("format"), about.get("id")
    if number == 1:
        raise StoreError(
            f"{root}: has format 1 and no id that distinguishes its flights from those of other recorders; "
            "import its frames into a new store"
        )
    if number != FORMAT or not isinstance(id, str) or not id:
        raise StoreError(f"{file}: has format {number}; this program reads format {FORMAT}")
    return id


def verify(root: Path, flight: str) -> None:
    """Check every checksum and invariant of a flight by ``wingd verify``.

    Raises
    ------
    StoreError
        The flight has faults, the first of which is named, or the program is missing.
    """
    wanted = os.environ.get("WINGD") or "wingd"
    program = shutil.which(wanted)
    if program is None:
        raise StoreError(f"{wanted}: program not found; put wingd on the PATH, or name it in the variable WINGD")
    done = subprocess.run([program, "verify", "--json", str(root / "flights" / flight)], capture_output=True, text=True)
    try:
        faults = json.loads(done.stdout)["faults"]
    except (ValueError, KeyError, TypeError):
        text = (done.stderr.strip() or f"exit status {done.returncode}").splitlines()[-1]
        raise StoreError(f"wingd verify: {text}") from None
    if faults or done.returncode != 0:
        first = faults[0] if faults else {"path": str(root), "what": f"exit status {done.returncode}"}
        more = f" and {len(faults) - 1} more" if len(faults) > 1 else ""
        raise StoreError(f"{first['path']}: {first['what']}{more}; run `wingd verify`, and restore it from a copy")


def bundle(root: Path, flight: str) -> Bundle:
    """Read what is published of a flight.

    Raises
    ------
    StoreError
        A file is missing, a link, or has another length than recorded.
    """
    place = PurePosixPath("flights") / flight
    sums = _read(root, place / "SHA256SUMS")
    chain = _read(root, place / "chain.jsonl")
    events, length = _covered(root / place, sums, chain)
    files = [_small(root, PurePosixPath("store.toml"))]
    for digest in sorted({event["sha256"] for kind, event in events if kind == "installation"}):
        files += _installation(root, digest)
    files.append(_small(root, place / "flight.json"))
    grown = {event["series"]: event for kind, event in events if kind == "results"}
    series = sorted({event["series"] for kind, event in events if kind == "series"})
    for name in series:
        files += _series(root, place / name, grown.get(name))
    closed = {event["file"]: event for kind, event in events if kind in _CLOSED}
    for name, event in sorted(closed.items()):
        files.append(_recorded(root, place / name, event["bytes"], event["sha256"], grows=False))
    files.append(_of(place / "chain.jsonl", chain[:length]))
    files.append(_of(place / "SHA256SUMS", sums))
    next_ids = {
        "next_flight": int(flight[1:]) + 1,
        "next_series": max((int(name[1:]) for name in series), default=0) + 1,
    }
    files.append(_of(PurePosixPath("counter.json"), (json.dumps(next_ids, separators=(",", ":")) + "\n").encode()))
    started = _json(root / place / "flight.json")["started"]["utc"]
    return Bundle(store_id(root), flight, started, _side(root, chain), tuple(files))


def _events(chain: bytes, path: Path) -> list[tuple[int, str, dict]]:
    """Return end, kind and content of each complete line of a chain; the last line may be torn."""
    found, end = [], 0
    for line in chain.splitlines(keepends=True):
        end += len(line)
        if not line.endswith(b"\n"):
            break
        try:
            value = json.loads(line)
            ((kind, content),) = ((key, part) for key, part in value.items() if key != "before")
        except (ValueError, AttributeError):
            raise StoreError(f"{path}: a line is damaged; {_REMEDY}") from None
        found.append((end, kind, content))
    return found


def _covered(folder: Path, sums: bytes, chain: bytes) -> tuple[list[tuple[str, dict]], int]:
    """Return the events of the chain when SHA256SUMS was written, and its length then."""
    digests = dict(line.split("  ", 1)[::-1] for line in sums.decode(errors="replace").splitlines() if "  " in line)
    wanted, hasher, done, events = digests.get("chain.jsonl"), hashlib.sha256(), 0, []
    for end, kind, content in _events(chain, folder / "chain.jsonl"):
        hasher.update(chain[done:end])
        done = end
        events.append((kind, content))
        if hasher.hexdigest() == wanted:
            return events, end
    raise StoreError(f"{folder / 'SHA256SUMS'}: does not belong to this flight's chain; {_REMEDY}")


def _series(root: Path, place: PurePosixPath, results: dict | None) -> Iterable[File]:
    yield _small(root, place / "series.json")
    for shot in _json(root / place / "series.json")["shots"]:
        frame = shot.get("frame")
        if frame and _FRAME.fullmatch(frame["file"]):
            yield _recorded(root, place / frame["file"], frame["bytes"], frame["sha256"], grows=False)
    if results:
        yield _recorded(root, place / "results.jsonl", results["bytes"], results["sha256"], grows=True)


def _installation(root: Path, digest: str) -> Iterable[File]:
    place = PurePosixPath("installations") / digest
    if not (root / place).is_dir():
        raise StoreError(f"{root / place}: results were computed from this installation, but it is missing; {_REMEDY}")
    sums = _read(root, place / "SHA256SUMS")
    named = dict(line.split("  ", 1)[::-1] for line in sums.decode(errors="replace").splitlines() if "  " in line)
    if sha256(sums) != digest:
        raise StoreError(f"{root / place / 'SHA256SUMS'}: does not have the SHA-256 in its folder's name; {_REMEDY}")
    names = sorted(os.listdir(root / place))
    for name in sorted({*names, *named, "SHA256SUMS"}):
        file = _small(root, place / name)
        if name != "SHA256SUMS" and named.get(name) != file.sha256:
            what = "does not have the SHA-256 in its SHA256SUMS" if name in named else "is not named in its SHA256SUMS"
            raise StoreError(f"{root / place / name}: {what}; {_REMEDY}")
        yield file


def _side(root: Path, chain: bytes) -> str | None:
    used = [content["sha256"] for _, kind, content in _events(chain, root) if kind == "installation"]
    try:
        text = (root / "installations" / used[-1] / "installation.toml").read_text()
        side = tomllib.loads(text)["wing"]["side"]
    except (IndexError, OSError, ValueError, KeyError, TypeError):
        return None
    return side if isinstance(side, str) else None


def _read(root: Path, name: PurePosixPath) -> bytes:
    path = root / name
    if path.is_symlink() or not path.is_file():
        raise StoreError(f"{path}: is missing or a link; {_REMEDY}")
    return path.read_bytes()


def _json(path: Path) -> dict:
    try:
        value = json.loads(path.read_bytes())
    except (OSError, ValueError) as error:
        raise StoreError(f"{path}: cannot be read ({error}); {_REMEDY}") from None
    if not isinstance(value, dict):
        raise StoreError(f"{path}: is not an object; {_REMEDY}")
    return value


def _of(name: PurePosixPath, data: bytes) -> File:
    return File(str(name), len(data), sha256(data), data)


def _small(root: Path, name: PurePosixPath) -> File:
    return _of(name, _read(root, name))


def _recorded(root: Path, name: PurePosixPath, length: int, digest: str, *, grows: bool) -> File:
    path = root / name
    if path.is_symlink() or not path.is_file():
        raise StoreError(f"{path}: is missing or a link; {_REMEDY}")
    there = path.stat().st_size
    if there != length and not (grows and there > length):
        raise StoreError(f"{path}: does not have the recorded length; {_REMEDY}")
    return File(str(name), length, digest, path)
