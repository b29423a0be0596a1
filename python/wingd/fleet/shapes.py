"""Table `shape`: the deflection of each frame at fixed fractions of the span, with the factors of its errors.

Wings are compared at equal arc lengths from the root. Their outermost markers differ, and so does the length of each model: with
`--length` of `wingd-fleet define` the fractions are of the wing's length, without it of the model's tip.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pyarrow as pa

from .lake import FleetError

if TYPE_CHECKING:
    from ..values import Values

#: Fractions of the length at which shapes are compared.
ETA = (0.25, 0.5, 0.75, 1.0)
#: Fractions at which they are exported; between these a cubic spline is exact to 0.1 mm for the demonstration's wing.
EXPORTED_ETA = tuple(k / 20 for k in range(21))
#: Least number of stations of a curve.
MIN_STATIONS = 4
#: Type of a factor.
FACTOR = pa.list_(pa.field("element", pa.float32()))
#: Decimals of lengths in m: equal on machines whose sums differ in their last digits.
DIGITS = 9


def parse_lengths(texts: list[str]) -> dict[str, float]:
    """Parse `TYPE=M` or `M`; the key of the latter is empty.

    Raises
    ------
    FleetError
        A text is no positive number of metres.
    """
    found = {}
    for text in texts:
        kind, _, number = text.rpartition("=")
        try:
            length = float(number)
        except ValueError:
            length = np.nan
        if not 0 < length < np.inf or kind in found:
            raise FleetError(
                f"--length {text}: give the length of the wing from the bending root, m, as 17.1 or A320=17.1"
            )
        found[kind] = length
    return found


def length_of(definition: dict, aircraft_type: str | None) -> float | None:
    """Return the length of the wings of a type in a solve, m; None: that of each model."""
    lengths = definition.get("lengths", {})
    return lengths.get(aircraft_type or "", lengths.get(""))


def rows(export: Path, length: float | None) -> pa.Table:
    """Convert the export of a flight's shape.

    Parameters
    ----------
    export
        NetCDF of ``wingd export --table shape`` at :data:`EXPORTED_ETA`.
    length
        Length of the wing from the bending root, m; None: that of the model's tip.

    Returns
    -------
    pyarrow.Table
        A row per frame and fraction of the span that the model reaches. ``deflection_m`` is ``factor_lasting_m`` u + ``factor_shared_m`` v
        + ``sigma_own_m`` w away from the truth, with independent u, v, w of standard deviation 1: u is common to all frames with the same
        ``lasting_key`` (survey, ground frame, lens), v to those with the same ``shared_key`` (mounting, temperature of the flight).
        What frames share that were adjusted singly is not known: their whole error counts as lasting.
    """
    # xarray and scipy take a second to load, which a query does without.
    from .. import shapes as _accessor  # noqa: F401 - registers the accessor
    from ..backend import open_shape
    from ..values import SINGLE

    dataset = open_shape(export)
    tip = float(dataset.attrs["length_to_tip_m"])
    reference = length or tip
    eta = np.array([one for one in ETA if one * reference <= tip * (1 + 1e-6)])
    arcs = np.minimum(eta * reference, tip)
    values = dataset.wingd.displacement(axis="z").at(arc_length=arcs)
    values = values.transpose("frame", *(dim for dim in values.value.dims if dim != "frame"))
    images = [str(one) for one in dataset["image"].values]
    kinds = {kind: _by_row(values, kind) for kind in ("lasting", "shared", SINGLE)}
    rests = {kind: _size(values, f"{kind}_rest") for kind in ("lasting", "shared")}
    apart = {*kinds, *(f"{kind}_rest" for kind in rests)}
    own = [values.factors[kind].array for kind in values.factors if kind not in apart]
    variance = sum((np.einsum("...gs,...gs->...", one, one) for one in own), np.zeros(values.value.shape))
    sigma, deflection, found = values.sigma.values, values.value.values, []
    for frame, image in enumerate(images):
        series, _, file = image.partition("/")
        for k, one in enumerate(eta):
            factors = {name: of[frame][k] for name, of in kinds.items() if of is not None}
            # What reduced factors do not carry is one more source, of this place.
            for name, rest in rests.items():
                if name in factors and rest is not None:
                    factors[name] = (factors[name][0], [*factors[name][1], float(rest[frame, k])])
            lasting, shared = factors.get("lasting", ("", [])), factors.get("shared", ("", []))
            single = np.sqrt(variance[frame, k])
            if SINGLE in factors:
                lasting, single = (factors[SINGLE][0].split("/")[0], [float(single)]), 0.0
            found.append(
                {
                    "series": series,
                    "shot": int(file.split(".")[0]),
                    "image": file,
                    "side": str(dataset.attrs.get("side", "")) or None,
                    "eta": float(one),
                    "arc_length_m": float(arcs[k]),
                    "length_m": tip,
                    "deflection_m": round(float(deflection[frame, k]), DIGITS),
                    "sigma_deflection_m": round(float(sigma[frame, k]), DIGITS),
                    "sigma_own_m": round(float(single), DIGITS),
                    "lasting_key": lasting[0],
                    "factor_lasting_m": np.round(lasting[1], DIGITS),
                    "shared_key": shared[0],
                    "factor_shared_m": np.round(shared[1], DIGITS),
                }
            )
    return _table(found)


def rows_of_span(span: pa.Table, length: float | None) -> pa.Table:
    """Convert a flight's table `span`: of results as uploaded, whose frames may not be there to be adjusted again.

    Rows as of :func:`rows`. The curve ends at the outermost marker, whose arc length is the default of `length`. What frames share is
    not in the table `span`, so their whole error counts as lasting.
    """
    from scipy.interpolate import make_interp_spline

    columns = (
        "series",
        "shot",
        "image",
        "status",
        "installation_sha256",
        "arc_length_m",
        "deflection_m",
        "sigma_deflection_m",
    )
    frames: dict[tuple, list[dict]] = {}
    for row in span.select([name for name in columns if name in span.column_names]).to_pylist():
        if row["status"] == "ok" and row["arc_length_m"] is not None and row["deflection_m"] is not None:
            frames.setdefault((row["series"], row["shot"]), []).append(row)
    found = []
    for (series, shot), curve in frames.items():
        arcs = np.array([row["arc_length_m"] for row in curve])
        if len(arcs) < MIN_STATIONS or np.any(np.diff(arcs) <= 0):
            continue
        end = float(arcs[-1])
        reference = length or end
        eta = [one for one in ETA if one * reference <= end * (1 + 1e-6)]
        at = np.minimum(np.array(eta) * reference, end)
        value, sigma = (
            make_interp_spline(arcs, [row[name] for row in curve], k=3)(at)
            for name in ("deflection_m", "sigma_deflection_m")
        )
        for k, one in enumerate(eta):
            error = round(float(sigma[k]), DIGITS)
            found.append(
                {
                    "series": series,
                    "shot": shot,
                    "image": curve[0]["image"],
                    "side": None,
                    "eta": one,
                    "arc_length_m": float(at[k]),
                    "length_m": end,
                    "deflection_m": round(float(value[k]), DIGITS),
                    "sigma_deflection_m": error,
                    "sigma_own_m": 0.0,
                    "lasting_key": str(curve[0].get("installation_sha256") or ""),
                    "factor_lasting_m": [error],
                    "shared_key": "",
                    "factor_shared_m": [],
                }
            )
    return _table(found)


def _table(found: list[dict]) -> pa.Table:
    texts = ("series", "image", "side", "lasting_key", "shared_key")
    types = {name: pa.string() for name in texts} | {
        "shot": pa.int64(),
        "factor_lasting_m": FACTOR,
        "factor_shared_m": FACTOR,
    }
    names = list(found[0]) if found else [*types]
    return pa.table({name: pa.array([row[name] for row in found], types.get(name, pa.float64())) for name in names})


def _size(values: Values, kind: str) -> np.ndarray | None:
    """Return the standard deviation of a kind of errors, (frames, stations); None if the shape has none."""
    factor = values.factors.get(kind)
    return None if factor is None else np.sqrt(np.einsum("...gs,...gs->...", factor.array, factor.array))


def _by_row(values: Values, kind: str) -> list[list[tuple[str, list[float]]]] | None:
    """Return key and factor of each frame and station; None if the shape has no such errors."""
    factor = values.factors.get(kind)
    if factor is None:
        return None
    factor = factor.expanded()
    frames, stations = values.value.shape
    found = []
    for frame in range(frames):
        keys = factor.keys[frame] if factor.per_frame else factor.keys
        used = [g for g, key in enumerate(keys) if key and np.any(factor.array[frame, :, g])] or [0]
        if len(used) > 1:
            raise FleetError(
                f"a frame has {len(used)} groups of {kind} errors; use a wingd for Python that matches wingd"
            )
        found.append([(str(keys[used[0]]), factor.array[frame, k, used[0]].tolist()) for k in range(stations)])
    return found


def with_identity(content: pa.Table, shots: pa.Table) -> pa.Table:
    """Add what identifies a row, its time and its origin, from the table `shots`."""
    place = {key: k for k, key in enumerate(zip(shots["series"].to_pylist(), shots["shot"].to_pylist(), strict=True))}
    index = [place[key] for key in zip(content["series"].to_pylist(), content["shot"].to_pylist(), strict=True)]
    names = (
        "recorder_id",
        "flight",
        "utc",
        "status",
        "method",
        "program",
        "installation_sha256",
        "parameters",
        "inputs",
    )
    for name in names:
        if name in shots.column_names and name not in content.column_names:
            content = content.append_column(name, shots[name].take(pa.array(index)))
    return content
