"""Modes of a wing from an export of live results: frequency, damping and shape with standard deviations, window by window.

Stochastic subspace identification is by pyOMA2. Standard deviations are from a jackknife over blocks of time (Kuensch, 1989, The
jackknife and the bootstrap for general stationary observations, Annals of Statistics 17): the standard deviations that pyOMA2
propagates were 3 to 4 times too small for frequencies in simulations (docs/fleet/modes.md).
"""

from __future__ import annotations

import logging
import os
import re
from dataclasses import dataclass
from pathlib import Path

import pandas as pd

from wingd import WingdError
from wingd.store import read_table

# Progress bars of pyOMA2 are for notebooks.
os.environ.setdefault("TQDM_DISABLE", "1")

try:
    import numpy as np
    from pyoma2.algorithms.ssi import SSI
    from pyoma2.setup.single import SingleSetup
    from scipy.interpolate import CubicSpline
except ImportError as missing:
    raise WingdError(f"{missing.name} is not installed; pip install 'wingd[modes]'") from None

# pyOMA2 logs each step of each run.
logging.getLogger("pyoma2").setLevel(logging.ERROR)
# Number of points of the shape: the curve has about ten terms, so more points add no information.
POINTS = 6
# Number of blocks that the jackknife omits in turn.
BLOCKS = 12
# Orders of the state-space model: two per mode, the rest for the gust spectrum and noise.
ORDERS = range(4, 17, 2)
# A pole is stable if higher orders reproduce it: maximum relative differences of frequency and damping, minimum MAC.
STABLE = (0.02, 0.3, 0.98)
# Criteria for the same mode in two orders or two parts of the data: maximum relative frequency difference, minimum MAC.
SAME = (0.1, 0.8)
# Criteria for a duplicate pole, whose shape is similar to that of a mode: maximum relative frequency difference, minimum MAC.
DUPLICATE = (0.5, 0.95)
# Maximum damping of a wing mode in air, and minimum modal phase collinearity: all points move in phase or in antiphase.
MOST_DAMPING, LEAST_COLLINEARITY = 0.3, 0.8
# Maximum relative standard deviation of frequency and of shape; a less precise mode is not reported.
MOST_SIGMA, MOST_SIGMA_SHAPE = 0.05, 0.3
# Consecutive missing results that are interpolated; a longer gap splits the data.
BRIDGED = 3
# Minimum fraction of a window with data.
LEAST_SHARE = 0.2
WHOSE = ("recorder_id", "flight", "boot_id", "program", "installation_sha256", "inputs")


@dataclass
class Mode:
    """Frequency in Hz, damping ratio, shape per point with 1 at the outermost; and their standard deviations."""

    hz: float
    damping: float
    shape: np.ndarray
    sigma_hz: float = 0.0
    sigma_damping: float = 0.0
    sigma_shape: np.ndarray | None = None


def mac(one: np.ndarray, other: np.ndarray) -> float:
    """Return the modal assurance criterion of two shapes, 0 to 1."""
    return float(abs(np.vdot(one, other)) ** 2 / (np.vdot(one, one).real * np.vdot(other, other).real))


def read(path: Path) -> pd.DataFrame:
    """Read an export of live results; the file extension determines the format."""
    if path.suffix not in (".parquet", ".csv", ".jsonl"):
        raise WingdError(
            f"{path}: has none of the extensions .parquet, .csv, .jsonl; create it with wingd export --table live"
        )
    try:
        return read_table(path)
    except ValueError as error:
        raise WingdError(f"{path}: cannot be read: {error}; create it with wingd export --table live") from None


def points(names: list[str], kind: str) -> dict[str, str]:
    """Return label -> deflection column of the stations (`deflection_s01_m`) or of the markers."""
    label = re.compile(r"deflection_(.+)_m")
    all_of = {match[1]: name for name in names if (match := label.fullmatch(name))}
    if kind == "stations":
        wanted = {name for name in all_of if re.fullmatch(r"s\d\d", name) and f"arc_length_{name}_m" in names}
    else:
        wanted = {name for name in all_of if f"u_{name}_px" in names}
    if len(wanted) < 2:
        raise WingdError(
            f"the export has no deflections of {kind}; create it with wingd export --table live of this version"
        )
    return {name: all_of[name] for name in sorted(wanted)}


def _poles(deflections: np.ndarray, rate_hz: float, lowest_hz: float) -> dict[int, list[Mode]]:
    """Return candidate modes by model order."""
    rows = max(10, round(2 * rate_hz / lowest_hz))
    setup = SingleSetup(deflections, rate_hz)
    run = SSI(name="live", method="dat", br=rows, ordmin=ORDERS[0], ordmax=ORDERS[-1], step=2)
    setup.add_algorithms(run)
    setup.run_by_name("live")
    found = run.result
    return {order: _of_order(found, order // 2, rate_hz, lowest_hz) for order in ORDERS}


def _of_order(found, column: int, rate_hz: float, lowest_hz: float) -> list[Mode]:
    modes = []
    for row in range(found.Fn_poles.shape[0]):
        hz, damping, shape = found.Fn_poles[row, column], found.Xi_poles[row, column], found.Phi_poles[row, column]
        if not (np.isfinite(hz) and lowest_hz <= hz < 0.5 * rate_hz and 0 < damping < MOST_DAMPING):
            continue
        if np.all(np.isfinite(shape)) and _collinearity(shape) >= LEAST_COLLINEARITY:
            modes.append(Mode(float(hz), float(damping), _real(shape)))
    return modes


def _collinearity(shape: np.ndarray) -> float:
    """Return the modal phase collinearity: 1 if all points move in phase or antiphase, 0 if their phases are spread."""
    x, y = shape.real, shape.imag
    both = np.array([[x @ x, x @ y], [x @ y, y @ y]])
    least, most = np.linalg.eigvalsh(both)
    return float(((most - least) / (most + least)) ** 2)


def _real(shape: np.ndarray) -> np.ndarray:
    """Return the real shape in the phase of maximum amplitude, normalised to 1 at the outermost point."""
    turned = (shape * np.exp(-0.5j * np.angle(np.sum(shape**2)))).real
    return turned / turned[-1] if turned[-1] else turned


def _stable(poles: dict[int, list[Mode]]) -> list[tuple[int, Mode]]:
    """Return modes that at least two of the next three orders reproduce, with their order."""
    far, damped, min_mac = STABLE
    accepted = []
    for order in ORDERS[:-2]:
        for mode in poles[order]:
            again = 0
            for further in (one for one in ORDERS if order < one <= order + 6):
                near = [
                    other.damping
                    for other in poles[further]
                    if abs(other.hz / mode.hz - 1) < far and mac(other.shape, mode.shape) > min_mac
                ]
                # A mode may split into poles of which one has too little damping and the other too much.
                again += (
                    bool(near) and min(near) < (1 + damped) * mode.damping and max(near) > (1 - damped) * mode.damping
                )
            if again >= 2:
                accepted.append((order, mode))
    return accepted


def _same(one: Mode, other: Mode, within: tuple[float, float] = SAME) -> bool:
    far, min_mac = within
    return abs(one.hz / other.hz - 1) < far and mac(one.shape, other.shape) > min_mac


def _again(poles: dict[int, list[Mode]], order: int, mode: Mode) -> Mode | None:
    """Find the mode in a part of the data, at its order or at the first higher order that has it."""
    for further in range(order, ORDERS[-1] + 1, 2):
        if same := [one for one in poles[further] if _same(one, mode)]:
            return max(same, key=lambda one: mac(one.shape, mode.shape))
    return None


def identify(deflections: np.ndarray, rate_hz: float, lowest_hz: float, count: int) -> list[Mode]:
    """Identify the first `count` modes of deflections, m: rows at equal intervals, columns from the root outwards."""
    # Differences have the same poles and shapes; in the deflections, the first mode and manoeuvres mask the other modes.
    deflections = np.diff(deflections[:, deflections.std(axis=0) > 0], 2, axis=0)
    deflections = deflections - deflections.mean(axis=0)
    stable = _stable(_poles(deflections, rate_hz, lowest_hz))
    parts = np.array_split(np.arange(len(deflections)), BLOCKS)
    without = [_poles(np.delete(deflections, part, axis=0), rate_hz, lowest_hz) for part in parts] if stable else []
    measured = [mode for order, mode in stable if _measure(mode, order, without)]
    modes: list[Mode] = []
    # If several orders have a mode, the most precise one is used; a nearby pole with a similar shape is a duplicate.
    for mode in sorted(measured, key=lambda one: one.sigma_hz / one.hz):
        if not any(_same(one, mode) or _same(one, mode, DUPLICATE) for one in modes):
            modes.append(mode)
    return sorted(modes, key=lambda one: one.hz)[:count]


def _measure(mode: Mode, order: int, without: list[dict[int, list[Mode]]]) -> bool:
    """Set a mode's standard deviations from the parts of the data; returns whether all parts have it and it is precise enough."""
    found = [_again(one, order, mode) for one in without]
    if None in found:
        return False

    def sigma(value_of):
        values = np.array([value_of(one) for one in found])
        return np.sqrt((BLOCKS - 1) / BLOCKS * ((values - values.mean(axis=0)) ** 2).sum(axis=0))

    mode.sigma_hz, mode.sigma_damping = float(sigma(lambda m: m.hz)), float(sigma(lambda m: m.damping))
    mode.sigma_shape = sigma(lambda m: m.shape)
    unsure = np.linalg.norm(mode.sigma_shape) / np.linalg.norm(mode.shape)
    return mode.sigma_hz < MOST_SIGMA * mode.hz and unsure < MOST_SIGMA_SHAPE


def even(times_s: np.ndarray, deflections: np.ndarray) -> list[tuple[np.ndarray, np.ndarray, float, int]]:
    """Split at long gaps and interpolates to equal intervals: times in s, deflections, rate in Hz, number of missing results."""
    order = np.argsort(times_s)
    times_s, deflections = times_s[order], deflections[order]
    step = np.diff(times_s, prepend=-np.inf) > 0
    times_s, deflections = times_s[step], deflections[step]
    if len(times_s) < 2:
        return []
    interval = float(np.median(np.diff(times_s)))
    ends = np.flatnonzero(np.diff(times_s) > (BRIDGED + 1.5) * interval) + 1
    pieces = []
    for part in np.split(np.arange(len(times_s)), ends):
        if len(part) < 4:
            continue
        own = times_s[part]
        grid = np.arange(own[0], own[-1], interval)
        pieces.append((grid, CubicSpline(own, deflections[part])(grid), 1 / interval, max(0, len(grid) - len(part))))
    return pieces


def _aircraft(content: pd.DataFrame) -> dict[str, float]:
    """Return means of the aircraft data, with standard deviations from the scatter in the window and the data's own sigma."""
    said = {}
    for name in AIRCRAFT:
        if name in content:
            own = (content[f"sigma_{name}"] ** 2).mean() if f"sigma_{name}" in content else 0.0
            said |= {name: content[name].mean()}
            said[f"sigma_{name}"] = np.sqrt(np.nan_to_num(own) + content[name].var(ddof=0))
    return said


AIRCRAFT = (
    "mach", "pressure_altitude_m", "static_temperature_c", "static_pressure_hpa", "weight_kg", "fuel_kg", "load_factor", "flap_deg",
)  # fmt: skip


def rows(content: pd.DataFrame, seconds: float, lowest_hz: float, count: int, kind: str) -> list[dict]:
    """Return a row for each mode in each window of `seconds` s."""
    if seconds * lowest_hz < 20:
        raise WingdError(
            f"--seconds {seconds:g}: is less than 20 periods of {lowest_hz:g} Hz; give more, or a higher --lowest-hz"
        )
    whose = [name for name in WHOSE if name in content]
    groups = content.groupby(whose, dropna=False, sort=False) if whose else [((), content)]
    return [
        {**dict(zip(whose, key, strict=True)), **row}
        for key, own in groups
        for row in _rows(own, seconds, lowest_hz, count, kind)
    ]


def _seconds(content: pd.DataFrame) -> np.ndarray:
    """Return the times of the exposures, s: since boot if available, because clock corrections do not affect it."""
    if "since_boot_s" in content:
        return content["since_boot_s"].to_numpy(dtype=float)
    if "exposure_time" in content:
        return ((content["exposure_time"] - pd.Timestamp(0, tz="UTC")) / pd.Timedelta(seconds=1)).to_numpy()
    raise WingdError("the export lacks since_boot_s and exposure_time; create it with wingd export --table live")


def _rows(content: pd.DataFrame, seconds: float, lowest_hz: float, count: int, kind: str) -> list[dict]:
    columns = points(list(content), kind)
    deflections = content[list(columns.values())].to_numpy(dtype=float)
    times = _seconds(content)
    # Points of another installation in the same table are empty here.
    there = np.isfinite(deflections).any(axis=0)
    labels, deflections = (
        [label for label, is_there in zip(columns, there, strict=False) if is_there],
        deflections[:, there],
    )
    whole = np.isfinite(times) & np.isfinite(deflections).all(axis=1)
    moving = [k for k in range(len(labels)) if deflections[whole, k].std() > 0] if whole.any() else []
    if len(moving) < 2:
        return []
    chosen = [moving[k] for k in sorted({round(k) for k in np.linspace(0, len(moving) - 1, min(POINTS, len(moving)))})]
    found = []
    for grid, even_deflections, rate_hz, missing in even(times[whole], deflections[whole][:, chosen]):
        windows = max(1, int((grid[-1] - grid[0] + 0.5) // seconds))
        for part in np.array_split(np.arange(len(grid)), windows):
            if len(part) < LEAST_SHARE * seconds * rate_hz:
                continue
            began, ended = grid[part[0]], grid[part[-1]]
            inside = content[(times >= began) & (times <= ended)]
            about = _about(inside, began, ended, rate_hz, missing / len(grid), len(chosen))
            arcs = {labels[k]: _arc(inside, labels[k]) for k in chosen}
            try:
                modes = identify(even_deflections[part], rate_hz, lowest_hz, count)
            except np.linalg.LinAlgError as error:
                raise WingdError(f"{about['began']}: {error}; take a higher --lowest-hz or longer --seconds") from None
            for number, mode in enumerate(modes, 1):
                found.append({**about, **_numbers(number, mode, arcs), **_aircraft(inside)})
    return found


def _arc(content: pd.DataFrame, label: str) -> float | None:
    name = f"arc_length_{label}_m"
    return content[name].mean() if name in content else None


def _about(content: pd.DataFrame, began: float, ended: float, rate_hz: float, missing: float, count: int) -> dict:
    moment = next((name for name in ("exposure_time", "utc") if name in content), None)
    return {
        "began": content[moment].min() if moment else None,
        "ended": content[moment].max() if moment else None,
        "seconds": round(ended - began, 3),
        "results": len(content),
        "rate_hz": round(rate_hz, 4),
        "missing_share": round(missing, 4),
        "points": count,
    }


def _numbers(number: int, mode: Mode, arcs: dict[str, float | None]) -> dict:
    row = {
        "mode": number,
        "frequency_hz": mode.hz,
        "sigma_frequency_hz": mode.sigma_hz,
        "damping": mode.damping,
        "sigma_damping": mode.sigma_damping,
    }
    for k, (label, arc) in enumerate(arcs.items()):
        row[f"shape_{label}"], row[f"sigma_shape_{label}"] = float(mode.shape[k]), float(mode.sigma_shape[k])
        if arc is not None:
            row[f"arc_length_{label}_m"] = arc
    return row


def write(found: list[dict], output: Path | None, stream) -> None:
    """Write CSV, or the format given by the output's extension."""
    table = pd.DataFrame(found)
    if output is not None and output.suffix == ".parquet":
        table.to_parquet(output, index=False)
    elif output is None or output.suffix == ".csv":
        table.to_csv(output or stream, index=False)
    else:
        raise WingdError(f"{output}: give a name with the extension .csv or .parquet")


def run(
    exports: list[Path], seconds: float, lowest_hz: float, count: int, kind: str, output: Path | None, stream
) -> int:
    """Run the command; raises WingdError if no mode was found."""
    found = []
    for path in exports:
        found += rows(read(path), seconds, lowest_hz, count, kind)
    if not found:
        raise WingdError(
            f"no mode above {lowest_hz:g} Hz in windows of {seconds:g} s; try longer windows, a higher rate of live results, or data from rougher air"
        )
    write(found, output, stream)
    return 0
