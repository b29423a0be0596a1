"""Figures of shapes, comparisons, loads and spectra, in one style; axes name quantity, unit and reference."""

from __future__ import annotations

import os
import textwrap
from collections.abc import Iterable
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
import xarray as xr

from wingd import WingdError
from wingd.values import FRAME, Values

if TYPE_CHECKING:
    from wingd.comparison import Comparison

#: Style sheet of all figures.
STYLE = str(Path(__file__).with_name("wingd.mplstyle"))
#: Opacity of a band of one standard deviation, and longest line of a label, characters.
BAND, LABEL_WIDTH = 0.25, 36


@contextmanager
def axes(ax: Any = None, **figure: Any) -> Any:
    """Give `ax`, or axes of a new figure in the style of the package."""
    with plt.style.context(STYLE):
        yield ax if ax is not None else plt.subplots(**figure)[1]


def axis_label(values: Values, of: str = "") -> str:
    """Return quantity, unit and reference of values for an axis, in lines that fit beside it; `of` stands before."""
    unit = {"rad": "deg"}.get(values.unit, values.unit)
    text = f"{of}{values.label} / {unit}" if unit else f"{of}{values.label}"
    return textwrap.fill(text, LABEL_WIDTH)


def draw_values(values: Values, ax: Any = None, label: str | None = None, **style: Any) -> Any:
    """Draw values along the span, or over frames, with a band of one standard deviation.

    Parameters
    ----------
    values
        Values over stations, markers or frames; several frames are several lines.
    ax
        Axes; None for a new figure.
    style
        Options of :meth:`matplotlib.axes.Axes.plot`.

    Returns
    -------
    matplotlib.axes.Axes
    """
    to = 180 / np.pi if values.unit == "rad" else 1.0
    with axes(ax) as ax:
        if values.value.ndim > 2:
            raise WingdError("select one component to draw: displacement(axis='z')")
        if values.value.ndim == 2:
            other = (
                next(d for d in values.value.dims if d == FRAME) if FRAME in values.value.dims else values.value.dims[0]
            )
            for k in range(values.value.sizes[other]):
                one = values.isel(**{str(other): k})
                draw_values(one, ax, label or _frame_label(one.value), **style)
            return ax
        x, name = _along(values.value)
        y, sigma = values.value.values * to, values.sigma.values * to
        if x.dtype.kind in "OU":
            ax.errorbar(x, y, sigma, fmt="o", label=label, **style)
        else:
            (line,) = ax.plot(x, y, label=label, **style)
            ax.fill_between(x, y - sigma, y + sigma, color=line.get_color(), alpha=BAND, linewidth=0)
        ax.set_xlabel(name)
        ax.set_ylabel(axis_label(values))
        if label:
            ax.legend()
    return ax


def _frame_label(value: xr.DataArray) -> str | None:
    return str(value.coords["image"].item()) if "image" in value.coords and value.coords["image"].ndim == 0 else None


def _along(value: xr.DataArray) -> tuple[np.ndarray, str]:
    for name, label in (("arc_length", "arc length from the root / m"), ("marker", "marker"), ("time", "time (UTC)")):
        if name in value.coords and value.coords[name].dims == value.dims:
            return value.coords[name].values, label
    return np.arange(value.size), str(value.dims[0]) if value.dims else ""


def draw_comparison(comparison: Comparison, ax: Any = None, **style: Any) -> Any:
    """Draw each quantity of a comparison: difference with a band, and where it exceeds two sigmas; returns the axes."""
    names = list(comparison.quantities)
    if ax is None:
        with axes(None, nrows=len(names), sharex=True, squeeze=False, figsize=(6.4, 2.8 * len(names))) as grid:
            ax = grid[:, 0]
    for each, name in zip(np.atleast_1d(ax), names, strict=False):
        values = comparison.quantities[name]
        draw_values(values, each, **style)
        each.axhline(0.0, color="0.5", linewidth=0.8)
        bands = comparison.test().bands
        for band in bands[bands["quantity"] == name].itertuples():
            each.axvspan(band.from_m, band.to_m, color="C3", alpha=0.08, linewidth=0)
        each.set_ylabel(axis_label(values, "difference of "))
    return ax


def draw_spectrum(spectrum: pd.DataFrame, ax: Any = None, unit: str = "", **style: Any) -> Any:
    """Draw a spectrum of :func:`wingd.spectrum` with its band and the noise; returns the axes."""
    with axes(ax) as ax:
        rows = spectrum[spectrum["frequency_hz"] > 0]
        (line,) = ax.loglog(rows["frequency_hz"], rows["density"], **style)
        low = (rows["density"] - rows["sigma_density"]).clip(lower=rows["density"] * 0.1)
        ax.fill_between(
            rows["frequency_hz"], low, rows["density"] + rows["sigma_density"], color=line.get_color(), alpha=BAND
        )
        if rows["noise"].notna().all():
            ax.plot(rows["frequency_hz"], rows["noise"], "--", color="0.5", label="noise of the results")
            ax.legend()
        ax.set_xlabel("frequency / Hz")
        ax.set_ylabel(f"power spectral density / ({unit or 'unit'})²/Hz")
    return ax


def draw_moments(moments: pd.DataFrame, ax: Any = None, **style: Any) -> Any:
    """Draw bending moments over time with their bands, a line for each station; returns the axes."""
    with axes(ax) as ax:
        for s, station in moments.groupby("s_m"):
            (line,) = ax.plot(station["time"], station["moment_nm"] * 1e-3, label=f"{s:g} m", **style)
            low, high = (station["moment_nm"] + k * station["sigma_moment_nm"] for k in (-1, 1))
            ax.fill_between(station["time"], low * 1e-3, high * 1e-3, color=line.get_color(), alpha=BAND, linewidth=0)
        ax.set_xlabel("time (UTC)")
        ax.set_ylabel("bending moment relative to the ground / kN m")
        ax.legend(title="arc length")
        ax.figure.autofmt_xdate()
    return ax


def animate(
    shape: xr.Dataset,
    quantity: str = "displacement",
    file: str | os.PathLike[str] | None = None,
    interval_ms: int = 200,
    **options: Any,
) -> Any:
    """Animate the frames of a shape.

    Parameters
    ----------
    shape
        Shapes of frames.
    quantity
        Method of the accessor ``.wingd`` that gives the values: ``displacement``, ``slope``, ``twist``.
    file
        File to write (GIF); None only returns the animation.
    options
        Options of that method.

    Returns
    -------
    matplotlib.animation.FuncAnimation
    """
    from matplotlib.animation import FuncAnimation, PillowWriter

    values = getattr(shape.wingd, quantity)(**options)
    if FRAME not in values.value.dims:
        raise WingdError("one shape is not animated; give the frames of a flight")
    to = 180 / np.pi if values.unit == "rad" else 1.0
    low, high = (
        float((values.value + k * values.sigma).min() if k < 0 else (values.value + k * values.sigma).max()) * to
        for k in (-1, 1)
    )
    with axes(None) as ax:

        def draw(k: int) -> Iterable[Any]:
            ax.clear()
            one = values.isel(frame=k)
            draw_values(one, ax)
            ax.set_ylim(low, high)
            ax.set_title(_frame_label(one.value) or f"frame {k}")
            return ax.get_children()

        animation = FuncAnimation(ax.figure, draw, frames=values.value.sizes[FRAME], interval=interval_ms)
        if file is not None:
            animation.save(os.fspath(file), writer=PillowWriter(fps=1000 / interval_ms))
    return animation
