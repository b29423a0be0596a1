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
from wingd.values import STATION

#: Format that this package reads (attribute ``format_version``).
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
    if version != FORMAT_VERSION:
        remedy = "update wingd for Python" if version > FORMAT_VERSION else "export it again"
        raise WingdError(f"{name}: has format version {version}; this package reads {FORMAT_VERSION}: {remedy}")
    return index_stations(_decode_texts(raw))


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
