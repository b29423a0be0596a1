"""Access to results: stores, lakes and exported files.

The program ``wingd`` (on the PATH, or ``WINGD=``) exports from a store, because it alone adjusts. Its output is kept in a
cache (``WINGD_CACHE``, default ``~/.cache/wingd``) under the digest of program, options and files of the flight.
"""

from __future__ import annotations

import hashlib
import json
import os
import shutil
import subprocess
import tempfile
import warnings
from collections.abc import Iterator, Sequence
from functools import cached_property, lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import xarray as xr

from wingd import WingdError, __version__
from wingd.backend import open_shape
from wingd.values import FRAME, WingdWarning

#: Stations of shapes that are read from a store: so that `sel(eta=.5)` is one of them.
ETA = tuple(np.round(np.linspace(0.0, 1.0, 41), 3))
#: Files below this size are part of a digest with their content, larger ones with size and time.
CONTENT_BYTES = 16 << 20
_IMAGES = {".jpg", ".jpeg", ".png", ".tif", ".tiff", ".pgm", ".ppm"}


def open(
    path: str | os.PathLike[str] | Sequence[str | os.PathLike[str]], installation: str | None = None
) -> Store | Lake | Exported:  # noqa: A001
    """Open results.

    Parameters
    ----------
    path
        A store, a lake (``s3://BUCKET/PREFIX`` or ``file:///DIRECTORY``), or one or several files of
        ``wingd export --format netcdf --table shape`` (also ``s3://BUCKET/FILE.nc``).
    installation
        Installation to adjust with, if not the one kept in the store.
    """
    if installation is not None and not (isinstance(path, str | os.PathLike) and Path(path).is_dir()):
        raise WingdError(
            f"{path}: is not a store on this disk, whose installation could be replaced; omit installation"
        )
    if isinstance(path, str) and path.startswith(("s3://", "file://")) and not path.endswith(".nc"):
        return Lake(path)
    files = [path] if isinstance(path, str | os.PathLike) else list(path)
    first = Path(files[0])
    if len(files) == 1 and first.is_dir():
        if not (first / "store.toml").exists() and (first / "store" / "store.toml").exists():
            first = first / "store"
        if not (first / "store.toml").exists():
            raise WingdError(f"{first}: is not a store: store.toml is missing")
        return Store(first, installation)
    return Exported(files)


# --- the program ----------------------------------------------------------------------------------------------------


def program() -> str:
    """Return the path of the program ``wingd``."""
    named = os.environ.get("WINGD")
    found = shutil.which(named or "wingd")
    if found is None:
        raise WingdError(
            f"WINGD={named}: is not a program"
            if named
            else "the program wingd is not on the PATH; install it, or set WINGD="
        )
    _check_version(found)
    return found


@lru_cache
def _check_version(found: str) -> str:
    answer = subprocess.run([found, "--version"], capture_output=True, text=True)
    version = answer.stdout.strip().rpartition(" ")[2]
    if answer.returncode or not version:
        raise WingdError(f"{found}: does not run: {answer.stderr.strip() or 'no version'}")
    if version.split(".")[:2] != __version__.split(".")[:2]:
        raise WingdError(f"{found} is version {version}, this package {__version__}; install the two of one release")
    return version


def run_program(arguments: Sequence[str]) -> str:
    """Run the program and return its standard output; its notes become warnings, its error a :class:`WingdError`."""
    answer = subprocess.run([program(), *arguments], capture_output=True, text=True)
    notes = [line.removeprefix("wingd: ").strip() for line in answer.stderr.splitlines() if line.strip()]
    notes = [n for n in notes if not n.startswith("Try '")]
    if answer.returncode:
        raise WingdError("; ".join(notes[-3:]) or f"wingd {arguments[0]} failed with status {answer.returncode}")
    for note in notes:
        warnings.warn(note, WingdWarning, stacklevel=3)
    return answer.stdout


def cache_folder() -> Path:
    """Return the folder of the cache, created if it does not exist."""
    folder = Path(
        os.environ.get("WINGD_CACHE") or Path(os.environ.get("XDG_CACHE_HOME", "~/.cache")).expanduser() / "wingd"
    )
    folder.mkdir(parents=True, exist_ok=True)
    return folder


def digest_files(folders: Sequence[Path]) -> str:
    """Return a digest of the files below `folders`; images count by the store's list of digests."""
    digest = hashlib.sha256()
    for folder in folders:
        for file in sorted(p for p in folder.rglob("*") if p.is_file() and p.suffix.lower() not in _IMAGES):
            facts = file.stat()
            digest.update(f"{file.relative_to(folder)}\0{facts.st_size}\0".encode())
            digest.update(file.read_bytes() if facts.st_size < CONTENT_BYTES else str(facts.st_mtime_ns).encode())
    return digest.hexdigest()


def _export(store: Path, flight: str | None, arguments: Sequence[str], suffix: str, inputs: Sequence[Path]) -> Path:
    """Export into the cache, or return what an earlier export of equal inputs wrote."""
    found = Path(program())
    facts = found.stat()
    options = [*arguments, *(["--flight", flight] if flight else [])]
    name = hashlib.sha256(
        "\0".join([str(facts.st_size), str(facts.st_mtime_ns), *options, digest_files(inputs)]).encode()
    ).hexdigest()
    kept = cache_folder() / f"{name[:32]}{suffix}"
    if not kept.exists():
        with tempfile.TemporaryDirectory(dir=cache_folder()) as folder:
            output = Path(folder) / f"export{suffix}"
            run_program(["export", str(store), *options, "--output", str(output)])
            if not output.exists():
                raise WingdError(f"{store}: the export is empty; run `wingd solve {store}` first")
            os.replace(output, kept)
    return kept


def read_table(file: str | os.PathLike[str]) -> pd.DataFrame:
    """Read a table of ``wingd export`` (CSV, Parquet or JSON lines); times become UTC timestamps."""
    if str(file).endswith(".parquet"):
        table = pd.read_parquet(file)
    elif str(file).endswith(".jsonl"):
        table = pd.read_json(file, lines=True)
    else:
        table = pd.read_csv(file, dtype={"image": str, "series": str}, low_memory=False)
    for name in ("utc", "exposure_time", "time"):
        if name in table and not pd.api.types.is_datetime64_any_dtype(table[name]):
            table[name] = pd.to_datetime(table[name], utc=True, errors="coerce", format="ISO8601")
    return table


# --- stores ---------------------------------------------------------------------------------------------------------


class Flight:
    """A flight of a store."""

    def __init__(self, store: Path, name: str, installation: str | None = None):
        self.store, self.name, self.installation = store, name, installation

    def __repr__(self) -> str:
        return f"<wingd.Flight {self.store}:{self.name}>"

    def _inputs(self) -> list[Path]:
        return [
            self.store / "flights" / self.name,
            self.store / "installations",
            *([Path(self.installation)] if self.installation else []),
        ]

    def table(self, name: str) -> pd.DataFrame:
        """Return a table of ``wingd export``: ``shots``, ``summary``, ``markers``, ``span``, ``parameters``, ``live``."""
        return read_table(_export(self.store, self.name, ["--format", "csv", "--table", name], ".csv", self._inputs()))

    @cached_property
    def shots(self) -> pd.DataFrame:
        """A row per shot: status, times, deflections with sigma, and aircraft data."""
        return self.table("shots").set_index(["series", "image"], drop=False)

    @cached_property
    def live(self) -> pd.DataFrame:
        """A row per result of live mode."""
        return self.table("live")

    @cached_property
    def moments(self) -> pd.DataFrame:
        """Bending moments of the frames at the sections of the stiffness, N m, with sigma; see :mod:`wingd.loads`."""
        from wingd.loads import read_moments

        return read_moments(self.table("moments"))

    def frames(self, eta: Sequence[float] | None = None, full: bool = False) -> xr.Dataset:
        """Return the shapes of all frames.

        Parameters
        ----------
        eta
            Stations as fractions of the length to the tip; None for 0, 0.025, ... 1.
        full
            Factors that are not reduced.
        """
        stations = ",".join(f"{e:.9g}" for e in (ETA if eta is None else eta))
        arguments = ["--format", "netcdf", "--table", "shape", "--eta", stations]
        arguments += ["--installation", self.installation] if self.installation else []
        arguments += ["--full-factors"] if full else []
        return open_shape(_export(self.store, self.name, arguments, ".nc", self._inputs()))

    def shape(
        self,
        series: str | None = None,
        *,
        frame: str | None = None,
        where: str | None = None,
        eta: Sequence[float] | None = None,
    ) -> xr.Dataset:
        """Return the mean shape of a series, of the frames that fulfil conditions, or of the flight, or the shape of a frame.

        Parameters
        ----------
        series
            Series, such as ``s000002``.
        frame
            Frame, such as ``s000002/0001.jpg``.
        where
            Conditions of the aircraft data, such as ``mach between .78 and .80``.
        eta
            Stations as for :meth:`frames`.
        """
        return select_frames(self.frames(eta), series, frame, where, str(self))

    def __str__(self) -> str:
        return f"{self.store}:{self.name}"


def select_frames(
    shapes: xr.Dataset, series: str | None, frame: str | None, where: str | None, name: str
) -> xr.Dataset:
    """Return the mean of selected frames, or the shape of one."""
    images = np.asarray(shapes["image"].values, dtype=str)
    keep = np.ones(len(images), dtype=bool)
    if series is not None:
        keep &= np.char.startswith(images, f"{series}/") | (images == series)
    if frame is not None:
        keep &= images == frame
    if not keep.any():
        known = sorted({i.partition("/")[0] for i in images}) if frame is None else sorted(images)
        raise WingdError(f"{name}: has no frame of {frame or series} with a shape; known are {', '.join(known[:20])}")
    chosen = shapes.isel(frame=np.flatnonzero(keep))
    chosen = chosen.wingd.where(where) if where else chosen
    return chosen.isel(frame=0) if frame is not None and chosen.sizes[FRAME] == 1 else chosen.wingd.mean()


class _Flights:
    """Flights by name: a store, exported files, or a lake."""

    def __init__(self, place: Any):
        self.place = place

    def __repr__(self) -> str:
        return f"<wingd.{type(self).__name__} {self.place}: {', '.join(self.names)}>"

    @property
    def names(self) -> list[str]:
        """Names of the flights, in order."""
        raise NotImplementedError

    def _flight(self, name: str) -> Any:
        raise NotImplementedError

    def _row(self, name: str) -> dict[str, Any]:
        raise NotImplementedError

    def __iter__(self) -> Iterator[Any]:
        return (self[name] for name in self.names)

    def __getitem__(self, name: str) -> Any:
        if name not in self.names:
            raise WingdError(f"{self.place}: there is no flight {name}; known are {', '.join(self.names) or 'none'}")
        return self._flight(name)

    @cached_property
    def flights(self) -> pd.DataFrame:
        """A row per flight: its start (UTC), and what is known of it without reading its frames."""
        rows = pd.DataFrame([{"flight": name, **self._row(name)} for name in self.names])
        return rows.set_index("flight", drop=False) if len(rows) else pd.DataFrame(columns=["flight", "started"])

    def shape(self, *arguments: Any, **options: Any) -> xr.Dataset:
        """Return the shape of the only flight; see :meth:`Flight.shape`."""
        if len(self.names) != 1:
            raise WingdError(f"{self.place}: has the flights {', '.join(self.names)}; write store[FLIGHT].shape(...)")
        return self[self.names[0]].shape(*arguments, **options)


class Store(_Flights):
    """Flights on disk; rows have series, frames, solved frames, and the extremes of the tip deflection (m)."""

    def __init__(self, path: Path, installation: str | None = None):
        super().__init__(path)
        self.path, self.installation = path, installation

    @property
    def names(self) -> list[str]:
        """Names of the flights, in order."""
        return sorted(p.name for p in (self.path / "flights").glob("*") if (p / "flight.json").exists())

    def _flight(self, name: str) -> Flight:
        return Flight(self.path, name, self.installation)

    def _row(self, name: str) -> dict[str, Any]:
        started = json.loads((self.path / "flights" / name / "flight.json").read_text())["started"]["utc"]
        shots = self[name].shots
        solved = shots.loc[shots["status"] == "ok"]
        row = {"started": pd.Timestamp(started), "series": shots["series"].nunique(), "frames": len(shots)}
        row["solved"] = len(solved)
        # Reported deflections of several references are not one quantity.
        tip = "tip_deflection_ground_m"
        return row | ({f"{k}_{tip}": getattr(solved[tip], k)() for k in ("min", "max")} if tip in solved else {})


class Exported(_Flights):
    """Shapes in files of ``wingd export``; needs no program. Of several recorders, flights are RECORDER/FLIGHT."""

    def __init__(self, files: Sequence[str | os.PathLike[str]]):
        super().__init__(", ".join(map(str, files)))
        found: dict[tuple[str, str], xr.Dataset] = {}
        for part in map(open_shape, files):
            recorder = np.broadcast_to(part.coords.get("recorder_id", ""), part.sizes[FRAME])
            keys = np.array([recorder, part["flight"].values], dtype=str)
            for key in dict.fromkeys(zip(*keys, strict=True)):
                if key in found:
                    raise WingdError(f"the files {self.place} have flight {key[1]} twice; open one of them")
                rows = np.flatnonzero((keys == np.array(key)[:, None]).all(axis=0))
                found[key] = part if len(rows) == part.sizes[FRAME] else part.isel(frame=rows)
        several = len({recorder for recorder, _ in found}) > 1
        self._found = {f"{r}/{f}" if several else f: data for (r, f), data in found.items()}

    @property
    def names(self) -> list[str]:
        """Names of the flights."""
        return list(self._found)

    def _flight(self, name: str) -> ExportedFlight:
        return ExportedFlight(name, self._found[name])

    def _row(self, name: str) -> dict[str, Any]:
        data = self._found[name]
        series = {str(i).partition("/")[0] for i in data["image"].values}
        solved = np.isfinite(data["sigma_displacement"].values).any(axis=(1, 2)).sum()
        # Frames of unknown time have none.
        row = {"started": pd.Timestamp(np.fmin.reduce(data["time"].values), tz="UTC"), "series": len(series)}
        return row | {"frames": data.sizes[FRAME], "solved": solved}


class ExportedFlight:
    """A flight of exported files."""

    def __init__(self, name: str, data: xr.Dataset):
        self.name, self._data = name, data

    def frames(self) -> xr.Dataset:
        """Return the shapes of all frames."""
        return self._data

    @property
    def shots(self) -> pd.DataFrame:
        """A row per frame, with conditions."""
        columns = [n for n in self._data.variables if self._data[n].dims == (FRAME,)]
        return self._data[columns].to_dataframe()[[c for c in columns if not str(c).endswith("_sources")]]

    @property
    def moments(self) -> pd.DataFrame:
        """Bending moments of the frames, N m, with sigma."""
        from wingd.loads import shape_moments

        return shape_moments(self._data)

    def shape(self, series: str | None = None, *, frame: str | None = None, where: str | None = None) -> xr.Dataset:
        """Return the mean shape of a series or of conditions, or the shape of a frame; see :meth:`Flight.shape`."""
        return select_frames(self._data, series, frame, where, self.name)


class Lake(_Flights):
    """Flights of an object store, RECORDER/FLIGHT; a flight is downloaded into the cache when it is used."""

    def __init__(self, url: str):
        from wingd.fleet.lake import Lake as Objects
        from wingd.fleet.state import State

        self.url = url.rstrip("/")
        super().__init__(self.url)
        self._objects = Objects(self.url)
        self._folder = cache_folder() / "lakes" / hashlib.sha256(self.url.encode()).hexdigest()[:16]
        self._state = State(self._objects, self._folder / "state")
        self._state.read_manifests()
        self._places = {str(flight): flight for flight in self._state.flights}

    @property
    def names(self) -> list[str]:
        """Names of the flights: RECORDER/FLIGHT."""
        return list(self._places)

    def _row(self, name: str) -> dict[str, Any]:
        about = self._state.about(self._places[name])
        return {"aircraft": about.aircraft, "wing": about.wing, "started": pd.Timestamp(about.started)}

    def _flight(self, name: str) -> Flight:
        from wingd.fleet import records, task

        place = self._places[name]
        manifest = records.read(self._objects, place.manifest)
        store = self._folder / str(manifest["seal"])[:16]
        if not store.exists():
            self._folder.mkdir(parents=True, exist_ok=True)
            with tempfile.TemporaryDirectory(dir=self._folder) as folder:
                task.fetch(self._objects, place, manifest, Path(folder) / "store")
                os.replace(Path(folder) / "store", store)
        return Flight(store, place.flight)
