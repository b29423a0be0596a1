"""Differences of shapes, and comparison of a shape with a computation."""

from __future__ import annotations

import os
import warnings
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pandas as pd
import xarray as xr

from wingd import WingdError
from wingd.shapes import find_condition
from wingd.textfiles import read_table
from wingd.values import FRAME, Test, Values, WingdWarning, chi_square_test, digest

#: Column of a computation -> quantity and factor of its unit to m or rad.
COLUMNS = {
    "displacement_x_m": ("displacement_x", 1.0),
    "displacement_y_m": ("displacement_y", 1.0),
    "displacement_z_m": ("displacement_z", 1.0),
    "slope_deg": ("slope", np.pi / 180),
    "twist_deg": ("twist", np.pi / 180),
    "streamwise_twist_deg": ("streamwise_twist", np.pi / 180),
}
#: Quantity -> its column.
COLUMN_OF = {quantity: column for column, (quantity, _) in COLUMNS.items()}
#: Quantities compared between measurements: they do not depend on the axes of the survey or the side.
MEASURED = ("displacement_z", "slope", "twist", "streamwise_twist")
#: Longest wing, m.
MAX_LENGTH_M = 100.0


@dataclass(frozen=True, repr=False)
class Comparison:
    """Difference of two shapes along the span.

    Attributes
    ----------
    quantities
        Difference of each quantity, m or rad, over stations.
    measured, computed
        Both sides, with the same keys; of two measurements, the first and the second.
    notes
        Sentences that a reader of the numbers needs.
    """

    quantities: dict[str, Values]
    measured: dict[str, Values]
    computed: dict[str, Values]
    notes: list[str] = field(default_factory=list)

    def __getitem__(self, quantity: str) -> Values:
        return self.quantities[quantity]

    def test(self, full: bool = False) -> Test:
        """Test whether the shapes are equal; streamwise twist follows from slope and twist and is not tested beside them."""
        tested = [v for q, v in self.quantities.items() if q != "streamwise_twist" or "twist" not in self.quantities]
        return chi_square_test(tested, full)

    def table(self) -> pd.DataFrame:
        """Return a row per station: ``arc_length_m``, ``eta``, and each quantity with its sigma (m, deg)."""
        return station_table(self.quantities)

    def plot(self, ax: Any = None, **style: Any) -> Any:
        """Draw the differences with their bands; returns the axes."""
        from wingd import plot

        return plot.draw_comparison(self, ax=ax, **style)

    def __repr__(self) -> str:
        return "\n".join(
            [self.table().to_string(index=False, float_format=lambda v: f"{v:.4f}"), str(self.test()), *self.notes]
        )


def station_table(quantities: dict[str, Values], more: dict[str, dict[str, np.ndarray]] | None = None) -> pd.DataFrame:
    """Return quantities along the span as a table in m and degrees, each with its sigma.

    Parameters
    ----------
    more
        Prefix -> quantity -> array of further columns, in m or rad.
    """
    if not quantities:
        return pd.DataFrame()
    first = next(iter(quantities.values())).value
    columns = {"arc_length_m": np.atleast_1d(first["arc_length"].values)}
    if "eta" in first.coords:
        columns["eta"] = np.atleast_1d(first["eta"].values)
    for name, values in quantities.items():
        column = COLUMN_OF[name]
        unit = COLUMNS[column][1]
        columns[column] = np.atleast_1d(values.value.values) / unit
        columns[f"sigma_{column}"] = np.atleast_1d(values.sigma.values) / unit
        for prefix, arrays in (more or {}).items():
            if name in arrays:
                columns[f"{prefix}{column}"] = np.atleast_1d(arrays[name]) / unit
    return pd.DataFrame(columns)


def shape_quantities(shape: xr.Dataset, names: Iterable[str] = MEASURED, **options: Any) -> dict[str, Values]:
    """Return quantities along the span of one shape; several frames are averaged, unknown quantities left out."""
    found = {}
    for name in names:
        if name.startswith("displacement"):
            values = shape.wingd.displacement(name[-1], **options)
        else:
            # Without the direction of the flow there is no streamwise twist.
            try:
                values = getattr(shape.wingd, name)()
            except WingdError:
                if name != "streamwise_twist":
                    raise
                continue
        values = values.mean() if FRAME in values.value.dims else values
        if np.isfinite(values.value.values).any():
            found[name] = values
    return found


def difference(
    one: xr.Dataset,
    other: xr.Dataset,
    *,
    eta: Sequence[float] | None = None,
    mirror: bool = False,
    load: Sequence[Any] = (),
    thermal: bool = True,
) -> Comparison:
    """Return the first shape minus the second, at equal arc lengths from the root; common errors cancel.

    Parameters
    ----------
    one, other
        Shapes; several frames are averaged.
    eta
        Stations as fractions of the first shape's length; None for all of its stations.
    mirror
        The shapes are of the left and the right wing.
    load
        Effects of conditions to subtract, so that loads are equal: see :func:`load_effect`.
    thermal
        False compares without thermal contraction.
    """
    sides = [str(s.attrs.get("side", "")) for s in (one, other)]
    if mirror and all(sides) and sides[0] == sides[1]:
        raise WingdError(f"both shapes are of the {sides[0]} wing; omit mirror")
    keys = [set(np.ravel(s.coords["own_sources"].values)) if "own_sources" in s.coords else set() for s in (one, other)]
    if keys[0] & keys[1]:
        raise WingdError("both sides have a frame in common; name different frames")
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", WingdWarning)
        first = shape_quantities(one, thermal=thermal)
        second = shape_quantities(other.wingd.mirror() if mirror else other, thermal=thermal)
        first = {k: v.sel(eta=list(eta)) if eta is not None else v for k, v in first.items() if k in second}
        differences = {name: values - second[name] for name, values in first.items()}
    notes = [str(text) for text in dict.fromkeys(str(w.message) for w in caught)]
    notes += [note for s, name in ((one, "first"), (other, "second")) for note in _rejection(s, name)]
    for effect in load:
        differences = load_effect(differences, effect, one, other)
    return Comparison(differences, first, {k: second[k] for k in differences}, notes)


def _rejection(shape: xr.Dataset, name: str) -> list[str]:
    if "global_test" in shape and (shape["global_test"] == "rejected").any():
        return [f"The test of the adjustment rejects a frame of the {name} shape; its standard deviations are scaled."]
    return []


def compare(
    shape: xr.Dataset,
    fem: str | os.PathLike[str] | pd.DataFrame,
    *,
    axes: str = "survey",
    eta: Sequence[float] | None = None,
    thermal: bool = True,
    load: Sequence[Any] = (),
) -> Comparison:
    """Return the measured shape minus a computation.

    Parameters
    ----------
    shape
        Measured shape; several frames are averaged.
    fem
        Table or CSV file with ``arc_length_m`` and any of ``displacement_x_m``, ``displacement_y_m``,
        ``displacement_z_m``, ``slope_deg``, ``twist_deg``, ``streamwise_twist_deg``, each as the change from the surveyed
        state, and ``sigma_`` columns (independent from station to station).
    axes
        Axes of the computation's displacements: ``survey`` or ``cad``.
    eta
        Stations as fractions of the length to the tip, where the computation is interpolated linearly; None compares at
        the computation's stations.
    thermal
        Whether the computation contains the thermal contraction of the wing. If not, it is removed from the shape.
    load
        Effects of conditions to subtract: see :func:`load_effect`.
    """
    table, name = read_computation(fem)
    names = [quantity for column, (quantity, _) in COLUMNS.items() if column in table]
    if not names:
        raise WingdError(f"{name}: has no quantity to compare; add one of the columns {', '.join(COLUMNS)}")
    notes = _rejection(shape, "measured")
    measured = shape_quantities(shape, names, axes=axes, thermal=thermal)
    missing = [COLUMN_OF[n] for n in names if n not in measured]
    if missing:
        notes.append(
            f"Not compared, because the shape lacks them: {', '.join(missing)} (streamwise twist needs wing.flow_direction)."
        )
    notes += _thermal_note(shape, thermal, names)
    arcs = table["arc_length_m"].to_numpy(dtype=float)
    differences, computed = {}, {}
    for quantity in list(measured):
        column, unit = COLUMN_OF[quantity], COLUMNS[COLUMN_OF[quantity]][1]
        values = measured[quantity].sel(eta=list(eta)) if eta is not None else measured[quantity].sel(arc_length=arcs)
        predicted, sigma = _interpolate(table, column, values.value["arc_length"].values, name)
        side = Values(values.value.copy(data=predicted * unit))
        if np.any(sigma > 0):
            side = side.with_source("computation", digest(name, column), np.diag(sigma * unit))
        measured[quantity], computed[quantity] = values, side
        differences[quantity] = values - side
    for effect in load:
        differences = load_effect(differences, effect, shape, None)
    return Comparison(differences, measured, computed, notes)


def _thermal_note(shape: xr.Dataset, thermal: bool, names: Sequence[str]) -> list[str]:
    scale = shape.coords.get("thermal_scale", shape.attrs.get("thermal_scale"))
    scale, length = (
        float(np.mean(scale)) if scale is not None else np.nan,
        float(shape.attrs.get("length_to_tip_m", np.nan)),
    )
    shorter = (1 - scale) * length
    if not np.isfinite(shorter) or abs(shorter) < 1e-4:
        return []
    change = f"{abs(shorter) * 1e3:.0f} mm {'shorter' if shorter > 0 else 'longer'}"
    if not thermal:
        return [
            f"The wing was {change} than on the ground by its temperature; this is removed from the measured shape."
        ]
    return [
        f"The wing was {change} than on the ground by its temperature; the measured displacements contain it: "
        "use thermal=False (--no-thermal) if the computation does not."
    ]


# --- tables ---------------------------------------------------------------------------------------------------------


def read_computation(source: str | os.PathLike[str] | pd.DataFrame | xr.Dataset) -> tuple[pd.DataFrame, str]:
    """Read a table of stations; returns it with its name for messages.

    Columns that are almost right are errors, others that are not read are named in a warning.
    """
    source = source.to_dataframe() if isinstance(source, xr.Dataset) else source
    if not isinstance(source, str | os.PathLike | pd.DataFrame):
        raise WingdError(
            f"{type(source).__name__} is not a computation; give a table of pandas or xarray, or a CSV file"
        )
    name = "the table" if isinstance(source, pd.DataFrame) else os.fspath(source)
    table = source.copy() if isinstance(source, pd.DataFrame) else _read_csv(name)
    table = table.reset_index("arc_length_m") if "arc_length_m" in table.index.names else table
    table.columns = [str(c).strip() for c in table.columns]
    known = ["arc_length_m", *COLUMNS, *(f"sigma_{c}" for c in COLUMNS)]
    unread = []
    for column in table.columns:
        if column in known:
            continue
        near = [k for k in known if _stem(k) == _stem(column)]
        if near:
            raise WingdError(f"{name}: column {column!r} is not read; write {' or '.join(near)} (values in that unit)")
        unread.append(column)
    if unread:
        warnings.warn(f"{name}: columns that are not read: {', '.join(unread)}", WingdWarning, stacklevel=2)
    if "arc_length_m" not in table:
        raise WingdError(
            f"{name}: has no column arc_length_m; add the arc length of the stations from the bending root"
        )
    if table.columns.has_duplicates:
        raise WingdError(f"{name}: has two columns {table.columns[table.columns.duplicated()][0]!r}; keep one")
    if table.empty:
        raise WingdError(f"{name}: has no stations; add one line per station along the span")
    columns = [k for k in known if k in table]
    texts = table[columns].astype(str).apply(lambda column: column.str.strip())
    is_missing = table[columns].isna() | (texts == "")
    numbers = table[columns].apply(lambda column: pd.to_numeric(column, errors="coerce")).astype(float)
    lines = table.attrs.get("lines")

    def place(row: int, column: str) -> str:
        return f"{name}: {f'line {lines[row + 1]}' if lines else f'row {row}'}, {column} = {texts.iloc[row][column]}"

    for row, k in zip(*np.nonzero((~np.isfinite(numbers) & ~is_missing).to_numpy()), strict=True):
        raise WingdError(f"{place(int(row), columns[k])}: is not a finite number")
    arc = numbers["arc_length_m"].to_numpy()
    for row in np.flatnonzero(~((arc >= 0) & (arc <= MAX_LENGTH_M))):
        raise WingdError(
            f"{place(int(row), 'arc_length_m')}: give the arc length from the root, 0 to {MAX_LENGTH_M:.0f} m"
        )
    for row in np.flatnonzero(np.diff(arc) <= 0) + 1:
        if arc[row] == arc[row - 1]:
            before = f"line {lines[row]}" if lines else f"row {row - 1}"
            raise WingdError(f"{place(int(row), 'arc_length_m')}: is the station of {before} too; keep one of them")
        raise WingdError(
            f"{place(int(row), 'arc_length_m')}: is not outboard of the line before; order stations from root to tip"
        )
    for column in columns:
        of = column.removeprefix("sigma_")
        if of == column:
            continue
        if of not in columns:
            raise WingdError(f"{name}: has {column} without {of}; add it or remove the column")
        for row in np.flatnonzero(numbers[column] < 0):
            raise WingdError(f"{place(int(row), column)}: a standard deviation is not negative")
        for row in np.flatnonzero(numbers[column].isna() & numbers[of].notna()):
            raise WingdError(f"{place(int(row), column)}: is unknown; give the standard deviation of {of}, or 0")
    for column in {*columns} & {c for c in COLUMNS if c.startswith("displacement")}:
        for row in np.flatnonzero(numbers[column].abs() > arc.max()):
            raise WingdError(
                f"{place(int(row), column)}: no point of a wing of {arc.max():g} m moves so far; give metres"
            )
    return numbers.reset_index(drop=True), name


def _read_csv(name: str) -> pd.DataFrame:
    header, rows = read_table(name, "arc_length_m,displacement_z_m")
    table = pd.DataFrame([row.cells for row in rows], columns=header.cells)
    table.attrs["lines"] = [header.line, *(row.line for row in rows)]
    return table


def _stem(column: str) -> str:
    """Return a column's name without case and unit, so that another spelling or unit of it is found."""
    parts = column.lower().replace("-", "_").replace(" ", "_").replace("[", "").replace("]", "").split("_")
    units = {"m", "mm", "cm", "ft", "in", "inch", "deg", "rad", "degrees", "mrad"}
    if len(parts) > 1 and parts[-1] in units:
        parts = parts[:-1]
    stem = "_".join(p for p in parts if p)
    # sigma_z_m is meant as sigma_displacement_z_m, s_m as arc_length_m.
    for short in ("x", "y", "z"):
        stem = {short: f"displacement_{short}", f"sigma_{short}": f"sigma_displacement_{short}"}.get(stem, stem)
    return {"s": "arc_length", "arc": "arc_length"}.get(stem, stem)


def _interpolate(table: pd.DataFrame, column: str, at: np.ndarray, name: str) -> tuple[np.ndarray, np.ndarray]:
    """Return values and sigmas of a column at arc lengths `at`, linearly; NaN where the table has none."""
    arcs = table["arc_length_m"].to_numpy()
    outside = (at < arcs[0] - 1e-6) | (at > arcs[-1] + 1e-6)
    if outside.any():
        raise WingdError(f"{name}: has no stations around {at[outside][0]:.3f} m; add them, or choose others with eta")
    values = np.interp(at, arcs, table[column].to_numpy())
    sigma = f"sigma_{column}"
    return values, np.nan_to_num(np.interp(at, arcs, table[sigma].to_numpy())) if sigma in table else np.zeros(len(at))


# --- equal loads ----------------------------------------------------------------------------------------------------


def load_effect(
    differences: dict[str, Values], effect: Any, one: xr.Dataset, other: xr.Dataset | None
) -> dict[str, Values]:
    """Return differences less the effect of a condition, so that loads are equal.

    Parameters
    ----------
    effect
        ``"FILE:weight_kg"`` (times the difference of the condition), ``"FILE:weight_kg=60000"`` (the computation's
        value), ``"FILE:DELTA,SIGMA"``, or a pair of a table and one of the texts after the colon. The table is as for
        :func:`compare`, of the change per unit of the condition.
    one, other
        Shapes whose conditions are meant; other is None for a computation. Errors of one instrument are common to both
        shapes: a scale error counts with the difference of the condition, a bias not at all.
    """
    source, _, condition = effect.rpartition(":") if isinstance(effect, str) else (effect[0], "", effect[1])
    form = "write FILE:QUANTITY, FILE:QUANTITY=VALUE or FILE:DELTA,SIGMA"
    if isinstance(source, str) and not source:
        raise WingdError(f"load {effect!r}: {form}")
    table, name = read_computation(source)
    amount = _amount(str(condition), one, other, f"load {condition!r}: ", form)
    out = {}
    for quantity, values in differences.items():
        column = COLUMN_OF[quantity]
        if column not in table:
            continue
        unit = COLUMNS[column][1]
        per_unit, sigma = (a * unit for a in _interpolate(table, column, values.value["arc_length"].values, name))
        step = values - per_unit * float(amount.value)
        for kind, factor in amount.factors.items():
            for k, key in enumerate(factor.keys):
                step = step.with_source(kind, key, -per_unit[:, None] * factor.array[k][None, :])
        if np.any(sigma > 0):
            step = step.with_source("computation", digest(name, column), np.diag(sigma * float(amount.value)))
        out[quantity] = step
    if not out:
        raise WingdError(
            f"{name}: has no quantity that is compared; add one of the columns {', '.join(COLUMN_OF[q] for q in differences)}"
        )
    return out


def _amount(text: str, one: xr.Dataset, other: xr.Dataset | None, place: str, form: str) -> Values:
    """Return the difference of a condition, a number with its sources."""

    def number(part: str) -> float:
        try:
            value = float(part)
        except ValueError:
            value = np.nan
        if not np.isfinite(value):
            raise WingdError(f"{place}{part!r} is not a number; {form}")
        return value

    if "," in text:
        delta, sigma = (number(part) for part in text.split(",", 1))
        if sigma < 0:
            raise WingdError(f"{place}the standard deviation is negative; give 0 or a positive number")
        return Values(xr.DataArray(delta)).with_source("condition", digest(text), np.array(sigma))
    name, _, reference = text.partition("=")
    known = [str(n) for n in one.data_vars if f"sigma_{n}" in one and one[n].dims in ((), (FRAME,))]
    quantity, factor, offset = find_condition(name.strip(), known)

    def mean(shape: xr.Dataset) -> Values:
        values = shape.wingd.condition(quantity)
        return (values.mean() if FRAME in values.value.dims else values) * factor

    if reference:
        if other is not None:
            raise WingdError(f"{place}both sides have their values; omit ={reference}")
        return mean(one) - (number(reference) - offset)
    if other is None:
        raise WingdError(f"{place}give the computation's value: {name}=VALUE")
    return mean(one) - mean(other)


__all__ = [
    "Comparison",
    "compare",
    "difference",
    "load_effect",
    "read_computation",
    "shape_quantities",
    "station_table",
]
