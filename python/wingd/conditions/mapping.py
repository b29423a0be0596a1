"""Mapping of a table's columns to quantities: a TOML file written by the user."""

from __future__ import annotations

import re
import tomllib
from dataclasses import dataclass, field
from datetime import date, datetime
from pathlib import Path
from typing import Any

from wingd import WingdError
from wingd.conditions.times import FORMATS, parse_date, parse_offset
from wingd.conditions.units import QUANTITIES, Conversion, check_name, find_unit
from wingd.textfiles import fault, read_text

_KEYS = {"format", "time", "time_format", "date", "year", "zone", "separator", "decimal", "column"}
_COLUMN_KEYS = {"name", "field", "quantity", "unit", "scale", "offset"}


@dataclass(frozen=True)
class MappedColumn:
    """Column of a quantity: its name in the header, or the number of its field (IWG1), and its unit."""

    quantity: str
    name: str = ""
    field: int = 0
    unit: str | None = None
    scale: float | None = None
    offset: float | None = None

    @property
    def conversion(self) -> Conversion:
        """Conversion to the unit of the quantity, by the unit or by scale and offset."""
        known = find_unit(self.quantity, self.unit) if self.unit else None
        return known if isinstance(known, Conversion) else Conversion(self.scale or 1.0, self.offset or 0.0)


@dataclass(frozen=True)
class Mapping:
    """Format of a table and its columns.

    Attributes
    ----------
    date, zone
        Date of seconds of a day and offset from UTC (s), or the name of their columns.
    """

    file: Path | str = "mapping"
    format: str = "text"
    time: str | None = None
    time_format: str = "utc"
    date: date | str | None = None
    year: int | None = None
    zone: int | str | None = None
    separator: str | None = None
    decimal: str = "."
    columns: tuple[MappedColumn, ...] = field(default=())

    @property
    def day(self) -> date | None:
        """Date of all lines, or the first of their year."""
        if isinstance(self.date, date):
            return self.date
        return date(self.year, 1, 1) if self.year else None


def read_mapping(file: Path | str) -> Mapping:
    """Read a mapping.

    Raises
    ------
    WingdError
        The file is not a mapping; the message has the key and the remedy.
    """
    text = read_text(file, 1 << 20)
    try:
        table = tomllib.loads(text)
    except (tomllib.TOMLDecodeError, RecursionError) as error:
        raise fault(file, f"is not TOML ({error})", "correct the line") from None

    def wrong(key: str, problem: str, remedy: str) -> WingdError:
        at = re.search(rf"^\s*{re.escape(key.rpartition('.')[2])}\s*=", text, re.M)
        line = text[: at.start()].count("\n") + 1 if at and "." not in key else 0
        return fault(file, problem, remedy, line=line, key=key)

    _check_keys(table, _KEYS, "", wrong)
    columns = table.get("column", [])
    if not isinstance(columns, list) or not all(isinstance(c, dict) for c in columns):
        raise wrong("column", "is not a list", "give [[column]] with name and quantity")
    words = {key: table.get(key) for key in ("format", "time", "time_format", "separator", "decimal")}
    for key, word in words.items():
        if word is not None and not (isinstance(word, str) and word):
            raise wrong(key, f"is {word!r}", "give a text in quotes")
    choices = (("format", ["text", "iwg1", "icartt"]), ("time_format", list(FORMATS)), ("decimal", [".", ","]))
    for key, known in choices:
        if words[key] is not None and words[key] not in known:
            raise wrong(key, f"is {words[key]!r}", f"give one of {', '.join(known)}")
    if words["separator"] is not None and (len(words["separator"]) != 1 or words["separator"] in '"\n\r'):
        raise wrong("separator", f"is {words['separator']!r}", "give one character")
    year = table.get("year")
    if year is not None and (isinstance(year, bool) or not isinstance(year, int) or not 1950 <= year <= 2100):
        raise wrong("year", f"is {year!r}", "give a year, such as 2026")
    day, zone = table.get("date"), table.get("zone")
    if isinstance(day, date) and not isinstance(day, datetime):
        pass
    elif isinstance(day, str):
        day = parse_date(day) or day
    elif day is not None:
        raise wrong("date", f"is {day}", 'give a date, "2026-06-01", or the name of a column')
    if zone is not None and not isinstance(zone, str):
        raise wrong("zone", f"is {zone!r}", 'give an offset, "+02:00", or the name of a column')
    offset = parse_offset(zone) if zone is not None else None
    mapping = Mapping(
        file=file, format=words["format"] or "text", time=words["time"], time_format=words["time_format"] or "utc", date=day,
        year=year, zone=zone if offset is None else offset, separator=words["separator"], decimal=words["decimal"] or ".",
        columns=tuple(_column(c, k, wrong) for k, c in enumerate(columns)),
    )  # fmt: skip
    _check_mapping(mapping, wrong)
    return mapping


def _check_keys(table: dict[str, Any], known: set[str], prefix: str, wrong: Any) -> None:
    for key in table:
        if key not in known:
            raise wrong(f"{prefix}{key}", "is not a key of a mapping", f"give some of {', '.join(sorted(known))}")


def _column(table: dict[str, Any], k: int, wrong: Any) -> MappedColumn:
    _check_keys(table, _COLUMN_KEYS, "column.", wrong)
    quantity = table.get("quantity")
    if not isinstance(quantity, str) or quantity not in QUANTITIES:
        remedy = check_name(quantity) if isinstance(quantity, str) else None
        problem = "is missing" if quantity is None else f'is "{quantity}", which is not known'
        raise wrong("column.quantity", problem, remedy or f"give one of {', '.join(QUANTITIES)}")
    for key, kind in (("name", str), ("unit", str), ("field", int), ("scale", int | float), ("offset", int | float)):
        value = table.get(key)
        if value is not None and (
            isinstance(value, bool)
            or not isinstance(value, kind)
            or value in ("", float("inf"), float("-inf"))
            or value != value
        ):
            raise wrong(f"column.{key}", f"is {value!r} for {quantity}", "give a text, or a finite number")
    scale, offset, unit = table.get("scale"), table.get("offset"), table.get("unit")
    if scale == 0:
        raise wrong("column.scale", f"is 0 for {quantity}", "give a factor")
    if unit is not None and (scale is not None or offset is not None):
        raise wrong("column.unit", f"is given with scale or offset for {quantity}", "keep one of them")
    if unit is not None and not isinstance(find_unit(quantity, unit), Conversion):
        raise wrong(
            "column.unit", f"is {unit}, which is not a known unit of {quantity}", "give scale and offset instead"
        )
    return MappedColumn(
        quantity,
        table.get("name", ""),
        table.get("field", 0),
        unit,
        None if scale is None else float(scale),
        None if offset is None else float(offset),
    )


def _check_mapping(mapping: Mapping, wrong: Any) -> None:
    iwg1, text = mapping.format == "iwg1", mapping.format == "text"
    if text and mapping.time is None:
        raise wrong("time", "is missing", 'name the column with the time, or write format = "iwg1" or "icartt"')
    if not iwg1 and not mapping.columns:
        raise wrong("column", "is missing", "give [[column]] with name and quantity")
    if mapping.time_format == "seconds_of_day" and text and mapping.date is None:
        raise wrong("date", "is missing", 'add the date of the seconds of day, date = "2026-06-01", or its column')
    if mapping.year is not None and mapping.time_format != "irig":
        raise wrong("year", "is for days of the year", 'write time_format = "irig", or delete year')
    own = mapping.time or mapping.zone is not None or mapping.separator or isinstance(mapping.date, str)
    if iwg1 and (own or mapping.decimal != "."):
        problem = "is IWG1, which defines time, zone, separator and decimal sign"
        raise wrong("format", problem, "delete time, zone, separator and decimal")
    for k, column in enumerate(mapping.columns):
        if any(column.quantity == other.quantity for other in mapping.columns[:k]):
            raise wrong("column.quantity", f"is {column.quantity} twice", "keep the valid column")
        if not iwg1 and (not column.name or column.field):
            raise wrong("column.name", f"is missing for {column.quantity}", "name the table's column")
        if iwg1 and (column.name or column.field <= 2):
            remedy = "give the number of the field; a platform's own fields begin at field = 34"
            raise wrong("column.field", f"is missing for {column.quantity}", remedy)
