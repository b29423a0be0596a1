"""What a solve is: a name for one choice of program, installations and arguments."""

from __future__ import annotations

import tomllib
from pathlib import Path

from .lake import NAME, FleetError, Lake, dump, sha256

# In place of an installation: the results that came with the flight, nothing computed.
KEPT = "kept"


def files_of(folder: Path) -> dict[str, bytes]:
    """The files that an installation consists of: installation.toml and what it names."""
    main = folder / "installation.toml"
    try:
        table = tomllib.loads(main.read_text())
    except (OSError, tomllib.TOMLDecodeError) as error:
        raise FleetError(f"{main}: cannot be read ({error}); name a prepared installation") from error
    names = ["installation.toml", "orientation.toml"]
    for section, entry in (("camera", "calibration"), ("wing", "survey"), ("cad", "tie_points")):
        name = table.get(section, {}).get(entry)
        names += [name] if isinstance(name, str) else []
    missing = [name for name in names if not (folder / name).is_file()]
    if missing:
        raise FleetError(f"{folder}: lacks {', '.join(missing)}; `wingd check --installation` says more")
    # Other tables of the folder may be named too; pictures are none of it.
    more = [path.name for path in folder.iterdir() if path.is_file() and path.suffix in {".toml", ".csv"}]
    return {name: (folder / name).read_bytes() for name in sorted({*names, *more})}


def digest_of(files: dict[str, bytes]) -> str:
    """SHA-256 over the lines `<sha256>  <file>` in the names' order."""
    return sha256("".join(f"{sha256(data)}  {name}\n" for name, data in sorted(files.items())).encode())


def key(name: str) -> str:
    return f"solves/{name}.json"


def define(lake: Lake, name: str, installations: dict[str, Path] | None, arguments: list[str], program: str) -> dict:
    """Writes what a solve is, once. `installations`: aircraft -> folder; None: the results that came along.

    A name stands for one definition for good: with another one it is refused.
    """
    if not NAME.fullmatch(name):
        raise FleetError(f"{name!r} is no name of a solve; give letters, digits, '.', '_', '-'")
    known = {}
    for aircraft, folder in sorted((installations or {}).items()):
        if not NAME.fullmatch(aircraft):
            raise FleetError(f"{folder}: {aircraft!r} is no aircraft's name; letters, digits, '.', '_', '-'")
        files = files_of(folder)
        known[aircraft] = digest_of(files)
        for file, data in files.items():
            lake.create(f"installations/{known[aircraft]}/{file}", data)
    definition = {
        "solve": name,
        "installations": KEPT if installations is None else known,
        "arguments": arguments,
        "program": program,
    }
    data = dump(definition)
    if not lake.create(key(name), data) and lake.get(key(name)) != data:
        raise FleetError(f"{lake.url}/{key(name)}: is another solve already; choose another name")
    return definition


def read(lake: Lake, name: str) -> dict:
    if lake.get(key(name)) is None:
        raise FleetError(f"{lake.url}/{key(name)}: is not there; define it with `wingd-fleet define`")
    return lake.json(key(name))
