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
from typing import Any

import numpy as np
import pandas as pd
import xarray as xr
from scipy.interpolate import make_interp_spline
from scipy.stats import chi2

from wingd import WingdError

#: Dimension along which keys may differ: frames.
FRAME = "frame"
#: Dimensions of a factor after those of its values: sources with different keys, and the sources of a key.
GROUP, SOURCE = "_group", "_source"
#: Kind of the errors of frames that were adjusted singly: what they share is not known.
SINGLE = "single"
#: Smallest variance of a tested combination, in units of the variance of a single value: below, the family of shapes
#: of the adjustment is no longer exact.
MIN_TESTED_VARIANCE = 1e-3
#: Smooth combinations of each quantity that are tested: Legendre polynomials along the span of value over sigma.
COMBINATIONS = 4
#: Largest number of values in a covariance matrix, and largest factor, bytes.
MAX_COVARIANCE, MAX_FACTOR = 20_000, 4 << 30
#: Significance level of a verdict.
ALPHA = 0.01


class WingdWarning(UserWarning):
    """A fact that changes how a result is to be read."""


def digest(*parts: object) -> str:
    """Return a key of 16 hexadecimal digits for `parts`."""
    return hashlib.sha256("\0".join(map(str, parts)).encode()).hexdigest()[:16]


@dataclass(frozen=True)
class Factor:
    """Factor of one kind of sources.

    Attributes
    ----------
    keys
        Keys of the sources: shape (groups,), or (frames, groups) if each frame has its own.
    array
        Shape of the values + (groups, sources); sigma of a value by each source, in the value's unit.
    """

    keys: np.ndarray
    array: np.ndarray

    @property
    def per_frame(self) -> bool:
        """Whether keys depend on the frame, which is the first dimension of the array."""
        return self.keys.ndim == 2

    def with_array(self, array: np.ndarray) -> Factor:
        """Return the factor of other values of the same sources."""
        return Factor(self.keys, array)


def _pad(array: np.ndarray, sources: int) -> np.ndarray:
    lacking = sources - array.shape[-1]
    return np.concatenate([array, np.zeros((*array.shape[:-1], lacking))], axis=-1) if lacking else array


def _check_single(one: np.ndarray, other: np.ndarray) -> None:
    """Refuse to combine frames of one installation that were adjusted singly."""
    split = [dict.fromkeys(k.partition("/")[0] for k in keys.ravel()) for keys in (one, other)]
    if any(k in split[1] for k in split[0]) and set(one.ravel()) != set(other.ravel()):
        raise WingdError(
            "the errors that the frames share are not known, because they were adjusted singly; "
            "run `wingd solve STORE --flight` and export again"
        )


def _merge(kind: str, one: Factor, other: Factor) -> Factor:
    """Return the factor of a sum: blocks of equal keys are added, others placed side by side."""
    if kind == SINGLE:
        _check_single(one.keys, other.keys)
    sources = max(one.array.shape[-1], other.array.shape[-1])
    a, b = _pad(one.array, sources), _pad(other.array, sources)
    if not one.per_frame and not other.per_frame:
        where = {key: k for k, key in enumerate(one.keys)}
        common = np.array([key in where for key in other.keys], dtype=bool)
        out = np.concatenate([a, b[..., ~common, :]], axis=-2) if not common.all() else a.copy()
        out[..., [where[key] for key in other.keys[common]], :] += b[..., common, :]
        return Factor(np.concatenate([one.keys, other.keys[~common]]), out)
    frames = len(a)
    left, right = (np.broadcast_to(f.keys, (frames, f.keys.shape[-1])) for f in (one, other))
    size = frames * np.prod(a.shape[1:-2], dtype=float) * (left.shape[1] + right.shape[1]) * sources * 8
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
    return Factor(np.stack(keys, axis=1), np.stack(blocks, axis=-2))


def _sum_frames(factor: Factor) -> Factor:
    """Return the factor of the sum over frames: one group for each key."""
    if not factor.per_frame:
        return factor.with_array(factor.array.sum(axis=0))
    keys, inverse = np.unique(factor.keys.ravel(), return_inverse=True)
    blocks = np.moveaxis(factor.array, -2, 1).reshape(-1, *factor.array.shape[1:-2], factor.array.shape[-1])
    if len(keys) == len(inverse):
        out = np.empty_like(blocks)
        out[inverse] = blocks
    else:
        out = np.zeros((len(keys), *blocks.shape[1:]))
        np.add.at(out, inverse, blocks)
    known = keys != ""
    return Factor(keys[known], np.moveaxis(out[known], 0, -2))


@dataclass(frozen=True)
class Values:
    """Array of values with factors of its covariance.

    Attributes
    ----------
    value
        Values with dimensions and coordinates; ``attrs`` has ``units``, ``long_name`` and the facts of the shape.
    factors
        Kind of sources -> factor: ``installation`` (survey, ground frame, lens), ``flight`` (mounting, temperature,
        load), ``frame``, ``tie`` (tie points), and others such as ``computation`` or ``instrument``.
    rest
        Variance of each value without correlation, such as the part that reduced factors lack; None for 0.
    """

    value: xr.DataArray
    factors: dict[str, Factor] = field(default_factory=dict)
    rest: np.ndarray | None = None

    # --- standard deviations -------------------------------------------------------------------------------------

    @property
    def sigma(self) -> xr.DataArray:
        """Standard deviations, shape and unit of the values; NaN where a value is NaN."""
        variance = np.zeros(self.value.shape) if self.rest is None else self.rest.copy()
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

    def vector(self) -> tuple[np.ndarray, dict[tuple[str, str], np.ndarray], np.ndarray]:
        """Return values (n,), blocks of their factor by kind and key (n, sources), and uncorrelated variances (n,)."""
        values, blocks = self.value.values.ravel(), {}
        for kind, factor in self.factors.items():
            array = factor.array
            if not factor.per_frame:
                for k, key in enumerate(factor.keys):
                    blocks[kind, key] = array[..., k, :].reshape(values.size, -1)
                continue
            for key in np.unique(factor.keys):
                out = np.zeros((*array.shape[:-2], array.shape[-1]))
                for k in range(array.shape[-2]):
                    rows = factor.keys[:, k] == key
                    out[rows] += array[rows][..., k, :]
                blocks[kind, key] = out.reshape(values.size, -1)
        rest = np.zeros(values.size) if self.rest is None else self.rest.ravel()
        return values, blocks, rest

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

    def _map(
        self, value: xr.DataArray, map_array: Callable[[np.ndarray], np.ndarray], rest: np.ndarray | None
    ) -> Values:
        factors = {}
        for kind, factor in self.factors.items():
            factors[kind] = factor.with_array(map_array(factor.array))
        return Values(value, factors, rest)

    def isel(self, **indexers: Any) -> Values:
        """Select by position along dimensions, as in xarray."""
        value, out = self.value.isel(indexers), self
        for dim, index in indexers.items():
            out = out._take(dim, index)
        return Values(value, out.factors, out.rest)

    def _take(self, dim: str, index: Any) -> Values:
        axis = self.value.dims.index(dim)
        at = (slice(None),) * axis + (np.asarray(index) if isinstance(index, list | tuple | np.ndarray) else index,)
        factors = {}
        for kind, factor in self.factors.items():
            keys = factor.keys[at[-1]] if factor.per_frame and dim == FRAME else factor.keys
            factors[kind] = Factor(keys, factor.array[at])
        return Values(self.value.isel({dim: index}), factors, None if self.rest is None else self.rest[at])

    def sel(self, **labels: Any) -> Values:
        """Select by coordinate; `eta` and `arc_length` between stations are interpolated by a cubic spline."""
        out = self
        for name, label in labels.items():
            if name in ("eta", "arc_length"):
                out = out.at(**{name: label})
                continue
            dim = self.value[name].dims[0] if name in self.value.coords else name
            known = out.value[name].values
            index = [int(k) for wanted in np.atleast_1d(label) for k in np.flatnonzero(known == wanted)]
            if not isinstance(label, slice) and len(index) < np.size(label):
                raise WingdError(f"there is no {name} {label!r}; known are {', '.join(map(str, known[:40]))}")
            out = out.isel(**{dim: index[0] if np.ndim(label) == 0 and len(index) == 1 else index})
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
        places, new = self.value[name].values, np.asarray(wanted, dtype=float)
        low, high, close = places.min(), places.max(), 1e-6 * places.max()
        if np.any((new < low - close) | (new > high + close)) or np.isnan(new).any():
            raise WingdError(f"{name} {wanted} is not between the stations, {low:.4g} to {high:.4g}; choose others")
        nearest = np.abs(places[:, None] - np.atleast_1d(new)).argmin(axis=0)
        if np.all(np.abs(places[nearest] - np.atleast_1d(new)) <= close):
            return self.isel(station=int(nearest[0]) if new.ndim == 0 else nearest)
        axis, order = self.value.dims.index("station"), min(3, len(places) - 1)
        weights = make_interp_spline(places, np.eye(len(places)), k=order)(new)
        coords = {}
        for coord, of in self.value.coords.items():
            if of.dims == ("station",) and of.dtype.kind == "f":
                coords[coord] = (("station",) if new.ndim else (), weights @ of.values)
            elif "station" not in of.dims:
                coords[coord] = of

        def apply(array: np.ndarray) -> np.ndarray:
            out = np.tensordot(array, weights.T, axes=(axis, 0))
            return np.moveaxis(out, -1, axis) if new.ndim else out

        dims = [d for d in self.value.dims if d != "station" or new.ndim]
        value = xr.DataArray(apply(self.value.values), coords, dims, self.value.name, self.value.attrs)
        if self.rest is None:
            return self._map(value, apply, None)
        squared = np.moveaxis(
            np.tensordot(self.rest, weights.T**2, axes=(axis, 0)), -1 if new.ndim else 0, axis if new.ndim else 0
        )
        return self._map(value, apply, squared)

    def mean(self, dim: str = FRAME) -> Values:
        """Return the mean along a dimension; common errors stay, others are reduced."""
        axis, count = self.value.dims.index(dim), self.value.sizes[dim]
        value = self.value.mean(dim, skipna=False, keep_attrs=True)
        rest = None if self.rest is None else self.rest.sum(axis=axis) / count**2
        if dim != FRAME:
            return self._map(value, lambda array: array.mean(axis=axis), rest)
        if SINGLE in self.factors and len(np.unique(self.factors[SINGLE].keys)) > 1:
            _check_single(self.factors[SINGLE].keys[:1], self.factors[SINGLE].keys[1:])
        moved = self if axis == 0 else self.transpose(FRAME, *(d for d in self.value.dims if d != FRAME))
        summed = {kind: _sum_frames(factor) for kind, factor in moved.factors.items()}
        return Values(value, {kind: f.with_array(f.array / count) for kind, f in summed.items()}, rest)

    def transpose(self, *dims: str) -> Values:
        """Return the values with other order of dimensions."""
        order = [self.value.dims.index(d) for d in dims]
        rest = None if self.rest is None else self.rest.transpose(order)
        n = len(order)
        return self._map(self.value.transpose(*dims), lambda a: a.transpose(*order, n, n + 1), rest)

    def scaled(self, by: Any) -> Values:
        """Return the values times numbers without error (a number, or an array that broadcasts to the values)."""
        by = np.broadcast_to(np.asarray(by, dtype=float), self.value.shape)
        rest = None if self.rest is None else self.rest * by**2
        return self._map(self.value.copy(data=self.value.values * by), lambda a: a * by[..., None, None], rest)

    def _combine(self, other: Any, sign: float) -> Values:
        if not isinstance(other, Values):
            data = self.value.values + sign * np.asarray(getattr(other, "values", other))
            return Values(self.value.copy(data=data), self.factors, self.rest)
        one, two = _align(self, other)
        data = one.value.values + sign * two.value.values
        factors = dict(one.factors)
        for kind, factor in two.factors.items():
            signed = factor.with_array(sign * factor.array)
            factors[kind] = _merge(kind, factors[kind], signed) if kind in factors else signed
        for kind in {SINGLE, "installation"} & set(factors):
            _check_mixture(kind, one, two)
        rest = one.rest if two.rest is None else two.rest + (0.0 if one.rest is None else one.rest)
        return Values(one.value.copy(data=data), factors, rest)

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
            self.value,
            {**self.factors, kind: _merge(kind, self.factors[kind], new) if kind in self.factors else new},
            self.rest,
        )

    # --- test, output, other packages -----------------------------------------------------------------------------

    def test(self, *others: Values, combinations: int = COMBINATIONS) -> Test:
        """Test whether these values, and `others` with them, are 0; see :func:`chi_square_test`."""
        return chi_square_test([self, *others], combinations)

    def plot(self, ax: Any = None, **style: Any) -> Any:
        """Draw the values along the span or over frames, with a band of one standard deviation; returns the axes."""
        from wingd import plot

        return plot.draw_values(self, ax=ax, **style)

    def to_pandas(self) -> pd.DataFrame:
        """Return a table with the coordinates, the values and their sigma; columns carry the unit."""
        name = str(self.value.name or "value")
        suffix = f"_{self.unit.replace('rad', 'rad').replace(' ', '_')}" if self.unit else ""
        flat = xr.Dataset({f"{name}{suffix}": self.value, f"sigma_{name}{suffix}": self.sigma})
        return (
            flat.to_dataframe().reset_index(drop=self.value.ndim == 0)
            if self.value.ndim
            else pd.DataFrame({k: [float(v)] for k, v in flat.data_vars.items()})
        )

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


def _check_mixture(kind: str, one: Values, two: Values) -> None:
    """Refuse frames adjusted singly with frames of the same installation adjusted jointly."""
    if SINGLE not in one.factors and SINGLE not in two.factors:
        return
    for a, b in ((one, two), (two, one)):
        if SINGLE in a.factors and "installation" in b.factors:
            known = {k.partition("/")[0] for k in a.factors[SINGLE].keys.ravel()}
            if known & {k.partition("/")[0] for k in b.factors["installation"].keys.ravel()}:
                _check_single(a.factors[SINGLE].keys, np.array([f"{next(iter(known))}/joint"]))


def _align(one: Values, two: Values) -> tuple[Values, Values]:
    """Bring two values to the same dimensions and stations; see :func:`wingd.shapes.match_stations`."""
    if "station" in one.value.dims and "station" in two.value.dims:
        from wingd.shapes import match_stations

        one, two = match_stations(one, two)
    for dim in set(one.value.dims) & set(two.value.dims):
        if one.value.sizes[dim] != two.value.sizes[dim]:
            raise WingdError(
                f"the values have {one.value.sizes[dim]} and {two.value.sizes[dim]} along {dim}; select one of them, or take a mean"
            )
        a, b = (v.value.coords.get(dim) for v in (one, two))
        if a is not None and b is not None and a.dtype.kind in "OU" and not np.array_equal(a, b):
            raise WingdError(f"the values have other names along {dim}; select those that both have")
    dims = [*one.value.dims, *(d for d in two.value.dims if d not in one.value.dims)]
    dims.sort(key=lambda d: d != FRAME)
    return _expand(one, dims, two), _expand(two, dims, one)


def _expand(values: Values, dims: list[str], like: Values) -> Values:
    if list(values.value.dims) == dims:
        return values
    missing = [d for d in dims if d not in values.value.dims]
    values = values.transpose(*(d for d in dims if d in values.value.dims))
    axes = [dims.index(d) for d in missing]
    shape = tuple(values.value.sizes.get(d, like.value.sizes.get(d)) for d in dims)

    def expand(array: np.ndarray) -> np.ndarray:
        return np.broadcast_to(np.expand_dims(array, axes), shape + array.shape[len(values.value.dims) :])

    coords = {**{k: v for k, v in like.value.coords.items() if set(v.dims) <= set(dims)}, **values.value.coords}
    value = xr.DataArray(expand(values.value.values), coords, dims, values.value.name, values.value.attrs)
    return values._map(value, expand, None if values.rest is None else expand(values.rest))


def concat(parts: Sequence[Values]) -> Values:
    """Join values along frames; keys stay, so that what frames share remains known."""
    frames = [p if FRAME in p.value.dims else _expand(p, [FRAME, *p.value.dims], _one_frame(p)) for p in parts]
    frames = [p.transpose(FRAME, *(d for d in p.value.dims if d != FRAME)) for p in frames]
    factors = {}
    for kind in dict.fromkeys(kind for p in frames for kind in p.factors):
        known = [p.factors[kind] for p in frames if kind in p.factors]
        groups, sources = (max(f.array.shape[k] for f in known) for k in (-2, -1))
        keys = np.full((sum(len(p) for p in frames), groups), "", dtype=object)
        array = np.zeros((len(keys), *frames[0].value.shape[1:], groups, sources))
        at = 0
        for p in frames:
            if kind in p.factors:
                f = p.factors[kind]
                keys[at : at + len(p), : f.keys.shape[-1]] = f.keys
                array[at : at + len(p), ..., : f.array.shape[-2], : f.array.shape[-1]] = f.array
            at += len(p)
        factors[kind] = Factor(keys, array)
    rests = None
    if any(p.rest is not None for p in frames):
        rests = np.concatenate([np.zeros(p.value.shape) if p.rest is None else p.rest for p in frames])
    value = xr.concat(
        [p.value for p in frames], FRAME, coords="minimal", compat="override", combine_attrs="drop_conflicts"
    )
    return Values(value, factors, rests)


def _one_frame(part: Values) -> Values:
    return Values(part.value.expand_dims({FRAME: 1}))


# --- test ---------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Test:
    """Result of a chi-square test that values are 0.

    Attributes
    ----------
    chi_square, freedom, p
        Sum of squares of the tested combinations over their sigmas, their number, and the probability of a sum at least
        as large without a difference.
    combinations
        Table: ``sigmas`` (combination over its sigma), ``quantity``, ``from_m`` and ``to_m`` (where most of it is), the
        largest first.
    bands
        Table of stretches of the span in which a value exceeds two sigmas: ``quantity``, ``unit``, ``from_m``, ``to_m``,
        ``largest``, ``sigma_largest``.
    """

    chi_square: float
    freedom: int
    p: float
    combinations: pd.DataFrame
    bands: pd.DataFrame

    __test__ = False

    @property
    def significant(self) -> bool:
        """Whether the test rejects at 1 %."""
        return self.p < ALPHA

    def __str__(self) -> str:
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
    vectors = [p.vector() for p in parts]
    sizes = np.cumsum([0, *(len(v[0]) for v in vectors)])
    covariance = np.diag(np.concatenate([v[2] for v in vectors]))
    for source in dict.fromkeys(s for v in vectors for s in v[1]):
        width = max(v[1][source].shape[1] for v in vectors if source in v[1])
        block = np.zeros((sizes[-1], width))
        for k, v in enumerate(vectors):
            if source in v[1]:
                block[sizes[k] : sizes[k + 1], : v[1][source].shape[1]] = v[1][source]
        covariance += block @ block.T
    return np.concatenate([v[0] for v in vectors]), covariance


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


def chi_square_test(parts: Iterable[Values], combinations: int = COMBINATIONS) -> Test:
    """Test whether values are 0, in the few combinations that a measurement determines.

    Errors of neighbouring stations are almost equal, so that 32 stations are not 32 measurements: each quantity is
    tested in at most `combinations` smooth combinations along the span (Legendre polynomials of value over sigma), and
    combinations whose variance is below 0.001 of that of a value are omitted.

    Parameters
    ----------
    parts
        Values of quantities along the span, without frames; NaN are omitted.
    combinations
        Number of combinations of a quantity; 0 tests every combination of the single values.
    """
    parts = [p for p in parts if np.isfinite(p.value.values).any()]
    if any(FRAME in p.value.dims for p in parts):
        raise WingdError("the test is of one shape; select a frame or take the mean of the frames")
    if not parts:
        return Test(0.0, 0, 1.0, _table([], _COMBINATION), _table([], _BAND))
    values, covariance = _joint(parts)
    sigma = np.sqrt(np.diag(covariance))
    names = np.repeat([str(p.value.name) for p in parts], [p.value.size for p in parts])
    units = dict((str(p.value.name), p.unit) for p in parts)
    places = np.concatenate([_places(p) for p in parts])
    known = np.isfinite(values) & (sigma > 0)
    values, covariance, sigma, names, places = (
        values[known],
        covariance[np.ix_(known, known)],
        sigma[known],
        names[known],
        places[known],
    )
    basis = _smooth_basis(names, places, combinations)
    scaled = values / sigma
    correlation = covariance / np.outer(sigma, sigma)
    eigenvalues, vectors = np.linalg.eigh(basis.T @ correlation @ basis)
    tested = eigenvalues > MIN_TESTED_VARIANCE
    weights = basis @ vectors[:, tested]
    sizes = weights.T @ scaled / np.sqrt(eigenvalues[tested])
    chi_square, freedom = float(sizes @ sizes), int(tested.sum())
    order = np.argsort(-np.abs(sizes))
    rows = [(abs(sizes[k]), *_main_place(weights[:, k] * scaled, names, places)) for k in order]
    return Test(
        chi_square,
        freedom,
        float(chi2.sf(chi_square, freedom)),
        _table(rows, _COMBINATION),
        _bands(values, sigma, names, places, units),
    )


_COMBINATION = ["sigmas", "quantity", "from_m", "to_m"]
_BAND = ["quantity", "unit", "from_m", "to_m", "largest", "sigma_largest"]


def _table(rows: list[tuple], columns: list[str]) -> pd.DataFrame:
    return pd.DataFrame(rows, columns=columns)


def _smooth_basis(names: np.ndarray, places: np.ndarray, combinations: int) -> np.ndarray:
    """Return orthonormal columns: polynomials along the span, for each quantity."""
    if combinations == 0:
        return np.eye(len(names))
    columns = []
    for name in dict.fromkeys(names):
        rows = np.flatnonzero(names == name)
        at = places[rows]
        width = np.ptp(at) or 1.0
        polynomials = np.polynomial.legendre.legvander(
            2 * (at - at.min()) / width - 1, min(combinations, len(np.unique(at))) - 1
        )
        block = np.zeros((len(names), polynomials.shape[1]))
        block[rows] = np.linalg.qr(polynomials)[0]
        columns.append(block)
    return np.hstack(columns)


def _main_place(contributions: np.ndarray, names: np.ndarray, places: np.ndarray) -> tuple[str, float, float]:
    """Return quantity and stretch that hold most of a combination."""
    sums = {name: np.abs(contributions[names == name]).sum() for name in dict.fromkeys(names)}
    name = max(sums, key=sums.get)
    rows = np.flatnonzero(names == name)
    large = rows[np.abs(contributions[rows]) >= 0.5 * np.abs(contributions[rows]).max()]
    return name, float(places[large].min()), float(places[large].max())


def _bands(
    values: np.ndarray, sigma: np.ndarray, names: np.ndarray, places: np.ndarray, units: dict[str, str]
) -> pd.DataFrame:
    rows = []
    for name in dict.fromkeys(names):
        of = np.flatnonzero(names == name)
        of = of[np.argsort(places[of], kind="stable")]
        beyond = np.abs(values[of]) > 2 * sigma[of]
        edges = np.flatnonzero(np.diff(np.concatenate([[False], beyond, [False]]).astype(int)))
        for start, end in zip(edges[::2], edges[1::2], strict=True):
            stretch = of[start:end]
            top = stretch[np.abs(values[stretch]).argmax()]
            rows.append((name, units[name], places[stretch[0]], places[stretch[-1]], values[top], sigma[top]))
    return _table(rows, _BAND)
