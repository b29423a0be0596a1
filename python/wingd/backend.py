"""Reading of shapes that ``wingd export --format netcdf --table shape`` wrote: ``xarray.open_dataset(engine="wingd")``."""

from __future__ import annotations

import os
from collections.abc import Iterable
from typing import Any

import numpy as np
import xarray as xr
from xarray.backends import BackendEntrypoint
from xarray.indexes import PandasIndex

from wingd import WingdError
from wingd.values import SINGLE, digest

#: Newest format that this package reads (attribute ``format_version``; files without it are of version 1).
FORMAT_VERSION = 2
#: Kinds of sources by the names of their dimensions in files.
KINDS = {
    "lasting": "installation",
    "shared": "flight",
    "own": "frame",
    "fit": "tie",
    **{kind: kind for kind in ("installation", "flight", "frame", "tie", "root", "instrument", "computation", SINGLE)},
}
#: Suffix of the sigma of what reduced factors lack, by the names in files.
REST = "rest"
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
        NetCDF file of ``wingd export --format netcdf --table shape``.

    Returns
    -------
    xarray.Dataset
        Dimensions frame, station, marker, axis, and the sources of factors. Coordinates ``eta`` (1), ``arc_length`` (m),
        ``marker``, ``axis`` (x, y, z), ``time`` of the exposure, ``image``. Lengths are in m, angles in rad; factors
        ``QUANTITY_KIND`` are in the unit of the quantity, and ``KIND_key`` names their sources.
    """
    if isinstance(file, str | os.PathLike) and not os.path.exists(file):
        raise FileNotFoundError(f"{os.fspath(file)}: no such file")
    try:
        raw = xr.open_dataset(file, engine=_engine(file), drop_variables=drop_variables)
    except (ValueError, TypeError, OSError, KeyError) as error:
        raise WingdError(f"{file}: is not a NetCDF file that can be read: {error}") from error
    if "displacement" not in raw or "arc_length" not in raw:
        raise WingdError(f"{file}: is not a shape; write it with `wingd export STORE --format netcdf --table shape`")
    version = int(float(raw.attrs.get("format_version", 1)))
    if version > FORMAT_VERSION:
        raise WingdError(
            f"{file}: has format version {version}; this package reads up to {FORMAT_VERSION}: update wingd for Python"
        )
    raw = _decode_texts(raw)
    if version < 2:
        raw = _complete_first_version(raw)
    return _name_sources(raw)


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
    """Give a file of the first version what later ones write: coordinates, keys of sources, numbers as numbers."""
    attrs = dict(raw.attrs)
    for name in ("length_to_tip_m", "outermost_marker_m", "thermal_scale"):
        attrs[name] = _number(attrs.get(name))
    flow = [_number(part) for part in str(attrs.get("flow_direction", "")).split(",")]
    attrs["flow_direction"] = flow if len(flow) == 2 and np.isfinite(flow).all() else []
    provenance = attrs.get("provenance", "")
    # A flight's factors are reduced for these frames and stations: their sources are those of this file alone.
    frames, names = raw.sizes["frame"], raw["image"].values
    files = [part for part in provenance.split(",") if ".sha256" in part and "frames" not in part]
    installation = digest("installation", *sorted(files), raw.sizes.get("lasting", 0))
    flight = digest("flight", provenance, raw["arc_length"].values.tobytes(), *names)
    jointly = "lasting" in raw.dims
    own = "own" if jointly else SINGLE
    keys = {
        "flight_id": ("frame", np.full(frames, attrs.get("flight", ""))),
        "lasting_key": ("frame", np.full(frames, installation)),
        "shared_key": ("frame", np.full(frames, flight)),
        f"{own}_key": ("frame", [f"{installation}/{digest(attrs.get('flight'), provenance, name)}" for name in names]),
        "fit_key": ("frame", np.full(frames, digest("tie", installation))),
    }
    if not jointly:
        raw = raw.rename(
            {name: name.removesuffix("own") + SINGLE for name in raw.variables if str(name).endswith("_own")}
        )
        raw = raw.rename({"own": SINGLE})
        attrs["singly"] = 1
    out = raw.assign({k: v for k, v in keys.items() if k.removesuffix("_key") in raw.dims or k == "flight_id"})
    out = out.assign_coords(axis=["x", "y", "z"]).rename(marker_id="marker_name")
    out = out.assign_coords(marker=out["marker_name"].values).drop_vars("marker_name")
    out = out.assign_coords(thermal_scale=("frame", _thermal_scale(raw)))
    out.attrs = attrs | {"installation_digest": installation}
    return out


def _thermal_scale(raw: xr.Dataset) -> np.ndarray:
    """Return the ratio of the axis' length in flight to that on the ground, (frames,); NaN with few stations."""
    if raw.sizes["station"] < 10 or raw["arc_length"].values[0] > 1e-9:
        return np.full(raw.sizes["frame"], np.nan)
    ground = raw["ground_position"].values
    flight = ground + raw["displacement"].values
    length = [np.linalg.norm(np.diff(p, axis=-2), axis=-1).sum(axis=-1) for p in (ground, flight)]
    return length[1] / length[0]


def _name_sources(raw: xr.Dataset) -> xr.Dataset:
    """Name factors and keys by the kinds of :mod:`wingd.values`, and index stations."""
    rename = {}
    for name in raw.variables:
        stem, _, kind = str(name).rpartition("_")
        if kind in KINDS and raw[name].dims[-1:] == (kind,):
            rename[name] = f"{stem}_{KINDS[kind]}"
        elif kind == "key" and stem in KINDS:
            rename[name] = f"{KINDS[stem]}_key"
    for dim in raw.dims:
        if dim in KINDS:
            # The dimension `frame` is that of the frames.
            rename[dim] = f"{KINDS[dim]}_source"
    rename = {k: v for k, v in rename.items() if k != v and k != "frame"}
    out = raw.rename(rename)
    coords = [n for n in ("eta", "arc_length", "time", "image", "flight_id", "thermal_scale") if n in out]
    coords += [n for n in out.data_vars if str(n).endswith("_key")]
    out = out.set_coords(coords)
    for name in ("eta", "arc_length"):
        if name not in out.xindexes:
            out = out.set_xindex(name, StationIndex)
    return out
