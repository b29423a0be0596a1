"""Conversion of a table of aircraft data into the canonical one."""

from __future__ import annotations

import re
from dataclasses import dataclass
from datetime import date
from pathlib import Path

import numpy as np
import pandas as pd

from wingd.conditions.layout import Column, Layout, read_layout
from wingd.conditions.mapping import Mapping, read_mapping
from wingd.conditions.times import FORMATS, Window, format_time
from wingd.conditions.units import QUANTITIES
from wingd.textfiles import excerpt, fault, parse_number, read_text

#: Largest table, bytes: a line a second for a week with 50 columns has 300 MB.
MAX_TABLE_BYTES = 1 << 29
#: Largest difference of a static pressure from that of the pressure altitude, in standard deviations of both (1 hPa; 20 m
#: and 0.2 %).
MAX_PRESSURE_SIGMAS = 4.0


@dataclass(frozen=True)
class Conditions:
    """Aircraft data by time.

    Attributes
    ----------
    table
        Column ``utc`` (texts, ISO 8601, ascending, each once) and columns of quantities; NaN for missing values.
    remarks
        What was detected, omitted and not read.
    doubts
        What makes the result incomplete: lines without a time, columns without a value.
    """

    table: pd.DataFrame
    remarks: tuple[str, ...] = ()
    doubts: tuple[str, ...] = ()

    def write(self, file: Path | str) -> None:
        """Write the canonical CSV."""
        self.table.to_csv(file, index=False)


def read_conditions(
    file: Path | str, mapping: Mapping | Path | str | None = None, flight_date: date | None = None
) -> Conditions:
    """Read a table of aircraft data.

    Parameters
    ----------
    file
        Table: CSV of any separator with a header, ICARTT, or lines of IWG1.
    mapping
        Mapping of its columns, or its file; None for a canonical table.
    flight_date
        Date of the flight: times of another day are refused, with the format that would fit.

    Raises
    ------
    WingdError
        Table and mapping do not match, lines of one time differ, or no cell has a value.
    """
    if isinstance(mapping, str | Path):
        mapping = read_mapping(mapping)
    layout = read_layout(file, read_text(file, MAX_TABLE_BYTES), mapping)
    if not layout.rows:
        raise fault(file, "has no lines below its header", "export it again")
    times = [layout.time_us(row) for row in layout.rows]
    _check_times(file, layout, times, Window(flight_date))
    values, tallies = _values(layout)
    timed = [k for k, time in enumerate(times) if time is not None]
    merged = _merge(file, layout, times, values, timed)
    doubts = [
        _no_value_reason(c, t)
        for c, t in zip(layout.columns, tallies, strict=True)
        if not t.values and _is_mapped(layout, c)
    ]
    if merged[1].size == 0 or not np.isfinite(merged[1]).any():
        raise fault(file, "gives no value: " + "; ".join(doubts or ["all cells are empty"]), "correct table or mapping")
    unread = [k for k, time in enumerate(times) if time is None]
    if unread:
        first = layout.rows[unread[0]]
        doubts.insert(0, f"{len(unread)} lines without a time, line {first.line} first ({excerpt(layout.tag(first))})")
    remarks = [*layout.remarks, *_pressure_contradictions(layout, *merged)]
    if layout.unread:
        remarks.append(f"columns not read: {', '.join(layout.unread)}")
    repeated = len(timed) - len(merged[0])
    remarks += [f"{repeated} lines repeat a time with the same values"] if repeated else []
    for column, tally in zip(layout.columns, tallies, strict=True):
        other = [
            f"{n} {what}"
            for n, what in ((tally.blank, "blank"), (tally.texts, "text"), (tally.impossible, "implausible"))
            if n
        ]
        remarks += [", ".join([f"{column.quantity}: {tally.values} values", *other])] if tally.values else []
    table = pd.DataFrame({"utc": [format_time(t) for t in merged[0]]})
    for k, column in enumerate(layout.columns):
        if np.isfinite(merged[1][:, k]).any():
            table[column.quantity] = merged[1][:, k]
    return Conditions(table, tuple(remarks), tuple(doubts))


@dataclass
class _Tally:
    values: int = 0
    blank: int = 0
    impossible: int = 0
    first_impossible: float | None = None
    texts: int = 0
    first_text: str = ""


def _is_mapped(layout: Layout, column: Column) -> bool:
    return any(column.quantity == mapped.quantity for mapped in layout.mapping.columns)


def _values(layout: Layout) -> tuple[np.ndarray, list[_Tally]]:
    values, tallies = np.full((len(layout.rows), len(layout.columns)), np.nan), []
    for k, column in enumerate(layout.columns):
        tally = _Tally()
        for n, row in enumerate(layout.rows):
            value = layout.value(row, column)
            if isinstance(value, float):
                values[n, k] = value
                tally.values += 1
            elif isinstance(value, str):
                tally.texts += 1
                tally.first_text = tally.first_text or value
            else:
                number = parse_number(row.cells[column.index])
                if number is None or number in layout.missing:
                    tally.blank += 1
                else:
                    tally.impossible += 1
                    if tally.first_impossible is None:
                        tally.first_impossible = column.conversion.scale * number + column.conversion.offset
        tallies.append(tally)
    return values, tallies


def _check_times(file: Path | str, layout: Layout, times: list[int | None], window: Window) -> None:
    """Refuse times of another format, and days that begin again within a table."""
    known = [t for t in times if t is not None]
    tags = [layout.tag(row) if layout.date is None else row.cells[layout.time] for row in layout.rows]
    mapping = layout.mapping
    zone_s = mapping.zone if isinstance(mapping.zone, int) else 0
    if 2 * sum(window.holds(t) for t in known) <= len(times):
        guesses = window.guess_formats(tags, mapping.time_format, zone_s)
        what = "in an unsupported format" if not known else f"{format_time(min(known))} to {format_time(max(known))}"
        problem = f"its times ({excerpt(tags[0])}) are {what}, read as {FORMATS[mapping.time_format]}"
        remedy = (
            "write in the mapping " + " or ".join(guesses)
            if guesses
            else "write them as 2026-06-01T07:59:50Z, or name the table of this flight"
        )
        raise fault(file, problem, remedy)
    wrong = next((k for k, t in enumerate(times) if t is not None and not window.holds(t)), None)
    if wrong is not None:
        problem = f"has the time {excerpt(tags[wrong])}, {format_time(times[wrong] or 0)}"
        raise fault(file, problem, "correct the line", line=layout.rows[wrong].line)
    if mapping.time_format == "seconds_of_day" and layout.date is None:
        for k in range(1, len(known)):
            if known[k - 1] - known[k] > 43_200_000_000:
                problem = "the seconds of the day restart at midnight"
                raise fault(file, problem, "give one table per day, each with its date", line=layout.rows[k].line)


def _merge(
    file: Path | str, layout: Layout, times: list[int | None], values: np.ndarray, timed: list[int]
) -> tuple[list[int], np.ndarray]:
    """Sort lines by their time and merge those of one time; different values are an error."""
    order = sorted(timed, key=lambda k: times[k] or 0)
    merged_times: list[int] = []
    merged: list[np.ndarray] = []
    last = -1
    for k in order:
        time = times[k] or 0
        if merged_times and merged_times[-1] == time:
            differs = np.isfinite(merged[-1]) & np.isfinite(values[k]) & (merged[-1] != values[k])
            if differs.any():
                column = layout.columns[int(np.argmax(differs))]
                a, b = merged[-1][differs][0], values[k][differs][0]
                lines = sorted((layout.rows[last].line, layout.rows[k].line))
                problem = f"lines {lines[0]} and {lines[1]} have the time {format_time(time)} and different {column.quantity} ({a:.9g}, {b:.9g})"
                raise fault(file, problem, "keep the valid line")
            merged[-1] = np.where(np.isfinite(merged[-1]), merged[-1], values[k])
        else:
            merged_times.append(time)
            merged.append(values[k].copy())
        last = k
    return merged_times, np.array(merged).reshape(-1, len(layout.columns))


def _pressure_contradictions(layout: Layout, times: list[int], values: np.ndarray) -> list[str]:
    """Return a remark if the static pressure contradicts the pressure altitude, which is derived from it."""
    names = [column.quantity for column in layout.columns]
    if not {"static_pressure_hpa", "pressure_altitude_m"} <= set(names):
        return []
    pressure, altitude = (values[:, names.index(n)] for n in ("static_pressure_hpa", "pressure_altitude_m"))
    expected = _standard_pressure(altitude)
    by_altitude = (_standard_pressure(altitude + 1) - expected) * np.hypot(20.0, 0.002 * altitude)
    wrong = np.abs(pressure - expected) > MAX_PRESSURE_SIGMAS * np.hypot(1.0, by_altitude)
    if not wrong.any():
        return []
    k = int(np.argmax(wrong))
    return [
        f"static_pressure_hpa contradicts pressure_altitude_m at {wrong.sum()} times, {format_time(times[k])} first: "
        f"{pressure[k]:.1f} hPa at {altitude[k]:.0f} m, where the pressure is {expected[k]:.1f} hPa; correct their units"
    ]


def _standard_pressure(altitude_m: np.ndarray) -> np.ndarray:
    """Return the pressure of the standard atmosphere (ISO 2533) up to 20 km, hPa."""
    low = 1013.25 * np.maximum(1 - 2.25577e-5 * altitude_m, 0) ** 5.25588
    return np.where(altitude_m < 11_000, low, 226.321 * np.exp((11_000 - altitude_m) / 6341.62))


def _no_value_reason(column: Column, tally: _Tally) -> str:
    """Return why a column has no value."""
    name, text = column.quantity, tally.first_text
    if text:
        groups = text.lstrip("+-").split(",")
        is_thousands = (
            len(groups) > 1
            and 1 <= len(groups[0]) <= 3
            and groups[0][:1] != "0"
            and all(len(g.partition(".")[0]) == 3 for g in groups[1:])
        )
        if text.startswith("="):
            return f"{name} has formulas ({text[:40]}); save the values"
        if "," not in text and "." not in text or not re.fullmatch(r"[+-]?[\d.,]*\d[\d.,]*([eE][+-]?\d+)?", text):
            return f"{name} has texts instead of numbers ({text[:40]}); save plain numbers, or name another column"
        if is_thousands:
            return f'{name} has commas that separate thousands, or decimals ({text}); save its numbers without thousands, or write decimal = "," in the mapping'
        if "." not in text:
            return f'{name} has decimal commas ({text}); write decimal = "," in the mapping'
        return (
            f"{name} has points and decimal commas ({text}); save its numbers without thousands, with one decimal sign"
        )
    if tally.first_impossible is not None:
        low, high = QUANTITIES[name].low, QUANTITIES[name].high
        return f"{name} cannot be {tally.first_impossible:.6g}, only {low:g} to {high:g}; correct the mapping's scale, or name another column"
    return f"the column of {name} is empty; name another"
