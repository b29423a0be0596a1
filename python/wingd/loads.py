"""Loads: extremes, exceedances, rainflow cycles, relative damage and spectra of bending moments.

Moments are changes relative to the ground, N m, positive if they bend the tip up. ``sigma`` of a moment has two parts:
that of the curvature, and that of the stiffness, which is common to all frames and cancels in relative damage.
"""

from __future__ import annotations

import os
import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
import xarray as xr

from wingd import WingdError
from wingd.values import FRAME

#: Samples per period of the lowest bending mode: an extreme between two is then missed by at most 5 % of the amplitude.
SAMPLES_PER_PERIOD = 10.0
#: Relative tolerance of a rate: clocks of cameras are more accurate.
RATE_TOLERANCE = 0.01
#: Interval over the median from which on it is a gap.
GAP_RATIO = 1.5
#: Smallest fraction of frames between two holes, and of the time, with which cycles are counted.
MIN_PRESENT, MIN_COUNTED = 0.9, 0.1
#: Smallest significant range, in standard deviations.
NOISE_SIGMAS = 3.0
#: Relative standard deviation of the stiffness by steps, engines and struts that a smooth curvature does not resolve.
STEPS = 0.02
#: Lowest bending frequency if none is given, Hz, and slopes of S-N curves.
BENDING_HZ, SLOPES = 3.0, (3.0, 5.0, 10.0)


def shape_moments(shape: xr.Dataset) -> pd.DataFrame:
    """Return the bending moments that a shape contains, as a table.

    Returns
    -------
    pandas.DataFrame
        A row per frame and station, in order of time: ``flight``, ``image``, ``time``, ``s_m`` (arc length, m),
        ``moment_nm``, ``sigma_moment_nm``, ``sigma_by_stiffness_nm``, N m.
    """
    if "bending_moment" not in shape:
        raise WingdError(
            "the results have no bending moments; give [structure] stiffness in installation.toml, and export again"
        )
    data = shape if FRAME in shape.dims else shape.expand_dims(FRAME)
    moments = data["bending_moment"].transpose(FRAME, ...)
    place = str(moments.dims[1])
    by_stiffness = data.get("bending_moment_stiffness")
    known = by_stiffness is not None
    stiffness = np.linalg.norm(by_stiffness.values, axis=-1) if known else np.full(moments.shape, np.nan)
    frames, sections = moments.shape
    columns = {
        name: np.repeat(data[name].values, sections) for name in ("flight", "image", "time") if name in data.coords
    }
    table = pd.DataFrame(
        columns
        | {
            "s_m": np.tile(data[place].values if place in data.coords else data["arc_length"].values, frames),
            "moment_nm": moments.values.ravel(),
            "sigma_moment_nm": data["sigma_bending_moment"].values.ravel(),
            "sigma_by_stiffness_nm": stiffness.ravel(),
        }
    )
    return _in_order(table[np.isfinite(table["moment_nm"])])


#: Columns of tables of ``wingd export`` and of moments that ``wingd stress`` wrote -> columns here.
_NAMES = {
    "arc_length_m": "s_m",
    "bending_moment_nm": "moment_nm",
    "sigma_bending_moment_nm": "sigma_moment_nm",
    "sigma_stiffness_nm": "sigma_by_stiffness_nm",
    "moment_n_m": "moment_nm",
    "sigma_moment_n_m": "sigma_moment_nm",
    "sigma_by_stiffness_n_m": "sigma_by_stiffness_nm",
}


def read_moments(source: str | os.PathLike[str] | pd.DataFrame) -> pd.DataFrame:
    """Read moments: a table as of :func:`shape_moments`, or a table ``moments`` or ``live`` of ``wingd export``."""
    from wingd.store import read_table

    table = source if isinstance(source, pd.DataFrame) else read_table(source)
    name = "the table" if isinstance(source, pd.DataFrame) else os.fspath(source)
    if table.empty:
        raise WingdError(
            f"{name}: has no bending moment; give [structure] stiffness in installation.toml, and solve again"
        )
    sections = [m[1] for m in (re.fullmatch(r"bending_moment_(b\d+)_nm", str(c)) for c in table) if m]
    if sections:
        table = _long_table(table, sections)
    time = next((c for c in ("time", "exposure_time", "utc") if c in table and table[c].notna().any()), None)
    renamed = {k: v for k, v in _NAMES.items() if k in table and v not in table} | ({time: "time"} if time else {})
    table = table.drop(columns="time") if time not in (None, "time") and "time" in table else table
    table = table.rename(columns=renamed)
    lacking = [c for c in ("time", "s_m", "moment_nm", "sigma_moment_nm") if c not in table]
    if lacking:
        raise WingdError(
            f"{name}: has no column {', '.join(lacking)}; export a table with bending moments ([structure] stiffness in "
            "installation.toml)"
        )
    if not pd.api.types.is_numeric_dtype(table["time"]):
        table = table.assign(time=pd.to_datetime(table["time"], utc=True, format="ISO8601"))
    known = np.isfinite(table["moment_nm"].astype(float)) & table["time"].notna()
    if not known.any():
        raise WingdError(
            f"{name}: no row has a bending moment with a time; give [structure] stiffness in installation.toml and solve again"
        )
    return _in_order(table[known])


def _long_table(table: pd.DataFrame, sections: Sequence[str]) -> pd.DataFrame:
    """Return a row for each section of live results, which have a column for each."""
    common = [c for c in table if not re.search(r"_b\d+_", str(c))]
    parts = []
    for section in sections:
        columns = {c: str(c).replace(f"_{section}_", "_") for c in table if f"_{section}_" in str(c)}
        parts.append(table[[*common, *columns]].rename(columns=columns))
    return pd.concat(parts, ignore_index=True)


def _in_order(table: pd.DataFrame) -> pd.DataFrame:
    keys = [c for c in ("flight", "time", "s_m") if c in table]
    return table.sort_values(keys, kind="stable").reset_index(drop=True)


@dataclass(frozen=True)
class Sampling:
    """Rate and gaps of frames.

    Attributes
    ----------
    rate_hz, needed_hz
        Frames per second by the median interval (NaN of fewer than two), and the rate that counting needs.
    gaps, longest_gap_s
        Number of intervals above 1.5 times the median, and the longest.
    counted_s, uncounted_s
        Time in which frames follow each other closely enough for cycles, and the rest.
    missed
        Mean fraction of a range at the lowest bending frequency that is missed between frames.
    """

    rate_hz: float
    needed_hz: float
    gaps: int
    longest_gap_s: float
    covered_s: float
    uncovered_s: float
    missed: float

    @property
    def countable(self) -> bool:
        """Whether cycles can be counted in a sufficient fraction of the time."""
        fast = self.rate_hz >= (1 - RATE_TOLERANCE) * self.needed_hz
        return bool(fast and self.covered_s > MIN_COUNTED * (self.covered_s + self.uncovered_s))

    def reason(self, bending_hz: float) -> str | None:
        """Return why no cycles are counted; None if they are."""
        if self.countable:
            return None
        if np.isnan(self.rate_hz):
            return "one frame is too few to count cycles"
        if self.rate_hz < (1 - RATE_TOLERANCE) * self.needed_hz:
            return (
                f"{self.rate_hz:.4g} frames per second are too few to count cycles of a {bending_hz:g} Hz bending mode; "
                f"{self.needed_hz:g} per second are needed"
            )
        return f"frames cover only {self.covered_s:.1f} s of {self.covered_s + self.uncovered_s:.1f} s"


def analyse_sampling(times_s: np.ndarray, bending_hz: float = BENDING_HZ) -> Sampling:
    """Analyse the times of frames, s in order, for a wing with this lowest bending frequency."""
    steps = np.diff(np.asarray(times_s, dtype=float)).clip(min=0)
    median = float(np.sort(steps)[len(steps) // 2]) if len(steps) else 0.0
    needed = SAMPLES_PER_PERIOD * bending_hz
    if median <= 0:
        return Sampling(np.nan, needed, 0, 0.0, 0.0, 0.0, 0.0)
    half_turn = np.pi * bending_hz * median
    enough, hole = max(median, 1 / ((1 - RATE_TOLERANCE) * needed)), max(1 / bending_hz, GAP_RATIO * median)
    covered = uncovered = 0.0
    for stretch in np.split(steps, np.flatnonzero(steps > hole) + 1):
        close = stretch[stretch <= hole]
        uncovered += stretch[stretch > hole].sum()
        present = np.minimum(close, enough).sum()
        inside = present if present >= MIN_PRESENT * close.sum() else 0.0
        covered += inside
        uncovered += close.sum() - inside
    gaps = steps[steps > GAP_RATIO * median]
    longest = float(gaps.max()) if len(gaps) else 0.0
    return Sampling(
        1 / median,
        needed,
        len(gaps),
        longest,
        float(covered),
        float(uncovered),
        float(1 - np.sin(half_turn) / half_turn),
    )


def _curvature_sigma(station: pd.DataFrame, structure: pd.DataFrame | None) -> tuple[np.ndarray, np.ndarray]:
    """Return the parts of sigma by curvature and by stiffness, N m."""
    sigma, moment = station["sigma_moment_nm"].to_numpy(dtype=float), station["moment_nm"].to_numpy(dtype=float)
    by_stiffness = (
        station["sigma_by_stiffness_nm"].to_numpy(dtype=float)
        if "sigma_by_stiffness_nm" in station
        else np.full(len(sigma), np.nan)
    )
    if np.isnan(by_stiffness).any():
        relative = _stiffness_fraction(station, structure, True)
        by_stiffness = np.abs(moment) * relative
    return np.sqrt((sigma**2 - by_stiffness**2).clip(min=0)), by_stiffness


def _stiffness_fraction(station: pd.DataFrame, structure: pd.DataFrame | None, steps: bool) -> float:
    if structure is None:
        if "sigma_by_stiffness_nm" in station and np.isfinite(station["sigma_by_stiffness_nm"]).all():
            moment = station["moment_nm"].to_numpy(dtype=float)
            largest = int(np.abs(moment).argmax())
            relative = station["sigma_by_stiffness_nm"].iloc[largest] / max(abs(moment[largest]), 1e-300)
            return float(relative if steps else np.sqrt(max(relative**2 - STEPS**2, 0.0)))
        raise WingdError(
            "the moments do not state sigma_by_stiffness_nm; give the table of the stiffness (structure=, --structure)"
        )
    row = structure.iloc[(structure["s_m"] - station["s_m"].iloc[0]).abs().argmin()]
    relative = row["sigma_ei_n_m2"] / row["ei_n_m2"]
    return float(np.hypot(relative, STEPS) if steps else relative)


def _stations(moments: Any) -> tuple[pd.DataFrame, list[tuple[float, pd.DataFrame]]]:
    table = read_moments(moments)
    if "flight" in table and table["flight"].nunique() > 1:
        raise WingdError(
            f"the moments are of the flights {', '.join(table['flight'].unique())}; evaluate one at a time"
        )
    return table, [(float(s), station) for s, station in table.groupby("s_m", sort=True)]


def seconds_of(station: pd.DataFrame) -> np.ndarray:
    """Return the times of rows, s: since boot within one boot, else by UTC."""
    if "since_boot_s" in station and ("boot_id" not in station or station["boot_id"].nunique() == 1):
        return station["since_boot_s"].to_numpy(dtype=float)
    time = station["time"]
    if pd.api.types.is_numeric_dtype(time):
        return time.to_numpy(dtype=float)
    return ((time - time.iloc[0]) / pd.Timedelta(seconds=1)).to_numpy(dtype=float)


def extremes(moments: Any, structure: pd.DataFrame | None = None) -> pd.DataFrame:
    """Return the extreme moments and the ground-air-ground cycle of each station.

    Noise raises the largest of many values.

    Returns
    -------
    pandas.DataFrame
        By ``s_m``: ``greatest_nm``, ``smallest_nm`` and the range ``ground_air_ground_nm`` from the ground's 0 to the
        extremes, each with its sigma, N m, and the images of the extremes.
    """
    rows = []
    for s, station in _stations(moments)[1]:
        moment = station["moment_nm"].to_numpy(dtype=float)
        curvature, stiffness = _curvature_sigma(station, structure)
        high, low = len(moment) - 1 - int(moment[::-1].argmax()), len(moment) - 1 - int(moment[::-1].argmin())
        sigma = np.hypot(curvature, stiffness)
        whole = _ground_air_ground(moment, curvature, stiffness)
        row = {
            "s_m": s,
            "greatest_nm": moment[high],
            "sigma_greatest_nm": sigma[high],
            "smallest_nm": moment[low],
            "sigma_smallest_nm": sigma[low],
        }
        row |= {"ground_air_ground_nm": whole[0], "sigma_ground_air_ground_nm": np.hypot(whole[2], whole[3])}
        if "image" in station:
            row |= {"greatest_in": station["image"].iloc[high], "smallest_in": station["image"].iloc[low]}
        rows.append(row)
    return pd.DataFrame(rows).set_index("s_m")


def _ground_air_ground(
    moment: np.ndarray, curvature: np.ndarray, stiffness: np.ndarray
) -> tuple[float, float, float, float]:
    """Return range, mean, and the parts of the range's sigma by curvature and stiffness."""
    high, low = len(moment) - 1 - int(moment[::-1].argmax()), len(moment) - 1 - int(moment[::-1].argmin())
    parts = [
        (moment[k], curvature[k], stiffness[k]) if sign * moment[k] > 0 else (0.0, 0.0, 0.0)
        for k, sign in ((high, 1), (low, -1))
    ]
    (a, a_curvature, a_stiffness), (b, b_curvature, b_stiffness) = parts
    # Both moments have the same error of the stiffness, proportional to the range.
    return a - b, 0.5 * (a + b), float(np.hypot(a_curvature, b_curvature)), a_stiffness + b_stiffness


def exceedances(moments: Any, levels: int = 10) -> pd.DataFrame:
    """Return, for equidistant levels between the extremes of each station, frames above and upward crossings (ASTM E1049-85, 5.1)."""
    rows = []
    for s, station in _stations(moments)[1]:
        moment = station["moment_nm"].to_numpy(dtype=float)
        for k in range(levels):
            level = moment.min() + (moment.max() - moment.min()) * (k + 0.5) / levels
            above = moment > level
            rows.append((s, level, int(above.sum()), int((~above[:-1] & above[1:]).sum())))
    return pd.DataFrame(rows, columns=["s_m", "level_nm", "frames_above", "upward_crossings"])


def rainflow(moments: Any, bending_hz: float = BENDING_HZ, structure: pd.DataFrame | None = None) -> pd.DataFrame:
    """Count the load cycles of a flight that begins and ends on the ground (ASTM E1049-85, 5.4.4).

    Parameters
    ----------
    moments
        Table of :func:`shape_moments`, or what :func:`read_moments` reads.
    bending_hz
        Lowest bending frequency of the wing: counting needs ten frames per period.

    Returns
    -------
    pandas.DataFrame
        ``s_m``, ``range_nm``, ``sigma_range_nm`` (by the curvature), ``mean_nm``, ``count`` (1 or 0.5), ``significant``
        (at least three sigmas), the largest first.
    """
    rows = []
    for s, station in _stations(moments)[1]:
        sampling = analyse_sampling(seconds_of(station), bending_hz)
        if not sampling.countable:
            raise WingdError(f"{sampling.reason(bending_hz)}; extremes() are from the available frames")
        rows += [
            (s, *cycle)
            for cycle in _cycles(station["moment_nm"].to_numpy(dtype=float), _curvature_sigma(station, structure)[0])
        ]
    table = pd.DataFrame(rows, columns=["s_m", "range_nm", "sigma_range_nm", "mean_nm", "count", "significant"])
    return table.sort_values(["s_m", "range_nm"], ascending=[True, False], kind="stable").reset_index(drop=True)


def _cycles(moment: np.ndarray, curvature: np.ndarray) -> list[tuple[float, float, float, float, bool]]:
    import rainflow as counting

    history, sigma = (np.concatenate([[0.0], part, [0.0]]) for part in (moment, curvature))
    found = []
    for span, mean, count, start, end in counting.extract_cycles(history):
        noise = float(np.hypot(sigma[start], sigma[end]))
        found.append((span, noise, mean, count, bool(span >= NOISE_SIGMAS * noise)))
    return found


def damage(
    moments: Any,
    slopes: Sequence[float] = SLOPES,
    bending_hz: float = BENDING_HZ,
    structure: pd.DataFrame | None = None,
    goodman: bool = False,
) -> pd.DataFrame:
    """Return the damage of a flight relative to one ground-air-ground cycle (Palmgren and Miner).

    Parameters
    ----------
    slopes
        Slopes m of S-N curves: N is proportional to the range to the power of -m.
    structure
        Table ``s_m, ei_n_m2, sigma_ei_n_m2`` and, for `goodman`, ``ground_n_m`` (0 if missing) and ``ultimate_n_m``.
    goodman
        Correct each cycle for its mean.

    Returns
    -------
    pandas.DataFrame
        ``s_m``, ``slope``, ``relative``, ``sigma_relative``, ``equivalent_range_nm`` (of one cycle of equal damage),
        ``sigma_equivalent_range_nm``. Sigmas contain extremes between two frames and the uncounted time.
    """
    rows = []
    for s, station in _stations(moments)[1]:
        sampling = analyse_sampling(seconds_of(station), bending_hz)
        if not sampling.countable:
            raise WingdError(f"{sampling.reason(bending_hz)}; extremes() are from the available frames")
        moment = station["moment_nm"].to_numpy(dtype=float)
        curvature, stiffness = _curvature_sigma(station, structure)
        span, mean, by_curvature, _ = _ground_air_ground(moment, curvature, stiffness)
        correct = _goodman_line(structure, s) if goodman else lambda r, m: r
        reference = float(correct(np.array([span]), np.array([mean]))[0])
        cycles = [c for c in _cycles(moment, curvature) if c[4]]
        ranges, noise, means, counts = (np.array([c[k] for c in cycles], dtype=float) for k in range(4))
        fraction = _stiffness_fraction(station, structure, False)
        for slope in slopes:
            each = counts * (correct(ranges, means) / reference) ** slope
            total = each.sum()
            variance = ((slope * each * noise / ranges) ** 2).sum()
            by_reference = slope * total * by_curvature / span
            largest = each.max() if len(each) else 0.0
            hidden = (1 + slope * sampling.missed) * (1 + sampling.uncovered_s / max(sampling.covered_s, 1e-300)) - 1
            unseen = (total - largest) * hidden
            equivalent = reference * total ** (1 / slope)
            by_cycles = np.hypot(np.sqrt(variance), unseen) / (slope * total) if total > 0 else 0.0
            sigma = float(np.sqrt(variance + by_reference**2 + unseen**2))
            rows.append((s, slope, total, sigma, equivalent, equivalent * float(np.hypot(by_cycles, fraction))))
    names = ["s_m", "slope", "relative", "sigma_relative", "equivalent_range_nm", "sigma_equivalent_range_nm"]
    return pd.DataFrame(rows, columns=names)


def _goodman_line(structure: pd.DataFrame | None, s_m: float) -> Any:
    if structure is None or "ultimate_n_m" not in structure or structure["ultimate_n_m"].isna().any():
        raise WingdError("goodman needs ultimate_n_m of every station in the table of the stiffness")
    row = structure.iloc[(structure["s_m"] - s_m).abs().argmin()]
    ground, ultimate = row.get("ground_n_m", 0.0), row["ultimate_n_m"]

    def equivalent(ranges: np.ndarray, means: np.ndarray) -> np.ndarray:
        # A mean that closes cracks is not credited; a cycle that reaches failure is infinite.
        share = ((ground + means) / ultimate).clip(min=0.0)
        with np.errstate(divide="ignore"):
            return np.where(share < 1, ranges / np.where(share < 1, 1 - share, 1), np.inf)

    return equivalent


def read_structure(file: str | os.PathLike[str]) -> pd.DataFrame:
    """Read the stiffness along the span: CSV with ``s_m, ei_n_m2, sigma_ei_n_m2`` and optionally ``ground_n_m, ultimate_n_m``."""
    table = pd.read_csv(file, comment="#", skipinitialspace=True)
    lacking = [c for c in ("s_m", "ei_n_m2", "sigma_ei_n_m2") if c not in table]
    if lacking:
        raise WingdError(f"{os.fspath(file)}: has no column {', '.join(lacking)}; write s_m,ei_n_m2,sigma_ei_n_m2")
    bad = ~(np.isfinite(table[["s_m", "ei_n_m2", "sigma_ei_n_m2"]].apply(pd.to_numeric, errors="coerce")).all(axis=1))
    if bad.any() or (table["ei_n_m2"] <= 0).any() or (np.diff(table["s_m"]) <= 0).any():
        raise WingdError(
            f"{os.fspath(file)}: stiffnesses are positive numbers, stations in order from root to tip, each once"
        )
    return table


def spectrum(history: Any, column: str | None = None, rate_hz: float | None = None, segments: int = 8) -> pd.DataFrame:
    """Return the power spectral density of a history at a regular rate, by Welch's method.

    Parameters
    ----------
    history
        Table with a time and columns of numbers, such as ``store["f0003"].live``, or moments of one station.
    column
        Column; None for the first of ``moment_nm``, ``tip_deflection_ground_m``, ``tip_deflection_m``.
    rate_hz
        Rate; None for that of the median interval. Frames are interpolated to it linearly; gaps are refused.

    Returns
    -------
    pandas.DataFrame
        ``frequency_hz``, ``density`` (square of the unit per Hz), ``sigma_density`` (of the average over segments) and
        ``noise`` (density of the standard deviations as white noise; NaN without them).
    """
    from scipy.signal import welch

    names = ["moment_nm", "bending_moment_nm", "tip_deflection_ground_m", "tip_deflection_m"]
    column = column or next((n for n in names if n in history), None)
    if column is None or column not in history:
        raise WingdError(f"the table has no column {column or ' or '.join(names)}; name one with column=")
    time = next((c for c in ("time", "exposure_time", "utc") if c in history), None)
    if time is None and "since_boot_s" not in history:
        raise WingdError("the table has no column time, exposure_time, utc or since_boot_s")
    table = history[np.isfinite(history[column].astype(float))]
    if "s_m" in table and table["s_m"].nunique() > 1:
        raise WingdError("the moments are of several stations; select one: moments[moments.s_m == 10]")
    seconds = seconds_of(table.rename(columns={time: "time"}) if time else table)
    sampling = analyse_sampling(seconds)
    if len(table) < 16 or not np.isfinite(sampling.rate_hz):
        raise WingdError(f"{len(table)} values are too few for a spectrum; 16 are needed")
    if sampling.longest_gap_s > GAP_RATIO * 2 / sampling.rate_hz:
        raise WingdError(
            f"the history has {sampling.gaps} gaps of up to {sampling.longest_gap_s:.1f} s; select a stretch without"
        )
    rate = rate_hz or sampling.rate_hz
    grid = np.arange(seconds[0], seconds[-1] + 0.25 / rate, 1 / rate)
    values = np.interp(grid, seconds, table[column].to_numpy(dtype=float))
    length = max(len(values) * 2 // (segments + 1), 8)
    frequency, density = welch(values, fs=rate, nperseg=length, detrend="linear")
    averaged = max((len(values) - length // 2) // (length - length // 2), 1)
    # Segments that overlap by half count as 9/11 of independent ones (Welch 1967, Hann window).
    sigma = density / np.sqrt(max(averaged * 9 / 11, 1.0))
    stated = next((c for c in (f"sigma_{column}", column.replace("tip_", "tip_sigma_")) if c in table), None)
    variance = np.nan if stated is None else float(np.nanmean(table[stated].astype(float) ** 2))
    if column == "moment_nm" and "sigma_by_stiffness_nm" in table:
        # The error of the stiffness is common to all frames: a scale, not noise.
        variance -= float(np.nanmean(table["sigma_by_stiffness_nm"].astype(float) ** 2))
    noise = variance * 2 / rate
    return pd.DataFrame({"frequency_hz": frequency, "density": density, "sigma_density": sigma, "noise": noise})
