"""Definitions of solves: a solve names one choice of program, installations and arguments.

An installation belongs to a recorder and is valid from a flight or a date onwards: two wings have two installations,
and a new survey does not change older flights.
"""

from __future__ import annotations

import tomllib
from pathlib import Path

from . import records
from .corrections import FLIGHT, from_whence, reached, recorder
from .lake import NAME, Damaged, FleetError, Flight, Lake
from .records import sha256

# Value in place of installations: use the uploaded results, compute nothing.
KEPT = "kept"


def files_of(folder: Path) -> dict[str, bytes]:
    """Read the files of an installation: installation.toml and the files that it names."""
    main = folder / "installation.toml"
    try:
        table = tomllib.loads(main.read_text())
    except (OSError, tomllib.TOMLDecodeError) as error:
        raise FleetError(f"{main}: cannot be read ({error}); give the folder of a prepared installation") from error
    names = ["installation.toml", "orientation.toml"]
    for section, entry in (("camera", "calibration"), ("wing", "survey"), ("cad", "tie_points")):
        name = table.get(section, {}).get(entry)
        names += [name] if isinstance(name, str) else []
    missing = [name for name in names if not (folder / name).is_file()]
    if missing:
        raise FleetError(f"{folder}: lacks {', '.join(missing)}; run `wingd check --installation` for details")
    # Other tables of the folder may be referenced too; images are not part of an installation.
    more = [path.name for path in folder.iterdir() if path.is_file() and path.suffix in {".toml", ".csv"}]
    return {name: (folder / name).read_bytes() for name in sorted({*names, *more})}


def digest_of(files: dict[str, bytes]) -> str:
    """Return the SHA-256 of the lines `<sha256>  <file>`, sorted by name."""
    return sha256("".join(f"{sha256(data)}  {name}\n" for name, data in sorted(files.items())).encode())


def key(name: str) -> str:
    """Return the key of a definition."""
    return f"solves/{name}.json"


def rules(lake: Lake, texts: list[str]) -> list[tuple[dict, Path]]:
    """Parse `RECORDER=DIR`, `RECORDER@f0012=DIR`, `RECORDER@2026-11-01=DIR` to rules with their folders."""
    known, found = [flight.recorder for flight in flights(lake)], []
    for text in texts:
        who, equals, folder = text.partition("=")
        if not equals:
            raise FleetError(f"--installation {text}: give RECORDER=DIR or RECORDER@FROM=DIR")
        who, at, since = who.partition("@")
        try:
            of = recorder(known, who)
        except FleetError as error:
            hint = "installations belong to recorders: an aircraft has two wings and may be surveyed again"
            raise FleetError(f"--installation {text}: {error} ({hint})") from None
        found.append(({"recorder": of, "from": from_whence(since if at else None)}, Path(folder)))
    _refuse_unclear([rule for rule, _ in found])
    return found


def _refuse_unclear(all_of: list[dict]) -> None:
    for rule in all_of:
        same = [one["from"] for one in all_of if one["recorder"] == rule["recorder"]]
        if len(set(same)) < len(same):
            raise FleetError(
                f"--installation: recorder {rule['recorder']} has two from {rule['from'] or 'the start'} onwards"
            )
        if len({bool(FLIGHT.fullmatch(since)) for since in same if since}) > 1:
            raise FleetError(
                f"--installation: recorder {rule['recorder']} has some from a flight and some from a date onwards; "
                "use one kind only, because their order is unknown"
            )


def flights(lake: Lake) -> list[Flight]:
    """Return all flights."""
    from .lake import flight_of

    return sorted({flight for name in lake.keys("manifests") if (flight := flight_of(name))})


def define(
    lake: Lake,
    name: str,
    installations: list[tuple[dict, Path]] | None,
    arguments: list[str],
    program: str,
    lengths: dict[str, float] | None = None,
) -> dict:
    """Write the definition of a solve, once. `installations`: rules with folders; None: the uploaded results.

    A name has one definition permanently: another definition is refused, and the difference is reported.
    """
    if not NAME.fullmatch(name):
        raise FleetError(f"{name!r} is not a valid name of a solve; use letters, digits, '.', '_', '-'")
    known = []
    for rule, folder in installations or []:
        files = files_of(folder)
        digest = digest_of(files)
        known.append({**rule, "digest": digest})
        for file, data in files.items():
            lake.settle(f"installations/{digest}/{file}", data)
    known.sort(key=lambda rule: (rule["recorder"], rule["from"] or ""))
    wanted = {
        "solve": name,
        "installations": KEPT if installations is None else known,
        "arguments": arguments,
        "program": program,
    }
    if lengths:
        wanted["lengths"] = lengths
    if not records.create_twice(lake, key(name), records.dump(wanted)):
        there = read(lake, name)
        there = {"lengths": {}, **there}
        differing = [part for part in {"lengths": {}, **wanted} if there[part] != wanted.get(part, {})]
        if differing:
            part = differing[0]
            raise FleetError(
                f"{lake.url}/{key(name)}: is another solve already: {part} {_short(there[part])}, not "
                f"{_short(wanted.get(part, {}))}; nothing was changed; choose another name"
            )
    return read(lake, name)


def _short(value) -> str:
    if isinstance(value, list) and value and isinstance(value[0], dict):
        return ", ".join(f"{one['recorder'][:8]}@{one['from'] or 'start'}={one['digest'][:8]}" for one in value)
    return str(value)


def read(lake: Lake, name: str) -> dict:
    """Read the definition of a solve."""
    found = records.read_twice(lake, key(name))
    if found is None:
        raise FleetError(f"{lake.url}/{key(name)}: does not exist; define it with `wingd-fleet define`")
    return found


def names(lake: Lake) -> list[str]:
    """Return the names of all solves."""
    return [name.removeprefix("solves/").removesuffix(".json") for name in records.names_twice(lake, "solves")]


def choose(definition: dict, flight: Flight, started: str) -> str:
    """Return the digest of the installation that is valid for a flight."""
    own = [rule for rule in definition["installations"] if rule["recorder"] == flight.recorder]
    valid = [rule for rule in own if reached(rule["from"], flight, started)]
    if not valid:
        since = f" before {min(rule['from'] for rule in own)}" if own else ""
        raise FleetError(
            f"solve {definition['solve']} has no installation for recorder {flight.recorder}{since}; "
            "define another solve that has one"
        )
    # `f0012` and dates sort chronologically; None comes first.
    return max(valid, key=lambda rule: (rule["from"] is not None, len(rule["from"] or ""), rule["from"]))["digest"]


def installation(lake: Lake, digest: str) -> dict[str, bytes]:
    """Read the files of an installation; raises Damaged if any is missing or changed."""
    files = {name.rsplit("/", 1)[1]: lake.need(name) for name in lake.keys(f"installations/{digest}")}
    if digest_of(files) != digest:
        raise Damaged(
            [f"{lake.url}/installations/{digest}: is incomplete; define the solve again with the same folders"]
        )
    return files
