"""Shapes: quantities of a dataset with their covariance, references, means and differences.

The accessor ``dataset.wingd`` works on datasets of ``xarray.open_dataset(file, engine="wingd")`` and of
:func:`wingd.open`.
"""

from __future__ import annotations

import re
import warnings
from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
import xarray as xr
from scipy.interpolate import make_interp_spline

from wingd import WingdError
from wingd.backend import KINDS, index_stations
from wingd.values import FRAME, REST, SINGLE, STATION, Factor, Values, WingdWarning, concat, digest

if TYPE_CHECKING:
    from wingd.comparison import Comparison

#: Standard deviation of the bending root along the span if a file does not state it, m: the program's default.
DEFAULT_ROOT_SIGMA_M = 0.3
#: Facts of a dataset that its values carry.
FACTS = ("side", "reference", "length_to_tip_m", "outermost_marker_m", "root_offset_sigma_m")
#: Largest relative difference of the distance from the root of equal arc lengths.
SECTION_TOLERANCE = 0.005
#: Numbers of frames that are no aircraft data.
NO_CONDITION = {"frames", "variance_factor"}


@xr.register_dataset_accessor("wingd")
class ShapeAccessor:
    """Quantities of a shape, its means and what is done with it."""

    def __init__(self, dataset: xr.Dataset):
        self._data = dataset

    @property
    def quantities(self) -> list[str]:
        """Names of the quantities with a standard deviation."""
        return [str(n) for n in self._data.data_vars if f"sigma_{n}" in self._data]

    def values(self, quantity: str, **indexers: Any) -> Values:
        """Return a quantity with its covariance.

        Parameters
        ----------
        quantity
            Name of a variable, such as ``displacement``, ``slope``, ``marker_displacement``.
        indexers
            Positions along dimensions, read alone: ``axis=2``.
        """
        data = self._data
        if quantity not in data or f"sigma_{quantity}" not in data:
            raise WingdError(f"the shape has no {quantity!r}; known are {', '.join(self.quantities)}")
        kinds = _factor_names(data, quantity)
        part = data[[quantity, *kinds.values()]].isel(indexers)
        value = part[quantity]
        keep = {
            c: v.variable
            for c, v in value.coords.items()
            if set(v.dims) <= set(value.dims) and not c.endswith("_sources")
        }
        clean = xr.DataArray(value.values, keep, value.dims, quantity, dict(value.attrs))
        clean.attrs |= {k: data.attrs[k] for k in FACTS if k in data.attrs}
        if STATION in value.dims and "ground_position" in data and data["arc_length"].values[0] < 1e-9:
            ground = self._positions("ground_position")
            clean.coords["root_distance"] = STATION, np.linalg.norm(ground - ground[0], axis=-1)
        factors = {kind: _read_factor(data, part[name], kind, value.dims) for kind, name in kinds.items()}
        clean.attrs["installations"] = (
            sorted({str(k).partition("#")[0] for k in factors["lasting"].keys.ravel()}) if "lasting" in factors else []
        )
        single = _single_frames(data, value)
        return Values(clean, factors if single is None else {**factors, SINGLE: single})

    def displacement(
        self, axis: str | None = "z", reference: str = "survey", axes: str = "survey", thermal: bool = True
    ) -> Values:
        """Return the displacement of the bending axis, m.

        Parameters
        ----------
        axis
            ``x``, ``y`` or ``z`` of the frame `axes`; None for all three.
        reference
            ``survey`` (the surveyed wing), ``ground`` (the ground frame) or ``root`` (the tangent at the root, from
            there). The last two are of the vertical displacement, by the deflections of the markers.
        axes
            ``survey`` or ``cad``.
        thermal
            False removes the contraction of the wing by temperature: lengths from the root are those on the ground.
        """
        return self._moved("displacement", "ground_position", axis, reference, axes, thermal)

    def marker_displacement(self, axis: str | None = "z", axes: str = "survey", thermal: bool = True) -> Values:
        """Return the displacement of the markers against the survey, m; parameters as for :meth:`displacement`."""
        return self._moved("marker_displacement", "marker_ground_position", axis, "survey", axes, thermal)

    def deflections(self, reference: str = "ground") -> Values:
        """Return the vertical deflections of the markers, m, against ``survey``, ``ground`` (frame) or ``root`` (tangent)."""
        if "marker_deflection" not in self._data:
            raise WingdError("the file has no marker_deflection; export it again with this version of wingd")
        return _named(
            self.values("marker_deflection").sel(reference=reference), f"deflection relative to the {reference}"
        )

    def slope(self) -> Values:
        """Return the change of the slope along the span, rad, tip up positive."""
        return self.values("slope")

    def twist(self) -> Values:
        """Return the twist about the bending axis, rad, nose up positive."""
        return self.values("twist")

    def streamwise_twist(self, line: str = "chord") -> Values:
        """Return the change of the incidence in the vertical plane of the flow, rad, nose up positive.

        Parameters
        ----------
        line
            ``chord``: inclination of the material chord line that lay along the flow on the ground (as in tables of
            models of wings). ``plane``: of the line in which the plane of the section and the plane of the flow meet.
        """
        if line not in ("chord", "plane"):
            raise WingdError(f'line = {line!r}: give "chord" or "plane"')
        name = f"streamwise_twist_{line}"
        if name in self._data or line == "plane":
            return self.values(name if name in self._data else "streamwise_twist")
        return self._chord_twist()

    def rotation(self, axis: str | None = None) -> Values:
        """Return the rotation vector of the sections, rad, survey frame, the root's included."""
        return _pick_axis(self.values("rotation"), axis)

    def _positions(self, name: str) -> np.ndarray:
        """Return places on the ground, m (places, 3); of files that were joined along frames, the first."""
        array = self._data[name]
        return (array.isel(frame=0) if FRAME in array.dims else array).values

    def _root(self, values: Values) -> Values:
        if STATION not in values.value.dims or values.value["arc_length"].values[0] > 1e-9:
            raise WingdError("the shape has no station at the root; export it with 0 among --eta")
        return values.isel(eta=0)

    def _moved(self, name: str, ground: str, axis: str | None, reference: str, axes: str, thermal: bool) -> Values:
        if axes not in ("survey", "cad"):
            raise WingdError(f'axes = {axes!r}: give "survey" or "cad"')
        if reference not in ("survey", "ground", "root"):
            raise WingdError(f'reference = {reference!r}: give "survey", "ground" or "root"')
        if axes == "cad" and not (reference == "survey" and thermal):
            raise WingdError("axes='cad' has the reference survey with thermal contraction; use axes='survey'")
        if axes == "cad" and "cad_fit" not in self._data:
            raise WingdError("the shape has no CAD axes; add [cad] to installation.toml and export again")
        if axes == "cad":
            return _named(_pick_axis(self._in_cad(name), axis), axis=axis)
        label = None
        if thermal:
            values = self.values(name, **({} if axis is None else {"axis": _axis_index(axis)}))
        else:
            values = self._without_contraction(self.values(name), ground)
            label = f"{values.label}, without thermal contraction"
            values = _pick_axis(values, axis)
        if reference != "survey":
            if axis != "z":
                raise WingdError(f"reference = {reference!r} is of the vertical displacement; give axis='z'")
            values = values - self._reference_motion(reference)
            label = (
                f"{values.label}, relative to the {'ground frame' if reference == 'ground' else 'tangent at the root'}"
            )
        return _named(values, label, axis)

    def _in_cad(self, name: str) -> Values:
        """Return displacements along the CAD axes: those of the survey turned and scaled, with the errors of the tie points."""
        survey, matrix = self.values(name), self._positions("cad_from_survey")[:3, :3]
        moved = survey.value.values @ matrix.T
        value = survey.value.copy(data=moved)
        value.attrs["long_name"] = str(value.attrs.get("long_name", name)).replace("survey frame", "CAD frame")
        turned = survey.mapped(value, lambda a, power: np.einsum("ij,...jgs->...igs", matrix**power, a))
        # A turn by a small vector moves a displacement by the cross product; a change of scale lengthens it.
        by_turn = np.cross(np.eye(3), moved[..., None, :])
        by_scale = moved[..., None, :] / np.cbrt(np.linalg.det(matrix))
        by_fit = np.moveaxis(np.concatenate([by_turn, by_scale], axis=-2), -2, -1) @ self._positions("cad_fit")
        fit = xr.DataArray(by_fit, dims=[*value.dims, "fit"])
        return Values(value, {**turned.factors, "fit": _read_factor(self._data, fit, "fit", value.dims)})

    def _without_contraction(self, values: Values, ground: str) -> Values:
        """Return displacements without the change of length by temperature: distances from the root are those on the ground."""
        root = _expand_root(self._root(self.values("displacement")), values)
        positions = self._positions(ground) - self._positions("ground_position")[0]
        scale = self._scale(values)
        apart = values - root + positions
        out = root + apart / scale - positions
        if "sigma_thermal_scale" in self._data:
            # The scale's error moves every point along its line from the root.
            scale_of = self._data["thermal_scale"]
            plain = xr.DataArray(scale_of.values, dims=scale_of.dims)
            kinds = _factor_names(self._data, "thermal_scale")
            factors = {k: _read_factor(self._data, self._data[n], k, plain.dims) for k, n in kinds.items()}
            error = Values(plain - plain, factors).at_other_place("scale").broadcast(list(values.value.dims), values)
            out = out - error * (apart.value.values / scale**2)
        return out

    def _reference_motion(self, reference: str) -> Values:
        """Return the vertical motion of the stations between survey and reference, m, by that of the markers.

        The bend between survey and ground frame is smooth along the span, and the root moves as a rigid body.
        """
        if "marker_deflection" not in self._data:
            raise WingdError(
                "the file has no deflections against the ground frame; export it again, or use reference='survey'"
            )
        deflections = self.values("marker_deflection")
        of = {r: deflections.sel(reference=r).at_other_place(r) for r in ("survey", "ground", "root")}
        markers, stations = self._positions("marker_ground_position"), self._positions("ground_position")
        arc = self._data["arc_length"].values
        span = (stations[-1] - stations[0]) / np.linalg.norm(stations[-1] - stations[0])
        along = np.interp((markers - stations[0]) @ span, (stations - stations[0]) @ span, arc) / arc[-1]
        axis_at = np.stack([np.interp(along * arc[-1], arc, stations[:, k]) for k in range(3)], axis=-1)
        aft = np.cross([0.0, 0.0, 1.0], span)
        behind, eta = (markers - axis_at) @ aft, arc / arc[-1]
        bend = np.stack([along**2, along**3, along * behind], axis=-1)
        motion = _fitted(of["survey"] - of["ground"], bend, np.stack([eta**2, eta**3, 0 * eta], axis=-1), self._data)
        if reference == "ground":
            return motion
        rigid = [np.column_stack([np.ones(len(p)), p[:, :2] - stations[0, :2]]) for p in (markers, stations)]
        return motion + _fitted(of["ground"] - of["root"], *rigid, self._data)

    def _scale(self, values: Values) -> np.ndarray:
        scale = self._data.coords.get("thermal_scale")
        scale = np.asarray(np.nan if scale is None else scale.values, dtype=float)
        if np.isnan(scale).any():
            raise WingdError("the shape does not state its thermal scale; export it with all stations")
        return scale.reshape(scale.shape + (1,) * (values.value.ndim - scale.ndim))

    def _chord_twist(self) -> Values:
        """Incidence of the material chord line, from the rotation vectors."""
        flow = np.asarray(self._data.attrs.get("flow_direction", ()), dtype=float)
        if flow.shape[0] < 2 or not np.isfinite(flow).all():
            raise WingdError(
                "the shape has no streamwise twist; give wing.flow_direction in installation.toml and export again"
            )
        aft = np.array([*(flow[:2] / np.linalg.norm(flow[:2])), 0.0])
        turn = self.values("rotation")
        vector = turn.value.values

        def incidence(rotation: np.ndarray) -> np.ndarray:
            angle = np.linalg.norm(rotation, axis=-1, keepdims=True)
            unit = rotation / np.where(angle > 0, angle, 1.0)
            along = np.sum(unit * aft, axis=-1, keepdims=True)
            turned = aft * np.cos(angle) + np.cross(unit, aft) * np.sin(angle) + unit * along * (1 - np.cos(angle))
            return np.arctan2(-turned[..., 2], turned @ aft)

        step, eye = 1e-6, np.eye(3)
        slopes = np.stack(
            [(incidence(vector + step * e) - incidence(vector - step * e)) / (2 * step) for e in eye], axis=-1
        )
        value = turn.value.isel(axis=0, drop=True).copy(data=incidence(vector))
        value.name, value.attrs["long_name"] = (
            "streamwise_twist",
            "change of the incidence of the material chord line, nose up",
        )
        return turn.mapped(value, lambda a, power: np.einsum("...a,...ags->...gs", slopes**power, a))

    # --- datasets -------------------------------------------------------------------------------------------------

    def where(self, conditions: str) -> xr.Dataset:
        """Return the frames whose aircraft data fulfil `conditions`, such as ``mach between .78 and .80 and weight_t < 190``."""
        keep = np.ones(self._data.sizes[FRAME], dtype=bool)
        for name, scale, offset, low, high in parse_conditions(conditions, self._conditions()):
            values = (self._data[name].values - offset) / scale
            keep &= (values >= low) & (values <= high)
        if not keep.any():
            raise WingdError(f"no frame fulfils {conditions!r}")
        return self._data.isel(frame=np.flatnonzero(keep))

    def _conditions(self) -> list[str]:
        data = self._data
        names = [str(n) for n in data.data_vars if data[n].dims == (FRAME,) and data[n].dtype.kind == "f"]
        return [n for n in names if n not in NO_CONDITION and not n.startswith("sigma_") and not n.endswith(REST)]

    def condition(self, name: str) -> Values:
        """Return a quantity of the aircraft data; the errors of an instrument are common to the frames of an aircraft."""
        if name not in self._data:
            raise WingdError(f"the frames have no {name}; join aircraft data with `wingd aircraft-data`")
        array = self._data[name]
        sigma = self._data[f"sigma_{name}"].values if f"sigma_{name}" in self._data else np.full(array.shape, np.nan)
        if np.isnan(sigma).any() or np.isnan(array.values).any():
            raise WingdError(
                f"a frame has no {name} with a standard deviation; join aircraft data, or give the difference and its sigma"
            )
        recorder = (
            self._data.coords["recorder_id"].values
            if "recorder_id" in self._data.coords
            else self._data.attrs.get("recorder_id", "")
        )
        keys = [f"{one}/{name}" for one in np.atleast_1d(recorder)]
        plain = Values(xr.DataArray(array.values.astype(float), dims=array.dims, name=name, attrs=dict(array.attrs)))
        if len(set(keys)) == 1 or array.ndim == 0:
            return plain.with_source("instrument", "+".join(sorted(set(keys))), sigma)
        return Values(plain.value, {"instrument": Factor(np.array(keys, dtype=object)[:, None], sigma[:, None, None])})

    def mean(self) -> xr.Dataset:
        """Return the mean shape: of the frames of each flight, then of the flights, which count equally.

        Frames without a shape are left out, and with a warning those whose status is not ok. ``scatter_QUANTITY`` is the
        standard deviation of single frames about the mean of their flight.
        """
        data = self._data
        if FRAME not in data.dims:
            return data
        known = np.isfinite(data["sigma_displacement"].values).any(axis=(1, 2))
        if not known.any():
            raise WingdError("no frame has a shape")
        data = data if known.all() else data.isel(frame=np.flatnonzero(known))
        flights = data["flight"].values if "flight" in data.coords else np.zeros(data.sizes[FRAME])
        return mean([data.isel(frame=np.flatnonzero(flights == f)) for f in dict.fromkeys(flights)])

    def mirror(self) -> xr.Dataset:
        """Return the shape as of the other side: quantities that depend on the side (x, y, rotations) are dropped."""
        data = self._data
        drop = [n for n in data.variables if re.match(r"(sigma_|scatter_)?rotation", str(n)) or n == "cad_fit"]
        data = data.drop_vars(drop)
        for name in ("displacement", "marker_displacement"):
            if name in data:
                data[name] = data[name].where(data["axis"] == "z")
        other = {"left": "right", "right": "left"}
        data.attrs = data.attrs | {"side": other.get(str(data.attrs.get("side")), ""), "mirrored": 1}
        return data

    def deform(self, mesh: Any, **options: Any) -> Any:
        """Return `mesh` moved by this shape; see :mod:`wingd.surfaces`."""
        from wingd import surfaces

        return surfaces.deform(self._data, mesh, **options)

    def difference(self, other: xr.Dataset, **options: Any) -> Comparison:
        """Return this shape minus another; see :func:`wingd.comparison.difference`."""
        from wingd.comparison import difference

        return difference(self._data, other, **options)

    def plot(self, ax: Any = None, **style: Any) -> Any:
        """Draw the vertical displacement with its band."""
        return self.displacement().plot(ax=ax, **style)


def _factor_names(data: xr.Dataset, quantity: str) -> dict[str, str]:
    """Return the variables of a quantity's factors by their kinds."""
    found, prefix = {}, f"{quantity}_"
    for name in data.variables:
        kind = str(name)[len(prefix) :]
        if str(name).startswith(prefix) and (
            kind in data[name].dims
            or kind.removesuffix(REST) in (*KINDS, "stiffness")
            or f"{kind}_sources" in data.coords
        ):
            found[kind] = str(name)
    # The CAD frame turns the other factors of the survey frame.
    return found


def _read_factor(data: xr.Dataset, array: xr.DataArray, kind: str, dims: tuple[Any, ...]) -> Factor:
    base, group = kind.removesuffix(REST), f"{kind}_group"
    array = array.transpose(*dims, ...)
    numbers = np.nan_to_num(np.array(array.values, dtype=float), copy=False)
    if kind.endswith(REST) and kind not in array.dims:
        numbers = numbers[..., None]
    if group not in array.dims:
        numbers = numbers[..., None, :]
    sources = data.coords.get(f"{kind}_sources", data.coords.get(f"{base}_sources"))
    # The stiffness belongs to the installation.
    sources = data.coords.get("lasting_sources") if sources is None else sources
    keys = np.array([""] if sources is None else sources.values, dtype=object)
    keys = (
        keys.reshape(len(keys), -1)
        if FRAME in dims and sources is not None and FRAME in sources.dims
        else keys.reshape(-1)
    )
    if base == "shared" and "inputs" in data.coords and keys.ndim == 2:
        keys = np.array([[f"{i}/{k}"] for i, k in zip(data["inputs"].values, keys[:, 0], strict=True)], dtype=object)
    keys, numbers = (keys, numbers) if keys.ndim == 2 or len(keys) == numbers.shape[-2] else (keys[:1], numbers)
    keys, bases = _read_bases(data, keys) if kind == "lasting" else (keys, {})
    # One key for all frames is not a key per frame.
    if keys.ndim == 2 and keys.shape[1] == 1 and len(set(keys[:, 0])) == 1:
        keys = keys[0]
    return Factor(keys, numbers, bases)


def _read_bases(data: xr.Dataset, keys: np.ndarray) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """Return keys with their reduction, which is one for the frames of a flight, and the bases."""
    if "lasting_basis" not in data:
        return keys, {}
    basis = data["lasting_basis"].transpose(..., "lasting_source", "lasting")
    frames = basis.ndim == 3
    flights = data["inputs"].values if frames and "inputs" in data.coords else np.arange(len(keys))
    reductions, bases, out = {}, {}, keys.astype(object)
    for k, flight in enumerate(np.atleast_1d(flights) if frames else [""]):
        if flight not in reductions:
            matrix = np.nan_to_num(np.asarray((basis[k] if frames else basis).values, dtype=float))
            reductions[flight] = digest(matrix.tobytes()), matrix
        name, matrix = reductions[flight]
        out[k, ...] = f"{np.ravel(keys[k])[0]}#{name}"
        bases[str(np.ravel(out[k])[0])] = matrix
    return out, bases


def _single_frames(data: xr.Dataset, value: xr.DataArray) -> Factor | None:
    """Return the mark of frames that were adjusted singly, if there are any."""
    if "jointly" not in data.coords or "own_sources" not in data.coords or bool(np.all(data["jointly"].values)):
        return None
    lasting, own, jointly = (np.atleast_1d(data[n].values) for n in ("lasting_sources", "own_sources", "jointly"))
    keys = np.array([f"{a}/{'joint' if j else o}" for a, o, j in zip(lasting, own, jointly, strict=True)], dtype=object)
    keys = keys[:, None] if FRAME in value.dims else keys
    return Factor(keys, np.zeros((*value.shape, 1, 0)))


def _axis_index(axis: str) -> int:
    if axis not in ("x", "y", "z"):
        raise WingdError(f'axis = {axis!r}: give "x", "y", "z" or None')
    return "xyz".index(axis)


def _pick_axis(values: Values, axis: str | None) -> Values:
    return values if axis is None else values.isel(axis=_axis_index(axis))


def _named(values: Values, label: str | None = None, axis: str | None = None) -> Values:
    value = values.value.copy()
    if label is not None:
        value.attrs["long_name"] = label
    if axis is not None:
        value.name = f"{value.name}_{axis}"
        value.attrs["long_name"] = f"{axis} of the {value.attrs.get('long_name', value.name)}"
    return Values(value, values.factors)


def _expand_root(root: Values, like: Values) -> Values:
    """Return the root's values for every place of `like`: dimensions (frame,) place, axis."""
    dims = list(like.value.dims)
    coords = {c: v.variable for c, v in root.value.coords.items() if FRAME in v.dims or c == "axis"}
    plain = xr.DataArray(root.value.values, coords, root.value.dims, attrs={})
    return Values(plain, root.factors).at_other_place("root").broadcast(dims, like)


def _fitted(motion: Values, at_markers: np.ndarray, at_stations: np.ndarray, data: xr.Dataset) -> Values:
    """Return the motion of stations by least squares through that of markers, with functions (places x functions)."""
    axis = motion.value.dims.index("marker")
    weights = at_stations @ np.linalg.pinv(at_markers)

    def linear(array: np.ndarray, power: int) -> np.ndarray:
        return np.moveaxis(np.tensordot(array, weights**power, axes=(axis, 1)), -1, axis)

    dims = [STATION if d == "marker" else d for d in motion.value.dims]
    coords = {c: v.variable for c, v in data.coords.items() if v.dims == (STATION,)}
    value = xr.DataArray(linear(motion.value.values, 1), coords, dims, attrs={"units": "m"})
    return motion.mapped(value, linear).at_other_place("markers")


# --- stations of two shapes ---------------------------------------------------------------------------------------


def match_stations(one: Values, two: Values) -> tuple[Values, Values]:
    """Bring two values to common arc lengths from the bending root.

    Of different installations, the places of the roots are independent: each side gets the error of its root along the
    span (``root_offset_sigma_m`` times the slope of the value) as a source ``root``.

    Warns
    -----
    WingdWarning
        If the lengths differ, with both.
    """
    facts = [v.value.attrs for v in (one, two)]
    sides = [f.get("side") for f in facts]
    if all(sides) and sides[0] != sides[1]:
        raise WingdError(f"the shapes are of the {sides[0]} and the {sides[1]} wing; compare with mirror=True")
    a, b = (v.value["arc_length"].values for v in (one, two))
    keys = [f.get("installations", []) for f in facts]
    is_other = bool(keys[0] and keys[1]) and keys[0] != keys[1]
    lengths = [f.get("length_to_tip_m") for f in facts]
    if is_other and None not in lengths and abs(lengths[0] - lengths[1]) > 1e-6 * lengths[0]:
        markers = [f.get("outermost_marker_m", np.nan) for f in facts]
        warnings.warn(
            f"lengths to the tip {lengths[0]:.3f} and {lengths[1]:.3f} m (outermost markers at {markers[0]:.3f} and "
            f"{markers[1]:.3f} m): compared at equal arc lengths from the root, up to {min(a.max(), b.max()):.3f} m",
            WingdWarning,
            stacklevel=3,
        )
    if a.shape != b.shape or not np.allclose(a, b, atol=1e-6):
        low, high = max(a.min(), b.min()), min(a.max(), b.max())
        keep = np.flatnonzero((a >= low - 1e-9) & (a <= high + 1e-9))
        if len(keep) == 0:
            raise WingdError(
                f"the shapes have no arc length in common: {a.min():.2f} to {a.max():.2f} m and {b.min():.2f} to {b.max():.2f} m"
            )
        one, two = one.isel(eta=keep), two.at(arc_length=a[keep].clip(b.min(), b.max()))
    if not is_other:
        return one, two
    sigmas = [float(f.get("root_offset_sigma_m", DEFAULT_ROOT_SIGMA_M)) for f in facts]
    _check_sections(one, two, float(np.hypot(*sigmas)))
    return _with_root(one, keys[0], sigmas[0]), _with_root(two, keys[1], sigmas[1])


def _check_sections(one: Values, two: Values, sigma_m: float) -> None:
    distances = [v.value.coords.get("root_distance") for v in (one, two)]
    if any(d is None or np.isnan(d.values).any() for d in distances):
        return
    a, b, arc = distances[0].values, distances[1].values, one.value["arc_length"].values
    off = np.abs(a - b) > SECTION_TOLERANCE * arc + 0.1 * sigma_m
    if off.any():
        k = int(np.argmax(np.abs(a - b)))
        raise WingdError(
            f"the bending axes differ: at {arc[k]:.2f} m along them, sections are {a[k]:.2f} and {b[k]:.2f} m from the root; "
            "wings with other sweep or breaks are not compared"
        )


def _with_root(values: Values, keys: list[str], sigma_m: float) -> Values:
    if "root" in values.factors or sigma_m == 0 or values.value.sizes[STATION] < 2:
        return values
    axis, arc = values.value.dims.index(STATION), values.value["arc_length"].values
    finite = np.nan_to_num(values.value.values)
    slope = make_interp_spline(arc, finite, k=min(3, len(arc) - 1), axis=axis).derivative()(arc)
    return values.with_source("root", "+".join(keys), sigma_m * slope)


# --- means --------------------------------------------------------------------------------------------------------


def _without_doubtful(shape: xr.Dataset) -> xr.Dataset:
    """Leave out frames whose result must not be used without looking, with a warning that names them."""
    if "status" not in shape or FRAME not in shape["status"].dims:
        return shape
    status = np.asarray(shape["status"].values, dtype=str)
    refused = ~np.isin(status, ["ok", ""])
    if not refused.any():
        return shape
    one = int(np.flatnonzero(refused)[0])
    image, reason = (str(shape[name].values[one]) if name in shape else "" for name in ("image", "reason"))
    first = f"first {image}, {status[one]}: {reason}"
    if refused.all():
        raise WingdError(f"no frame has the status ok, {first}; look at the frames, and select single ones by frame=")
    warnings.warn(
        f"{refused.sum()} of {refused.size} frames are left out of the mean, {first}", WingdWarning, stacklevel=3
    )
    return shape.isel(frame=np.flatnonzero(~refused))


def mean(shapes: Sequence[xr.Dataset]) -> xr.Dataset:
    """Return the mean of shapes, which count equally; several frames in one are averaged first.

    Parameters
    ----------
    shapes
        Datasets of one installation and side, with equal stations.

    Returns
    -------
    xarray.Dataset
        Without frames; ``frames`` is their number, ``scatter_QUANTITY`` the standard deviation of single frames about
        the mean of their flight, if a flight has several.
    """
    shapes = [_without_doubtful(shape) for shape in shapes]
    if not shapes:
        raise WingdError("there is no shape to average")
    first = shapes[0].attrs
    for shape in shapes[1:]:
        if shape.attrs.get("side") != first.get("side"):
            raise WingdError("the flights are of the left and the right wing; average each alone")
        if set(np.ravel(shape["lasting_sources"])) != set(np.ravel(shapes[0]["lasting_sources"])):
            raise WingdError(
                "the flights have different installations, whose common errors are not known; average each alone"
            )
        if not np.allclose(shape["arc_length"], shapes[0]["arc_length"], atol=1e-6):
            raise WingdError("the flights have different stations; export them with the same --eta")
    names = [n for n in shapes[0].wingd.quantities if all(n in s.wingd.quantities for s in shapes)]
    quantities, scatters = {}, {}
    for name in names:
        parts, squares = [], []
        for shape in shapes:
            values = shape.wingd.values(name)
            if FRAME in values.value.dims:
                if values.value.sizes[FRAME] > 1:
                    squares.append(values.value.var(FRAME, ddof=1, skipna=False).values)
                values = values.mean()
            parts.append(values)
        quantities[name] = parts[0] if len(parts) == 1 else concat(parts).mean()
        if squares:
            scatters[name] = np.sqrt(np.mean(squares, axis=0))
    out = to_dataset(quantities)
    for name, scatter in scatters.items():
        text = f"standard deviation of single frames about their mean: {quantities[name].label}"
        out[f"scatter_{name}"] = (
            quantities[name].value.dims,
            scatter,
            {"units": quantities[name].unit, "long_name": text},
        )
    for name in ("ground_position", "marker_ground_position", "cad_from_survey", "cad_fit"):
        if name in shapes[0]:
            out[name] = shapes[0][name].variable
    if "fit_sources" in shapes[0].coords:
        out.coords["fit_sources"] = str(np.ravel(shapes[0]["fit_sources"])[0])
    for name in shapes[0].wingd._conditions():
        if all(name in s and FRAME in s[name].dims for s in shapes):
            for column in (name, f"sigma_{name}"):
                if all(column in s for s in shapes):
                    out[column] = (
                        (),
                        float(np.mean([s[column].mean(skipna=False) for s in shapes])),
                        dict(shapes[0][column].attrs),
                    )
    if all("thermal_scale" in s.coords for s in shapes):
        out.coords["thermal_scale"] = float(np.mean([s["thermal_scale"].mean() for s in shapes]))
    if all("recorder_id" in s.coords for s in shapes):
        names = {str(r) for s in shapes for r in np.ravel(s["recorder_id"].values)}
        out.coords["recorder_id"] = "+".join(sorted(names))
    out["frames"] = sum(int(s["frames"].sum()) if "frames" in s else s.sizes.get(FRAME, 1) for s in shapes)
    if all("global_test" in s for s in shapes):
        out["global_test"] = "rejected" if any((s["global_test"] == "rejected").any() for s in shapes) else "passed"
    out.attrs = dict(first) | {"flights": len(shapes)}
    return index_stations(out)


def to_dataset(quantities: dict[str, Values]) -> xr.Dataset:
    """Return a dataset of quantities with their sigmas and factors, which :class:`ShapeAccessor` reads."""
    out = xr.Dataset()
    for name, values in quantities.items():
        value = values.value.drop_vars("root_distance", errors="ignore")
        out[name] = value.drop_indexes([c for c in (STATION, "arc_length") if c in value.xindexes])
        sigma = values.sigma
        out[f"sigma_{name}"] = value.dims, sigma.values, {"units": values.unit, "long_name": sigma.attrs["long_name"]}
        for kind, factor in values.factors.items():
            factor = factor.expanded()
            out[f"{name}_{kind}"] = (*value.dims, f"{kind}_group", kind), factor.array, {"units": values.unit}
            dims = (FRAME, f"{kind}_group") if factor.per_frame else (f"{kind}_group",)
            out.coords[f"{kind}_sources"] = dims, factor.keys
    return out


# --- conditions ---------------------------------------------------------------------------------------------------

#: Unit of a condition's name -> other units: (factor, offset) of value_in_other = value * factor + offset.
_UNITS = {
    "kg": {"t": (1e-3, 0.0), "lb": (1 / 0.45359237, 0.0)},
    "m": {"ft": (1 / 0.3048, 0.0), "km": (1e-3, 0.0)},
    "m_s": {"kt": (3.6 / 1.852, 0.0), "km_h": (3.6, 0.0)},
    "c": {"k": (1.0, 273.15), "f": (1.8, 32.0)},
    "hpa": {"pa": (100.0, 0.0), "psi": (0.0145037738, 0.0)},
    "deg": {"rad": (np.pi / 180, 0.0)},
}


def find_condition(name: str, known: Iterable[str]) -> tuple[str, float, float]:
    """Return the known quantity that `name` means, with factor and offset of the unit in `name`."""
    known = list(known)
    if name in known:
        return name, 1.0, 0.0
    for quantity in known:
        for unit, others in _UNITS.items():
            stem = quantity.removesuffix(f"_{unit}")
            for other, (factor, offset) in others.items():
                if stem != quantity and name == f"{stem}_{other}":
                    return quantity, factor, offset
    raise WingdError(
        f"there is no quantity {name!r}; known are {', '.join(known) or 'none: join aircraft data with `wingd aircraft-data`'}"
    )


def parse_conditions(text: str, known: Iterable[str]) -> list[tuple[str, float, float, float, float]]:
    """Return (quantity, unit factor, unit offset, low, high) of each condition; bounds are in the unit that is written.

    The form is ``QUANTITY between A and B``, ``QUANTITY < A`` or ``> A`` (also ``<=``, ``>=``), joined by ``and``.
    """
    number = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?"
    one = re.compile(rf"\s*(\w+)\s*(?:between\s+({number})\s+and\s+({number})|([<>]=?)\s*({number}))\s*(and\b|$)")
    found, at = [], 0
    while True:
        match = one.match(text, at)
        if match is None:
            raise WingdError(
                f"where: {text[at:].strip()!r} is not understood; write `mach between .78 and .80 and weight_kg < 190000`"
            )
        name, low, high, sign, bound, more = match.groups()
        quantity, factor, offset = find_condition(name, known)
        inverse, shift = 1 / factor, -offset / factor
        # Values are compared as (value - shift) / inverse.
        bounds = (
            (float(low), float(high)) if low else (-np.inf, float(bound)) if sign[0] == "<" else (float(bound), np.inf)
        )
        if bounds[0] > bounds[1]:
            raise WingdError(
                f"where: {name} between {low} and {high} holds for no value; give the smaller number first"
            )
        found.append((quantity, inverse, shift, *bounds))
        at = match.end()
        if not more:
            return found
