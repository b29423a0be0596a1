"""Values with covariance: arrays whose errors are factors, keyed by their source.

``value = truth + sum over sources of factor u``, with independent ``u`` of standard deviation 1. Two values share the
errors whose keys are equal: in a difference these cancel by themselves, in a mean they stay.

The packages `gvar` and `uncertainties` were tried first, with 42 stations and 50 sources a frame (2 cores of 2.4 GHz).
gvar: 400 frames take 0.6 s to build, 2.1 s to subtract their mean and 1.1 GB; time and memory grow with the square of
the number of frames (every value lists every source), so 10,000 frames need some 600 GB. uncertainties: 75 ms a frame
to build, 12 min for 10,000 frames. This class keeps a source's factor as one block: see ``docs/python.md`` for its
figures. :meth:`Values.to_gvar`, :meth:`Values.to_uncertainties` and their inverses convert.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
import pandas as pd
import xarray as xr
from scipy.interpolate import make_interp_spline
from scipy.stats import chi2

from wingd import WingdError
from wingd import WingdWarning as WingdWarning

#: Dimensions along which keys may differ, and of the stations.
FRAME, STATION = "frame", "eta"
#: Suffix of the kinds of sources that belong to one value each: what reduced factors do not carry.
REST = "_rest"
#: Kind that marks frames which were adjusted singly: what they share is not known. Its factor has no sources.
SINGLE = "single"
#: Smallest variance of a tested combination, in units of the variance of a single value: below, the family of shapes
#: of the adjustment is no longer exact.
MIN_TESTED_VARIANCE = 1e-3
#: Quantities that describe one motion, the more precise first, and the number of smooth combinations that are tested:
#: of the first that is there, and of the others, which follow from it but for errors of a computation.
FAMILIES = (("displacement_z", "slope"), 3, 1), (("twist", "streamwise_twist"), 2, 1)
#: Number of combinations of other quantities.
COMBINATIONS = 3
#: Largest number of values in a covariance matrix, and largest factor, bytes.
MAX_COVARIANCE, MAX_FACTOR = 20_000, 4 << 30
#: Significance level of a verdict.
ALPHA = 0.01


def digest(*parts: object) -> str:
    """Return a key of 16 hexadecimal digits for `parts`."""
    return hashlib.sha256("\0".join(map(str, parts)).encode()).hexdigest()[:16]


@dataclass(frozen=True)
class Factor:
    """Factor of one kind of sources.

    Attributes
    ----------
    keys
        Keys of the sources: shape (groups,), or (frames, groups) if each frame has its own; "" for no source. Of a
        reduced factor ``KEY#REDUCTION``.
    array
        Shape of the values + (groups, sources); sigma of a value by each source, in the value's unit.
    bases
        Key with reduction -> basis (sources of KEY, reduced sources).
    """

    keys: np.ndarray
    array: np.ndarray
    bases: dict[str, np.ndarray] = field(default_factory=dict)

    @property
    def per_frame(self) -> bool:
        """Whether keys depend on the frame, which is the first dimension of the array."""
        return self.keys.ndim == 2

    def with_array(self, array: np.ndarray) -> Factor:
        """Return the factor of other values of the same sources."""
        return Factor(self.keys, array, self.bases)

    def expanded(self) -> Factor:
        """Return the factor by the sources before the reduction."""
        if not self.bases:
            return self
        width = max(self.array.shape[-1], *(b.shape[0] for b in self.bases.values()))
        out = _pad(self.array, width).copy()
        for key, basis in self.bases.items():
            at = self.keys == key
            if not self.per_frame:
                out[..., at, : basis.shape[0]] = self.array[..., at, : basis.shape[1]] @ basis.T
                continue
            for group in range(at.shape[1]):
                rows = at[:, group]
                out[rows, ..., group, : basis.shape[0]] = self.array[rows, ..., group, : basis.shape[1]] @ basis.T
        keys = np.array([str(key).partition("#")[0] for key in self.keys.ravel()], dtype=object)
        return Factor(keys.reshape(self.keys.shape), out)


def _pad(array: np.ndarray, sources: int) -> np.ndarray:
    lacking = sources - array.shape[-1]
    return np.concatenate([array, np.zeros((*array.shape[:-1], lacking))], axis=-1) if lacking > 0 else array


def _installations(keys: np.ndarray) -> set[str]:
    return {str(key).partition("/")[0] for key in keys.ravel() if key}


def _check_keys(kind: str, one: np.ndarray, other: np.ndarray) -> None:
    """Refuse sums of which it is not known what the errors share."""
    if kind == SINGLE and _installations(one) & _installations(other) and set(one.ravel()) != set(other.ravel()):
        raise WingdError(
            "the errors that the frames share are not known, because they were adjusted singly; run `wingd solve STORE`, "
            "which adjusts the frames of a flight jointly, and read them again"
        )
    if kind == "shared" and not set(one.ravel()) & set(other.ravel()) and _installations(one) & _installations(other):
        raise WingdError("the shapes are of one flight, exported with other stations; export them together")


def _needs_expansion(keys: Iterable[str]) -> bool:
    """Return whether sources of one key were reduced in different ways."""
    reductions: dict[str, str] = {}
    for key in keys:
        source, _, reduction = str(key).partition("#")
        if reductions.setdefault(source, reduction) != reduction:
            return True
    return False


def _merge(kind: str, one: Factor, other: Factor) -> Factor:
    """Return the factor of a sum: blocks of equal keys are added, others placed side by side."""
    _check_keys(kind, one.keys, other.keys)
    if _needs_expansion([*set(one.keys.ravel()), *set(other.keys.ravel())]):
        one, other = one.expanded(), other.expanded()
    bases = {**one.bases, **other.bases}
    sources = max(one.array.shape[-1], other.array.shape[-1])
    a, b = _pad(one.array, sources), _pad(other.array, sources)
    if not one.per_frame and not other.per_frame:
        where = {key: k for k, key in enumerate(one.keys)}
        common = np.array([key in where for key in other.keys], dtype=bool)
        out = np.concatenate([a, b[..., ~common, :]], axis=-2)
        out[..., [where[key] for key in other.keys[common]], :] += b[..., common, :]
        return Factor(np.concatenate([one.keys, other.keys[~common]]), out, bases)
    frames = len(a)
    left, right = (np.broadcast_to(f.keys, (frames, f.keys.shape[-1])) for f in (one, other))
    size = a[..., 0, 0].size * (left.shape[1] + right.shape[1]) * sources * 8
    if size > MAX_FACTOR:
        raise WingdError(
            f"the covariance of {frames} frames with a mean of {max(left.shape[1], right.shape[1])} needs "
            f"{size / 2**30:.0f} GB; select fewer frames, or take the mean of the difference"
        )
    keys, blocks = [left[:, k] for k in range(left.shape[1])], [a[..., k, :] for k in range(left.shape[1])]
    for j in range(right.shape[1]):
        key, block = right[:, j].copy(), b[..., j, :].copy()
        for i in range(left.shape[1]):
            equal = (left[:, i] == key) & (key != "")
            if equal.any():
                blocks[i] = blocks[i].copy()
                blocks[i][equal] += block[equal]
                block[equal], key[equal] = 0.0, ""
        if (key != "").any():
            keys.append(key)
            blocks.append(block)
    return Factor(np.stack(keys, axis=1), np.stack(blocks, axis=-2), bases)


def _sum_frames(factor: Factor) -> Factor:
    """Return the factor of the sum over frames: one group for each key."""
    if not factor.per_frame:
        return factor.with_array(factor.array.sum(axis=0))
    factor = factor.expanded() if _needs_expansion(set(factor.keys.ravel())) else factor
    keys, inverse = np.unique(factor.keys.ravel().astype(str), return_inverse=True)
    blocks = np.moveaxis(factor.array, -2, 1)
    blocks = blocks.reshape(len(inverse), *blocks.shape[2:])
    out = np.zeros((len(keys), *blocks.shape[1:]))
    if len(keys) == len(inverse):
        out[inverse] = blocks
    else:
        np.add.at(out, inverse, blocks)
    known = keys != ""
    return Factor(keys[known].astype(object), np.moveaxis(out[known], 0, -2), factor.bases)


@dataclass(frozen=True, repr=False)
class Values:
    """Array of values with factors of its covariance.

    Attributes
    ----------
    value
        Values with dimensions and coordinates; ``attrs`` has ``units``, ``long_name`` and the facts of the shape.
    factors
        Kind of sources -> factor: ``lasting`` (of the installation: survey, ground frame, lens), ``shared`` (of the
        flight: mounting, temperature, load), ``own`` (of the frame), ``fit`` (of the tie points), and others such as
        ``computation`` or ``instrument``. A kind that ends with ``_rest`` has one source for each place along the
        span: what reduced factors do not carry.
    """

    value: xr.DataArray
    factors: dict[str, Factor] = field(default_factory=dict)

    # --- standard deviations -------------------------------------------------------------------------------------

    @property
    def sigma(self) -> xr.DataArray:
        """Standard deviations, shape and unit of the values; NaN where a value is NaN."""
        variance = np.zeros(self.value.shape)
        for factor in self.factors.values():
            variance += np.einsum("...gs,...gs->...", factor.array, factor.array)
        sigma = np.where(np.isnan(self.value.values), np.nan, np.sqrt(variance))
        return self.value.copy(data=sigma).assign_attrs(long_name=f"standard deviation: {self.label}")

    @property
    def label(self) -> str:
        """Quantity for axes and tables."""
        return str(self.value.attrs.get("long_name", self.value.name or "value"))

    @property
    def unit(self) -> str:
        """Unit of the values, empty for a pure number."""
        return str(self.value.attrs.get("units", ""))

    def vector(self) -> tuple[np.ndarray, dict[tuple[str, str], np.ndarray]]:
        """Return values (n,), and by kind and key the factor (n, sources)."""
        values, blocks = self.value.values.ravel(), {}
        for kind, factor in self.factors.items():
            array = factor.array
            for key in dict.fromkeys(factor.keys.ravel()):
                if not factor.per_frame:
                    block = array[..., int(np.flatnonzero(factor.keys == key)[0]), :]
                else:
                    block = np.zeros((*array.shape[:-2], array.shape[-1]))
                    for k in range(array.shape[-2]):
                        rows = factor.keys[:, k] == key
                        block[rows] += array[rows][..., k, :]
                blocks[kind, key] = block.reshape(values.size, -1)
        return values, blocks

    @property
    def covariance(self) -> np.ndarray:
        """Covariance of all values in row-major order, shape (n, n), square of the unit."""
        if self.value.size > MAX_COVARIANCE:
            raise WingdError(
                f"a covariance of {self.value.size} values does not fit in memory; select stations or frames"
            )
        return _joint([self])[1]

    def __repr__(self) -> str:
        head = f"<wingd.Values {self.label} / {self.unit or '1'}, {dict(self.value.sizes)}; sources "
        head += ", ".join(f"{kind} ({f.array.shape[-2]} x {f.array.shape[-1]})" for kind, f in self.factors.items())
        table = self.to_pandas() if self.value.ndim <= 1 else self.value.values
        return f"{head}>\n{table}"

    def __len__(self) -> int:
        return len(self.value)

    # --- linear operations ----------------------------------------------------------------------------------------

    def mapped(
        self, value: xr.DataArray, linear: Callable[[np.ndarray, int], np.ndarray], rearranges: bool = False
    ) -> Values:
        """Return a linear function of the values.

        Parameters
        ----------
        value
            Result.
        linear
            Applies the function to an array of the values' shape with trailing dimensions, with the weights to a power:
            1, or 2 for the variances of sources that belong to one place.
        rearranges
            The function moves or repeats values and adds none.
        """
        factors = {}
        for kind, factor in self.factors.items():
            adds_places = kind.endswith(REST) and not rearranges
            array = np.sqrt(linear(factor.array**2, 2)) if adds_places else linear(factor.array, 1)
            factors[kind] = factor.with_array(array)
        return Values(value, factors)

    def isel(self, **indexers: Any) -> Values:
        """Select by position along dimensions, as in xarray."""
        out = self
        for dim, index in indexers.items():
            axis = out.value.dims.index(dim)
            index = np.asarray(index) if isinstance(index, list | tuple | np.ndarray) else index
            at = (slice(None),) * axis + (index,)
            factors = {}
            for kind, factor in out.factors.items():
                keys, array = factor.keys, factor.array[at]
                if factor.per_frame and dim == FRAME:
                    keys = keys[index]
                    if keys.ndim == 1:
                        keys, array = keys[keys != ""], array[..., keys != "", :]
                factors[kind] = Factor(keys, array, factor.bases)
            out = Values(out.value.isel({dim: index}), factors)
        return out

    def sel(self, **labels: Any) -> Values:
        """Select by coordinate; `eta` and `arc_length` between stations are interpolated by a cubic spline."""
        out = self
        for name, label in labels.items():
            if name in ("eta", "arc_length"):
                out = out.at(**{name: label})
                continue
            if name not in out.value.coords:
                raise WingdError(f"there is no coordinate {name!r}; known are {', '.join(map(str, out.value.coords))}")
            known = np.atleast_1d(out.value[name].values)
            index = [int(k) for wanted in np.atleast_1d(label) for k in np.flatnonzero(known == wanted)]
            if len(index) < np.size(label):
                raise WingdError(f"there is no {name} {label!r}; known are {', '.join(map(str, known[:40]))}")
            scalar = np.ndim(label) == 0 and len(index) == 1
            out = out.isel(**{str(out.value[name].dims[0]): index[0] if scalar else index})
        return out

    def at(self, eta: Any = None, arc_length: Any = None) -> Values:
        """Return values at other stations, interpolated by a cubic spline along the span.

        Parameters
        ----------
        eta
            Arc lengths over that of the model's tip, a number or several.
        arc_length
            Arc lengths from the bending root, m, instead of `eta`.
        """
        name, wanted = ("eta", eta) if arc_length is None else ("arc_length", arc_length)
        if STATION not in self.value.dims:
            raise WingdError(f"the values have no stations to select by {name}")
        places, new = self.value[name].values, np.asarray(wanted, dtype=float)
        low, high, close = places.min(), places.max(), 1e-6 * places.max()
        outside = new[~((new >= low - close) & (new <= high + close))]
        if outside.size:
            raise WingdError(
                f"{name} {outside[0]:.4g} is not between the stations, {low:.4g} to {high:.4g}; choose others"
            )
        nearest = np.abs(places[:, None] - np.atleast_1d(new)).argmin(axis=0)
        if np.all(np.abs(places[nearest] - np.atleast_1d(new)) <= close):
            return self.isel(eta=int(nearest[0]) if new.ndim == 0 else nearest)
        axis = self.value.dims.index(STATION)
        weights = make_interp_spline(places, np.eye(len(places)), k=min(3, len(places) - 1))(new)
        dims = [d for d in self.value.dims if d != STATION or new.ndim]
        coords = {}
        for coord, of in self.value.coords.items():
            if of.dims == (STATION,) and of.dtype.kind == "f":
                coords[coord] = ((STATION,) if new.ndim else (), weights @ of.values)
            elif STATION not in of.dims:
                coords[coord] = of.variable

        def linear(array: np.ndarray, power: int) -> np.ndarray:
            out = np.tensordot(array, (weights**power).T, axes=(axis, 0))
            return np.moveaxis(out, -1, axis) if new.ndim else out

        value = xr.DataArray(linear(self.value.values, 1), coords, dims, self.value.name, self.value.attrs)
        return self.mapped(value, linear)

    def mean(self, dim: str = FRAME) -> Values:
        """Return the mean along a dimension; common errors stay, others are reduced."""
        axis, count = self.value.dims.index(dim), self.value.sizes[dim]
        if dim != FRAME:
            return self.mapped(self.value.mean(dim, skipna=False), lambda a, power: a.sum(axis=axis) / count**power)
        if axis:
            return self.transpose(FRAME, *(d for d in self.value.dims if d != FRAME)).mean()
        for kind in {SINGLE, "shared"} & set(self.factors):
            _check_frames(kind, self.factors[kind].keys)
        value = self.value.mean(FRAME, skipna=False, keep_attrs=True)
        summed = {kind: _sum_frames(factor) for kind, factor in self.factors.items()}
        return Values(value, {kind: f.with_array(f.array / count) for kind, f in summed.items()})

    def broadcast(self, dims: Sequence[str], like: Values) -> Values:
        """Return the values repeated along the dimensions of `like` that they lack, in the order `dims`."""
        if list(self.value.dims) == list(dims):
            return self
        missing = [d for d in dims if d not in self.value.dims]
        values = self.transpose(*(d for d in dims if d in self.value.dims))
        axes, n = [dims.index(d) for d in missing], values.value.ndim
        shape = tuple(values.value.sizes.get(d, like.value.sizes.get(d)) for d in dims)

        def expand(array: np.ndarray, _: int) -> np.ndarray:
            return np.broadcast_to(np.expand_dims(array, axes), shape + array.shape[n:])

        coords = {k: v.variable for k, v in like.value.coords.items() if set(v.dims) <= set(dims)}
        coords |= {k: v.variable for k, v in values.value.coords.items()}
        value = xr.DataArray(expand(values.value.values, 1), coords, dims, values.value.name, values.value.attrs)
        return values.mapped(value, expand, rearranges=True)

    def transpose(self, *dims: str) -> Values:
        """Return the values with other order of dimensions."""
        order = [self.value.dims.index(d) for d in dims]

        def turn(array: np.ndarray, _: int) -> np.ndarray:
            return array.transpose(*order, len(order), len(order) + 1)

        return self.mapped(self.value.transpose(*dims), turn, rearranges=True)

    def scaled(self, by: Any) -> Values:
        """Return the values times numbers without error: a number, or an array that broadcasts to the values."""
        by = np.broadcast_to(np.asarray(by, dtype=float), self.value.shape)
        value = self.value.copy(data=self.value.values * by)
        return Values(value, {k: f.with_array(f.array * by[..., None, None]) for k, f in self.factors.items()})

    def _combine(self, other: Any, sign: float) -> Values:
        if not isinstance(other, Values):
            data = self.value.values + sign * np.asarray(getattr(other, "values", other))
            return Values(self.value.copy(data=np.broadcast_to(data, self.value.shape)), self.factors)
        one, two = _align(self, other)
        data = one.value.values + sign * two.value.values
        factors = dict(one.factors)
        for kind, factor in two.factors.items():
            signed = factor.with_array(sign * factor.array)
            factors[kind] = _merge(kind, factors[kind], signed) if kind in factors else signed
        for a, b in ((one, two), (two, one)):
            if SINGLE in a.factors and SINGLE not in b.factors and "lasting" in b.factors:
                _check_keys(SINGLE, a.factors[SINGLE].keys, b.factors["lasting"].keys)
        return Values(one.value.copy(data=data), factors)

    def __add__(self, other: Any) -> Values:
        return self._combine(other, 1.0)

    def __sub__(self, other: Any) -> Values:
        return self._combine(other, -1.0)

    def __mul__(self, by: Any) -> Values:
        return self.scaled(by)

    def __truediv__(self, by: Any) -> Values:
        return self.scaled(1.0 / np.asarray(by, dtype=float))

    def __neg__(self) -> Values:
        return self.scaled(-1.0)

    __radd__, __rmul__ = __add__, __mul__

    def __rsub__(self, other: Any) -> Values:
        return (-self) + other

    def with_source(self, kind: str, key: str, array: np.ndarray) -> Values:
        """Return the values with an additional source of errors.

        Parameters
        ----------
        kind, key
            Kind and key of the source; errors of equal keys are common.
        array
            Shape of the values, or + (sources,); in their unit.
        """
        array = np.asarray(array, dtype=float)
        array = array[..., None] if array.shape == self.value.shape else array
        new = Factor(np.array([key], dtype=object), array[..., None, :])
        return Values(
            self.value, {**self.factors, kind: _merge(kind, self.factors[kind], new) if kind in self.factors else new}
        )

    def at_other_place(self, name: str) -> Values:
        """Return the values with sources of single places renamed: those of this place are no other place's."""
        factors = {}
        for kind, factor in self.factors.items():
            keys = factor.keys
            if kind.endswith(REST):
                keys = np.array([f"{k}@{name}" if k else "" for k in keys.ravel()], dtype=object).reshape(keys.shape)
            factors[kind] = Factor(keys, factor.array, factor.bases)
        return Values(self.value, factors)

    # --- test, output, other packages -----------------------------------------------------------------------------

    def test(self, *others: Values, full: bool = False) -> Test:
        """Test whether these values, and `others` with them, are 0; see :func:`chi_square_test`."""
        return chi_square_test([self, *others], full)

    def plot(self, ax: Any = None, **style: Any) -> Any:
        """Draw the values along the span or over frames, with a band of one standard deviation; returns the axes."""
        from wingd import plot

        return plot.draw_values(self, ax=ax, **style)

    def to_pandas(self) -> pd.DataFrame:
        """Return a table with the coordinates, the values and their sigma; columns carry the unit."""
        name = "_".join(filter(None, [str(self.value.name or "value"), self.unit.replace(" ", "_")]))
        columns = {name: self.value.values, f"sigma_{name}": self.sigma.values}
        if self.value.ndim == 0:
            return pd.DataFrame({k: [float(v)] for k, v in columns.items()})
        frame = xr.Dataset({k: (self.value.dims, v) for k, v in columns.items()}, self.value.coords)
        return frame.to_dataframe().reset_index()

    def to_gvar(self) -> np.ndarray:
        """Return an array of correlated `gvar.GVar`, shape of the values."""
        import gvar

        return gvar.gvar(self.value.values.ravel(), self.covariance).reshape(self.value.shape)

    def to_uncertainties(self) -> np.ndarray:
        """Return an array of correlated numbers of `uncertainties`, shape of the values."""
        from uncertainties import correlated_values

        numbers = correlated_values(self.value.values.ravel(), self.covariance)
        return np.array(numbers, dtype=object).reshape(self.value.shape)

    @staticmethod
    def from_correlated(numbers: Any, like: xr.DataArray, key: str | None = None) -> Values:
        """Return values from an array of `gvar` or `uncertainties`, with dimensions and coordinates of `like`.

        Their errors become one source with a key of its own; correlation with the values that they came from is lost.
        """
        numbers = np.asarray(numbers, dtype=object)
        if hasattr(numbers.flat[0], "sdev"):
            import gvar

            mean, covariance = gvar.mean(numbers), gvar.evalcov(numbers.ravel())
        else:
            from uncertainties import covariance_matrix, unumpy

            mean, covariance = unumpy.nominal_values(numbers), np.array(covariance_matrix(list(numbers.ravel())))
        return Values.from_covariance(like.copy(data=np.asarray(mean, dtype=float)), covariance, "other", key)

    @staticmethod
    def from_covariance(value: xr.DataArray, covariance: np.ndarray, kind: str, key: str | None = None) -> Values:
        """Return values with a covariance, shape (n, n), as one source; a new key if none is given."""
        eigenvalues, vectors = np.linalg.eigh(np.asarray(covariance, dtype=float))
        factor = vectors * np.sqrt(eigenvalues.clip(0.0))
        key = digest(kind, value.values.tobytes(), factor.tobytes()) if key is None else key
        return Values(value).with_source(kind, key, factor.reshape(*value.shape, -1))


def _check_frames(kind: str, keys: np.ndarray) -> None:
    """Refuse the mean of frames of which it is not known what the errors share."""
    one: dict[str, str] = {}
    for key in dict.fromkeys(keys.ravel()):
        for installation in _installations(np.array([key])):
            if one.setdefault(installation, key) != key:
                _check_keys(kind, np.array([one[installation]]), np.array([key]))


def _align(one: Values, two: Values) -> tuple[Values, Values]:
    """Bring two values to the same dimensions and stations; see :func:`wingd.shapes.match_stations`."""
    if STATION in one.value.dims and STATION in two.value.dims:
        from wingd.shapes import match_stations

        one, two = match_stations(one, two)
    for dim in set(one.value.dims) & set(two.value.dims):
        counts = [v.value.sizes[dim] for v in (one, two)]
        if counts[0] != counts[1]:
            raise WingdError(
                f"the values have {counts[0]} and {counts[1]} along {dim}; select one of them, or take a mean"
            )
        a, b = (v.value.coords[dim] if dim in v.value.coords else None for v in (one, two))
        if a is not None and b is not None and a.dtype.kind in "OU" and not np.array_equal(a.values, b.values):
            raise WingdError(f"the values have other names along {dim}; select those that both have")
    dims = [*one.value.dims, *(d for d in two.value.dims if d not in one.value.dims)]
    dims.sort(key=lambda d: d != FRAME)
    return one.broadcast(dims, two), two.broadcast(dims, one)


def concat(parts: Sequence[Values]) -> Values:
    """Join values along frames; keys stay, so that what frames share remains known."""
    frames = []
    for p in parts:
        p = p if FRAME in p.value.dims else p.broadcast([FRAME, *p.value.dims], Values(p.value.expand_dims({FRAME: 1})))
        frames.append(p.transpose(FRAME, *(d for d in p.value.dims if d != FRAME)))
    factors = {}
    for kind in dict.fromkeys(kind for p in frames for kind in p.factors):
        known = [p.factors.get(kind) for p in frames]
        if _needs_expansion(k for f in known if f for k in set(f.keys.ravel())):
            known = [f and f.expanded() for f in known]
        groups, sources = (max(f.array.shape[k] for f in known if f) for k in (-2, -1))
        keys = np.full((sum(len(p) for p in frames), groups), "", dtype=object)
        array = np.zeros((len(keys), *frames[0].value.shape[1:], groups, sources))
        at, bases = 0, {}
        for p, f in zip(frames, known, strict=True):
            if f:
                keys[at : at + len(p), : f.keys.shape[-1]] = f.keys
                array[at : at + len(p), ..., : f.array.shape[-2], : f.array.shape[-1]] = f.array
                bases |= f.bases
            at += len(p)
        factors[kind] = Factor(keys, array, bases)
    value = xr.concat(
        [p.value for p in frames], FRAME, coords="minimal", compat="override", combine_attrs="drop_conflicts"
    )
    return Values(value, factors)


# --- test ---------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, repr=False)
class Test:
    """Result of a chi-square test that values are 0.

    Attributes
    ----------
    chi_square, freedom, p
        Sum of squares of the tested combinations over their sigmas, their number, and the probability of a sum at least
        as large without a difference.
    values, sigma, names, places, units
        Tested values with their sigmas, quantities, arc lengths (m), and the units of the quantities.
    sizes, weights
        Tested combinations over their sigmas, and the weights of values over sigma in them (values x combinations).
    """

    chi_square: float
    freedom: int
    p: float
    values: np.ndarray
    sigma: np.ndarray
    names: np.ndarray
    places: np.ndarray
    units: dict[str, str]
    sizes: np.ndarray
    weights: np.ndarray

    __test__ = False

    @cached_property
    def combinations(self) -> pd.DataFrame:
        """Table of the combinations, the largest first: ``sigmas``, ``quantity``, ``from_m``, ``to_m`` (most of it)."""
        scaled = self.values / self.sigma
        rows = []
        for k in np.argsort(-np.abs(self.sizes)):
            parts = np.abs(self.weights[:, k] * scaled)
            sums = {name: parts[self.names == name].sum() for name in dict.fromkeys(self.names)}
            name = max(sums, key=sums.get)
            of = np.flatnonzero(self.names == name)
            large = self.places[of[parts[of] >= 0.5 * parts[of].max()]]
            rows.append((abs(self.sizes[k]), name, float(large.min()), float(large.max())))
        return pd.DataFrame(rows, columns=["sigmas", "quantity", "from_m", "to_m"])

    @cached_property
    def bands(self) -> pd.DataFrame:
        """Table of the stretches in which a value exceeds two sigmas: ``quantity``, ``unit``, ``from_m``, ``to_m``, ``largest``, ``sigma_largest``."""
        rows = []
        for name in dict.fromkeys(self.names):
            of = np.flatnonzero(self.names == name)
            of = of[np.argsort(self.places[of], kind="stable")]
            beyond = np.abs(self.values[of]) > 2 * self.sigma[of]
            edges = np.flatnonzero(np.diff(np.concatenate([[False], beyond, [False]]).astype(int)))
            unit, to = ("deg", 180 / np.pi) if self.units[name] == "rad" else (self.units[name], 1.0)
            for start, end in zip(edges[::2], edges[1::2], strict=True):
                stretch = of[start:end]
                top = stretch[np.abs(self.values[stretch]).argmax()]
                rows.append((name, unit, *self.places[stretch[[0, -1]]], self.values[top] * to, self.sigma[top] * to))
        return pd.DataFrame(rows, columns=["quantity", "unit", "from_m", "to_m", "largest", "sigma_largest"])

    @property
    def significant(self) -> bool:
        """Whether the test rejects at 1 %."""
        return self.p < ALPHA

    def __repr__(self) -> str:
        verdict = "significant difference" if self.significant else "no significant difference"
        lines = [f"chi-square {self.chi_square:.1f} of {self.freedom} combinations, p = {self.p:.3g}: {verdict} at 1 %"]
        for band in self.bands.itertuples():
            place = f"{band.from_m:.2f} to {band.to_m:.2f} m" if band.to_m > band.from_m else f"{band.from_m:.2f} m"
            lines.append(
                f"  {band.quantity} differs by more than 2 sigma at {place}: up to {band.largest:.4g} "
                f"± {band.sigma_largest:.2g} {band.unit}"
            )
        if self.significant and self.bands.empty:
            lines.append("  no station differs by 2 sigma alone: the difference is in the shape along the span")
        return "\n".join(lines)


def _joint(parts: Sequence[Values]) -> tuple[np.ndarray, np.ndarray]:
    """Return the values of several arrays one after the other, and their joint covariance."""
    reduced = {(kind, key) for p in parts for kind, f in p.factors.items() for key in set(f.keys.ravel())}
    mixed = {k for k in {k for k, _ in reduced} if _needs_expansion(key for kind, key in reduced if kind == k)}
    parts = [Values(p.value, {k: f.expanded() if k in mixed else f for k, f in p.factors.items()}) for p in parts]
    vectors = [p.vector() for p in parts]
    sizes = np.cumsum([0, *(len(values) for values, _ in vectors)])
    covariance = np.zeros((sizes[-1], sizes[-1]))
    alone: list[list[np.ndarray]] = [[] for _ in vectors]
    for source in dict.fromkeys(s for _, blocks in vectors for s in blocks):
        found = [(k, blocks[source]) for k, (_, blocks) in enumerate(vectors) if source in blocks]
        if len(found) == 1 and not source[0].endswith(REST):
            alone[found[0][0]].append(found[0][1])
            continue
        joined = np.zeros((sizes[-1], max(block.shape[1] for _, block in found)))
        for k, block in found:
            joined[sizes[k] : sizes[k + 1], : block.shape[1]] = block
        if source[0].endswith(REST):
            covariance[np.diag_indices_from(covariance)] += (joined**2).sum(axis=1)
        else:
            covariance += joined @ joined.T
    for k, blocks in enumerate(alone):
        if blocks:
            at = slice(sizes[k], sizes[k + 1])
            stacked = np.hstack(blocks)
            covariance[at, at] += stacked @ stacked.T
    return np.concatenate([values for values, _ in vectors]), covariance


def _places(part: Values) -> np.ndarray:
    """Return a coordinate of each value along the span, m, or its number."""
    for name in ("arc_length", "marker_arc_length"):
        if name in part.value.coords:
            return (
                np.broadcast_to(part.value[name], part.value.shape).ravel()
                if part.value.ndim
                else np.atleast_1d(part.value[name])
            )
    return np.arange(part.value.size, dtype=float)


def chi_square_test(parts: Iterable[Values], full: bool = False) -> Test:
    """Test whether values are 0, in the few combinations that a measurement determines.

    Errors of neighbouring stations are almost equal, so that 32 stations are not 32 measurements, and slope follows
    from displacement. Each quantity is tested in a few smooth combinations along the span (Legendre polynomials of value
    over sigma; `FAMILIES` has their number). Combinations whose variance is below 0.001 of that of a value are omitted.

    Parameters
    ----------
    parts
        Values of quantities along the span, without frames; NaN are omitted.
    full
        Test every combination of the single values: less is found, because chi-square has more degrees of freedom.
    """
    parts = [p for p in parts if np.isfinite(p.value.values).any()]
    if any(FRAME in p.value.dims for p in parts):
        raise WingdError("the test is of one shape; select a frame or take the mean of the frames")
    if not parts:
        empty = np.zeros(0)
        return Test(0.0, 0, 1.0, empty, empty, empty, empty, {}, empty, np.zeros((0, 0)))
    values, covariance = _joint(parts)
    sigma = np.sqrt(np.diag(covariance))
    rows = {
        "names": np.repeat([str(p.value.name) for p in parts], [p.value.size for p in parts]),
        "places": np.concatenate([_places(p) for p in parts]),
    }
    known = np.isfinite(values) & (sigma > 0)
    values, covariance, sigma = values[known], covariance[np.ix_(known, known)], sigma[known]
    names, places = (array[known] for array in rows.values())
    basis = np.eye(len(values)) if full else _smooth_basis(names, places)
    scaled = values / sigma
    eigenvalues, vectors = np.linalg.eigh(basis.T @ (covariance / np.outer(sigma, sigma)) @ basis)
    tested = eigenvalues > MIN_TESTED_VARIANCE
    weights = basis @ vectors[:, tested]
    sizes = weights.T @ scaled / np.sqrt(eigenvalues[tested])
    chi_square, freedom = float(sizes @ sizes), int(tested.sum())
    units = {str(p.value.name): p.unit for p in parts}
    p = float(chi2.sf(chi_square, freedom)) if freedom else 1.0
    return Test(chi_square, freedom, p, values, sigma, names, places, units, sizes, weights)


def _smooth_basis(names: np.ndarray, places: np.ndarray) -> np.ndarray:
    """Return orthonormal columns: polynomials along the span, for each quantity."""
    counts = dict.fromkeys(names, COMBINATIONS)
    for family, first, others in FAMILIES:
        present = [name for name in family if name in counts]
        counts |= {name: others if k else first for k, name in enumerate(present)}
    columns = []
    for name, count in counts.items():
        rows = np.flatnonzero(names == name)
        at = places[rows] - places[rows].min()
        degree = min(count, len(np.unique(at))) - 1
        block = np.zeros((len(names), degree + 1))
        block[rows] = np.linalg.qr(np.polynomial.legendre.legvander(2 * at / (at.max() or 1.0) - 1, degree))[0]
        columns.append(block)
    return np.hstack(columns)
