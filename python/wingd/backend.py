"""Reading of shapes that ``wingd export --format netcdf --table shape`` wrote: ``xarray.open_dataset(engine="wingd")``."""

from __future__ import annotations

import importlib
import io
import os
from collections.abc import Iterable
from typing import Any

import numpy as np
import xarray as xr
from xarray.backends import BackendEntrypoint
from xarray.indexes import PandasIndex

from wingd import WingdError
from wingd.values import FRAME, STATION, digest

#: Newest format that this package reads (attribute ``format_version``; files without it are of version 1).
FORMAT_VERSION = 2
#: Kinds of sources: dimensions of factors, whose keys are the variables ``KIND_sources``.
KINDS = ("lasting", "shared", "own", "fit")
#: Largest difference of a label of a station from the value asked for, relative.
LABEL_TOLERANCE = 1e-6


class StationIndex(PandasIndex):
    """Index of stations by a number: an exact label within rounding, never a neighbour."""

    def sel(self, labels: dict[Any, Any], method: str | None = None, tolerance: float | None = None) -> Any:
        """Select stations; `method` as in xarray."""
        ((name, label),) = labels.items()
        if method is None and not isinstance(label, slice) and len(self.index):
            known = np.asarray(self.index, dtype=float)
            wanted = np.asarray(getattr(label, "values", label), dtype=float)
            nearest = known[np.abs(known[:, None] - wanted.ravel()).argmin(axis=0)].reshape(wanted.shape)
            if np.any(np.abs(nearest - wanted) > LABEL_TOLERANCE * max(known.max(), 1.0)):
                raise KeyError(
                    f"there is no station at {name} = {label}; nearest is {np.ravel(nearest)[0]:.6g}. "
                    f"`.wingd.displacement().sel({name}=...)` interpolates, or export with --eta"
                )
            label = nearest if wanted.ndim else float(nearest)
        return super().sel({name: label}, method=method, tolerance=tolerance)


class WingdBackend(BackendEntrypoint):
    """Backend ``engine="wingd"``."""

    description = "shapes of a wing, written by wingd export"
    open_dataset_parameters = ("filename_or_obj", "drop_variables")

    def open_dataset(self, filename_or_obj: Any, *, drop_variables: str | Iterable[str] | None = None) -> xr.Dataset:
        """Open a file; arrays are read when they are used."""
        return open_shape(filename_or_obj, drop_variables)

    def guess_can_open(self, filename_or_obj: Any) -> bool:
        """Do not take files that were not asked for."""
        return False


def open_shape(file: Any, drop_variables: str | Iterable[str] | None = None) -> xr.Dataset:
    """Open an exported shape.

    Parameters
    ----------
    file
        NetCDF file of ``wingd export --format netcdf --table shape``, or its URL ``s3://BUCKET/FILE``.

    Returns
    -------
    xarray.Dataset
        Format 2 of ``docs/shapes.md``: dimensions frame, eta, marker, axis, and the sources of factors. Lengths are in
        m, angles in rad; factors ``QUANTITY_KIND`` are in the unit of the quantity, and ``KIND_sources`` names their
        sources. Arrays are read when they are used.
    """
    # Datasets have the accessor `.wingd` from here on.
    importlib.import_module("wingd.shapes")
    name = file
    if isinstance(file, str) and file.startswith("s3://"):
        from wingd.objects import read_object

        file = io.BytesIO(read_object(file))
    elif isinstance(file, str | os.PathLike) and not os.path.exists(file):
        raise FileNotFoundError(f"{os.fspath(file)}: no such file")
    try:
        raw = xr.open_dataset(file, engine=_engine(file), drop_variables=drop_variables, cache=False)
    except (ValueError, TypeError, OSError, KeyError) as error:
        raise WingdError(f"{name}: is not a NetCDF file that can be read: {error}") from error
    if "displacement" not in raw or "arc_length" not in raw:
        raise WingdError(f"{name}: is not a shape; write it with `wingd export STORE --format netcdf --table shape`")
    version = int(float(raw.attrs.get("format_version", 1)))
    if version > FORMAT_VERSION:
        raise WingdError(
            f"{name}: has format version {version}; this package reads up to {FORMAT_VERSION}: update wingd for Python"
        )
    raw = _decode_texts(raw)
    if version < 2:
        raw = _complete_first_version(raw)
    return index_stations(raw)


def index_stations(data: xr.Dataset) -> xr.Dataset:
    """Index stations by `eta` and `arc_length`, and make names, times and digests coordinates."""
    names = ["arc_length", "time", "image", "flight", "recorder_id", "inputs", "thermal_scale", "jointly"]
    names += [f"{kind}_sources" for kind in KINDS]
    data = data.set_coords([n for n in names if n in data])
    for name in (STATION, "arc_length"):
        if name in data.coords and data[name].ndim == 1 and not isinstance(data.xindexes.get(name), StationIndex):
            data = data.drop_indexes(name) if name in data.xindexes else data
            data = data.set_xindex(name, StationIndex)
    return data


def _engine(file: Any) -> str | None:
    if not isinstance(file, str | os.PathLike):
        return None
    with open(file, "rb") as opened:
        return "scipy" if opened.read(3) == b"CDF" else None


def _decode_texts(raw: xr.Dataset) -> xr.Dataset:
    texts = {}
    for name, array in raw.variables.items():
        if array.dtype.kind == "S" or (
            array.dtype.kind == "O" and array.size and isinstance(array.values.flat[0], bytes)
        ):
            decoded = np.array([t.decode("utf-8", "replace").rstrip("\0") for t in array.values.ravel()], dtype=str)
            texts[name] = (array.dims, decoded.reshape(array.shape), array.attrs)
    return raw.assign(texts)


def _number(text: Any) -> float:
    try:
        return float(text)
    except (TypeError, ValueError):
        return np.nan


def _complete_first_version(raw: xr.Dataset) -> xr.Dataset:
    """Give a file of the first version what later ones write: coordinates, digests of sources, numbers as numbers."""
    attrs = dict(raw.attrs)
    for name in ("length_to_tip_m", "outermost_marker_m"):
        attrs[name] = _number(attrs.get(name))
    attrs.pop("thermal_scale", None)
    flow = [_number(part) for part in str(attrs.pop("flow_direction", "")).split(",")]
    if len(flow) == 2 and np.isfinite(flow).all():
        attrs["flow_direction"] = flow
    provenance, flight = attrs.get("provenance", ""), attrs.pop("flight", "")
    files = sorted(part for part in provenance.split(",") if ".sha256" in part and "frames" not in part)
    jointly = "lasting" in raw.dims
    names = raw["image"].values
    # A flight's factors are reduced for the frames and stations of this file.
    keys = {
        "lasting": digest("lasting", *files, raw.sizes.get("lasting", 0)),
        "shared": digest("shared", provenance, raw["arc_length"].values.tobytes(), *names),
        "fit": digest("fit", *files),
    }
    frames = raw.sizes[FRAME]
    out = (
        raw.set_coords("eta")
        .swap_dims(station=STATION)
        .assign(
            {
                **{f"{kind}_sources": (FRAME, np.full(frames, key)) for kind, key in keys.items()},
                "own_sources": (FRAME, [digest("own", flight, provenance, name) for name in names]),
                "jointly": (FRAME, np.full(frames, float(jointly))),
                "flight": (FRAME, np.full(frames, flight)),
                "inputs": (FRAME, np.full(frames, digest(provenance))),
                "thermal_scale": (FRAME, _thermal_scale(raw)),
            }
        )
    )
    out = out.drop_vars("marker_id").assign_coords(axis=["x", "y", "z"], marker=raw["marker_id"].values)
    out.attrs = attrs
    return out


def _thermal_scale(raw: xr.Dataset) -> np.ndarray:
    """Return the ratio of the axis' length in flight to that on the ground, (frames,); NaN with few stations."""
    if raw.sizes["station"] < 10 or raw["arc_length"].values[0] > 1e-9:
        return np.full(raw.sizes[FRAME], np.nan)
    ground = raw["ground_position"].values
    length = [
        np.linalg.norm(np.diff(p, axis=-2), axis=-1).sum(axis=-1) for p in (ground, ground + raw["displacement"].values)
    ]
    return length[1] / length[0]
