"""Rows of a table: separator, header, records, and what the table says of its units, dates and zones."""

from __future__ import annotations

import re
from collections import Counter
from dataclasses import dataclass, field, replace
from datetime import date
from pathlib import Path

from wingd import WingdError
from wingd.conditions.mapping import MappedColumn, Mapping
from wingd.conditions.times import parse_date, parse_hours, parse_offset, parse_time
from wingd.conditions.units import QUANTITIES, Conversion, check_name, find_unit, unit_in_name
from wingd.textfiles import Row, fault, parse_number, split_rows

_SEPARATORS = (",", ";", "\t", "|")
_NAMES = {",": "commas", ";": "semicolons", "\t": "tabs", "|": "bars"}
#: Rows in which the header is looked for, and rows below it that may be units.
_MAX_HEADER_ROW, _MAX_UNIT_ROWS = 500, 3
#: Fields of IWG1 that are read (www.eol.ucar.edu/raf/Software/IWG1_Def.html), each with a word of its name there.
_IWG1 = (
    (7, "pressure_altitude_m", 0.3048, "alt"), (10, "true_airspeed_m_s", 1.0, "true"), (12, "mach", 1.0, "mach"),
    (19, "sideslip_deg", 1.0, "slip"), (20, "angle_of_attack_deg", 1.0, "att"), (21, "static_temperature_c", 1.0, "temp"),
    (23, "total_temperature_c", 1.0, "temp"), (24, "static_pressure_hpa", 1.0, "press"), (26, "cabin_pressure_hpa", 1.0, "press"),
)  # fmt: skip


@dataclass
class Column:
    """Column that is read: index of its cells, quantity, conversion, and its name in the table."""

    index: int
    quantity: str
    conversion: Conversion
    name: str


@dataclass
class Layout:
    """Positions of the cells of a record, and the format of its time.

    Attributes
    ----------
    rows
        Records below the header.
    time, date, zone
        Index of their cells; None: the mapping's value.
    unread
        Names of the columns that are not read.
    """

    mapping: Mapping
    rows: list[Row]
    time: int
    columns: list[Column]
    date: int | None = None
    zone: int | None = None
    missing: frozenset[float] = frozenset()
    unread: list[str] = field(default_factory=list)
    remarks: list[str] = field(default_factory=list)

    def time_us(self, row: Row, zone_s: int | None = None) -> int | None:
        """Return the time of a record, microseconds since 1970."""
        day = self.mapping.day if self.date is None else parse_date(row.cells[self.date])
        if self.date is not None and day is None:
            return None
        if zone_s is None:
            stated = self.mapping.zone if isinstance(self.mapping.zone, int) else 0
            zone_s = stated if self.zone is None else parse_hours(row.cells[self.zone])
        return None if zone_s is None else parse_time(row.cells[self.time], self.mapping.time_format, day, zone_s)

    def tag(self, row: Row) -> str:
        """Return the cells of a record's time as text."""
        return " ".join(row.cells[k] for k in (self.date, self.time, self.zone) if k is not None)

    def value(self, row: Row, column: Column) -> float | str | None:
        """Return a value in the unit of its quantity; None for a blank or impossible cell, else its text."""
        text = row.cells[column.index]
        if not text:
            return None
        if self.mapping.decimal == ",":
            # With decimal commas a point may separate thousands or be a decimal point.
            number = parse_number(text.replace(",", ".")) if "." not in text else None
        else:
            number = parse_number(text)
        if number is None:
            return text if text.lower() not in ("nan", "inf", "-inf") else None
        if number in self.missing:
            return None
        value = column.conversion.scale * number + column.conversion.offset
        low, high = QUANTITIES[column.quantity].low, QUANTITIES[column.quantity].high
        return value if low <= value <= high else None


def read_layout(file: Path | str, text: str, mapping: Mapping | None) -> Layout:
    """Find header and records of a table; without a mapping it is the canonical table.

    Raises
    ------
    WingdError
        The table does not have the columns of the mapping, or says otherwise of units, dates or zones.
    """
    if mapping is not None and mapping.format == "iwg1":
        return _iwg1(file, text, mapping)
    if mapping is None:
        mapping = _canonical(file, text)
    head = _IcarttHead.read(text)
    if mapping.format == "icartt":
        if head is None:
            remedy = 'delete format = "icartt" from the mapping, or save the file with its head'
            raise fault(file, "is not the first line of an ICARTT file of format 1001", remedy, line=1)
        mapping = head.complete(mapping)
    separator, rows, at, remarks = _find_header(file, text, mapping)
    header = rows[at]
    if at:
        remarks.append(f"omitted before the header: {at} lines")
    layout = _locate(file, mapping, header, remarks)
    if head is not None:
        layout.missing = frozenset(missing for *_, missing in head.variables.values())
        for column in layout.columns:
            factor = head.variables.get(column.name, ("", 1.0, 0.0))[1]
            column.conversion = Conversion(column.conversion.scale * factor, column.conversion.offset)
        _check_date(file, mapping, 7, "", head.day)
    _check_units(file, layout, rows[:at], header, mapping)
    layout.rows = _records(file, layout, header, rows[at + 1 :], mapping)
    for row in layout.rows[:1] + layout.rows[-1:]:
        _check_date_and_zone(file, layout, header, row)
    return layout


def _canonical(file: Path | str, text: str) -> Mapping:
    """Return the mapping of a canonical table: ``utc`` and columns named with their units."""
    header = split_rows(file, text.split("\n", 1)[0])
    names = header[0].cells if header else []
    for name in names:
        remedy = "write utc" if name != "utc" and name.lower() == "utc" else check_name(name)
        if remedy:
            raise fault(file, "is almost the name of a quantity", f"{remedy}, or give --mapping", line=1, key=name)
    columns = tuple(MappedColumn(name, name) for name in names if name in QUANTITIES)
    if "utc" not in names or not columns:
        problem = f"is not the header of a canonical table ({', '.join(names[:8])})"
        raise fault(file, problem, "give --mapping, or write utc and columns such as mach, weight_kg", line=1)
    return Mapping(file=file, time="utc", separator=",", columns=columns)


def _iwg1(file: Path | str, text: str, mapping: Mapping) -> Layout:
    """Read lines of IWG1, with or without a header, and joined if a line end was lost."""
    records: list[Row] = []
    remarks: list[str] = []
    glued: list[int] = []
    for line, content in enumerate(text.split("\n"), 1):
        if content.startswith("HEADER,"):
            names = [cell.strip() for cell in content.split(",")]
            for field_, quantity, _, word in _IWG1:
                if field_ <= len(names) and word not in names[field_ - 1].lower():
                    remarks.append(
                        f'line {line} names field {field_} "{names[field_ - 1]}", which is read as {quantity}'
                    )
            continue
        parts = re.split(r"(?<!^)(?=IWG1,)", content) if re.match(r'\s*"?IWG1"?\s*,', content) else [content]
        glued += [line] * (len(parts) > 1)
        records += [Row(line, [cell.strip().strip('"') for cell in part.split(",")]) for part in parts if part.strip()]
    is_record = [row.cells[0] == "IWG1" for row in records]
    if not any(is_record):
        raise fault(file, "has no line of IWG1", 'delete format = "iwg1" from the mapping, and name the columns')
    if glued:
        remarks.append(
            f"{len(glued)} lines have several records without a line end between them, line {glued[0]} first; they were split"
        )
    kept = [row for row, found in zip(records, is_record, strict=True) if found]
    other = next((row for row, found in zip(records, is_record, strict=True) if not found), None)
    if other is not None:
        remarks.append(f"omitted: lines without the keyword IWG1, line {other.line} first")
    width = Counter(len(row.cells) for row in kept).most_common(1)[0][0]
    odd = [row for row in kept if len(row.cells) != width]
    if odd:
        remarks.append(
            f"omitted: {len(odd)} records that do not have {width} fields like most, line {odd[0].line} first"
        )
    own = [(c.field, c.quantity, c.conversion) for c in mapping.columns]
    fixed = [(f, q, Conversion(s, 0.0)) for f, q, s, _ in _IWG1 if q not in {q for _, q, _ in own}]
    for field_, quantity, _ in own:
        if field_ > width:
            raise fault(
                mapping.file,
                f"is field {field_} for {quantity}, but the records have {width}",
                "correct the number",
                key="column.field",
            )
    columns = [Column(f - 1, q, c, f"field {f}") for f, q, c in fixed + own if f <= width]
    return Layout(mapping, [row for row in kept if len(row.cells) == width], 1, columns, remarks=remarks)


@dataclass(frozen=True)
class _IcarttHead:
    """Head of an ICARTT file (ICARTT File Format Standards 2.0): date, time, and unit, factor and missing value by name."""

    day: date
    time: str
    variables: dict[str, tuple[str, float, float]]

    @classmethod
    def read(cls, text: str) -> _IcarttHead | None:
        lines = [[cell.strip() for cell in line.split(",")] for line in text.split("\n", 700)[:700]]
        try:
            if lines[0][1] != "1001":
                return None
            length, day = int(lines[0][0]), date(*map(int, lines[6][:3]))
            numbers = [[parse_number(cell) for cell in lines[k]] for k in (10, 11)]
            defined = lines[12:length]
            variables = {
                cells[0]: (cells[1] if len(cells) > 1 else "", float(factor), float(missing))  # type: ignore[arg-type]
                for cells, factor, missing in zip(defined, *numbers, strict=False)
            }
        except (IndexError, ValueError, TypeError):
            return None
        return cls(day, lines[8][0], variables)

    def complete(self, mapping: Mapping) -> Mapping:
        """Complete a mapping by the time, the date and the units that it does not give."""
        columns = []
        for column in mapping.columns:
            unit = self.variables.get(column.name, ("", 1.0, 0.0))[0]
            given = column.unit is not None or column.scale is not None or column.offset is not None
            columns.append(column if given or not unit else replace(column, unit=unit))
        time, form = (self.time, "seconds_of_day") if mapping.time is None else (mapping.time, mapping.time_format)
        return replace(mapping, time=time, time_format=form, date=mapping.date or self.day, columns=tuple(columns))


def _find_header(file: Path | str, text: str, mapping: Mapping) -> tuple[str, list[Row], int, list[str]]:
    """Split a text by its separator; the header is the first row with the time and most of the mapping's columns."""
    first = text.split("\n", 1)[0]
    stated = re.fullmatch(r'"?sep=(.)"?', first.strip(" "))
    given = mapping.separator or (stated[1] if stated else None)
    best: tuple[int, str, list[Row], int] | None = None
    error: WingdError | None = None
    for separator in (given,) if given else _SEPARATORS:
        try:
            rows = split_rows(file, text, separator)
        except WingdError as found:
            error = error or found
            continue
        for k, row in enumerate(rows[:_MAX_HEADER_ROW]):
            if mapping.time in row.cells:
                count = sum(column.name in row.cells for column in mapping.columns)
                if best is None or count > best[0]:
                    best = (count, separator, rows, k)
    if best is None:
        raise error or _missing_header(file, text, mapping, given)
    _, separator, rows, at = best
    remarks = (
        [f"its columns are separated by {_NAMES.get(separator, separator)}"] if not given and separator != "," else []
    )
    return separator, rows, at, remarks


def _missing_header(file: Path | str, text: str, mapping: Mapping, given: str | None) -> WingdError:
    lines = [line for line in text.split("\n") if line.strip()][:_MAX_HEADER_ROW]
    first = lines[0].strip()[:80] if lines else ""
    if first.lstrip('"').startswith("IWG1"):
        return fault(file, "is a line of IWG1, not a header", 'write format = "iwg1" in the mapping', line=1)
    for separator in _SEPARATORS:
        if separator != given and any(mapping.time in [c.strip(' "') for c in line.split(separator)] for line in lines):
            problem = f"is {given!r}, but the table is separated by {_NAMES[separator]}"
            return fault(mapping.file, problem, f"write separator = {separator!r}, or delete it", key="separator")
    if any(mapping.time in line.split() for line in lines):
        return fault(
            file, "has columns that are separated by blanks", "save it with commas, semicolons or tabs", line=1
        )
    return fault(mapping.file, f"no line has the column {mapping.time}", f"the first line is: {first}", key="time")


def _locate(file: Path | str, mapping: Mapping, header: Row, remarks: list[str]) -> Layout:
    names = header.cells

    def place(name: str) -> int:
        if names.count(name) > 1:
            raise fault(file, "occurs twice in the header", "keep the valid column", line=header.line, key=name)
        if name not in names:
            there = ", ".join(filter(None, names))
            raise fault(mapping.file, "is not a column of the table", f"its header has {there}", key=name)
        return names.index(name)

    def stated(key: str, example: str) -> int | None:
        name = getattr(mapping, key)
        if not isinstance(name, str):
            return None
        if name not in names:
            problem = f'"{name}" is not a {key} and not a column of the table'
            raise fault(
                mapping.file, problem, f"write {example}, or a column: {', '.join(filter(None, names))}", key=key
            )
        return place(name)

    columns = [Column(place(c.name), c.quantity, c.conversion, c.name) for c in mapping.columns]
    time, day, zone = place(mapping.time or ""), stated("date", "2026-06-01"), stated("zone", "+02:00")
    read = {time, day, zone, *(column.index for column in columns)}
    unread = [name for k, name in enumerate(names) if k not in read and name]
    return Layout(mapping, [], time, columns, day, zone, unread=unread, remarks=remarks)


def _check_unit(file: Path | str, column: MappedColumn, unit: str, line: int, remarks: list[str]) -> None:
    """Check a unit that the table names against the mapping."""
    found, own = find_unit(column.quantity, unit), column.conversion
    if found == "absent" or (isinstance(found, Conversion) and own.same_unit(found)):
        return
    if found == "unknown":
        remarks.append(f"the unit {unit} of {column.quantity} is unknown: the mapping's scale is used")
        return
    if isinstance(found, Conversion):
        stated = f'unit = "{column.unit}": ' if column.unit else ""
        problem = f"is in {unit}, but the mapping converts it to {column.quantity} by {stated}scale = {own.scale:g}, offset = {own.offset:g}"
        remedy = f'write scale = {found.scale:.9g}, offset = {found.offset:.9g}, or unit = "{unit}"'
        raise fault(file, problem, remedy, line=line, key=column.name)
    problem = f"is in {unit}, which is not a unit of {column.quantity}"
    raise fault(file, problem, "name the column of that quantity", line=line, key=column.name)


def _check_units(file: Path | str, layout: Layout, above: list[Row], header: Row, mapping: Mapping) -> None:
    """Check units in the names of columns and above the header: rows of units or long names, or a line for each column."""
    for named, column in zip(mapping.columns, layout.columns, strict=True):
        unit = unit_in_name(named.quantity, named.name) if named.name not in QUANTITIES else None
        # A name that is a unit may mean something else: a stated unit decides.
        if unit is not None and not (unit == named.name and named.unit):
            _check_unit(file, named, unit, header.line, layout.remarks)
        for row in above:
            stated = [row.cells[1]] if row.cells[0] == named.name and len(row.cells) > 1 else []
            # A row that begins with the name of a column defines that column.
            if (
                row.cells[0] not in header.cells
                and len(row.cells) + 1 >= len(header.cells)
                and column.index < len(row.cells)
            ):
                cell = row.cells[column.index].lstrip("#").strip()
                bracket = re.search(r"\[([^\]]*)\]|\(([^)]*)\)", cell)
                stated += [cell, *([bracket[1] or bracket[2] or ""] if bracket else [])]
            for unit in stated:
                if find_unit(named.quantity, unit) not in ("unknown", "absent"):
                    _check_unit(file, named, unit, row.line, layout.remarks)
                    break


def _records(file: Path | str, layout: Layout, header: Row, data: list[Row], mapping: Mapping) -> list[Row]:
    """Return the records below the header, without rows of units and truncated lines."""
    width = len(header.cells)
    for row in data:
        if len(row.cells) > width and any(row.cells[width:]):
            problem = f"has {len(row.cells)} cells under a header of {width}"
            remedy = "put quotes around a text with a separator, and a line end between two records"
            raise fault(file, problem, remedy, line=row.line)
    short = [row for row in data if len(row.cells) < width]
    if short:
        layout.remarks.append(
            f"omitted because they have fewer cells than the header: {len(short)} lines, line {short[0].line} first"
        )
    data = [row for row in data if len(row.cells) >= width]
    units = 0
    for row in data[:_MAX_UNIT_ROWS]:
        cells = [layout.value(row, column) for column in layout.columns]
        if layout.time_us(row) is not None or not all(c is None or isinstance(c, str) for c in cells) or not any(cells):
            break
        for named, column in zip(mapping.columns, layout.columns, strict=True):
            _check_unit(file, named, row.cells[column.index], row.line, layout.remarks)
        layout.remarks.append(f"line {row.line} is a row of units")
        units += 1
    return data[units:]


def _check_date(file: Path | str, mapping: Mapping, line: int, column: str, stated: date) -> None:
    if isinstance(mapping.date, date) and mapping.date != stated:
        problem = f'states the date {stated}, but the mapping has date = "{mapping.date}"'
        remedy = f'write date = "{column}", the name of the column' if column else f'write date = "{stated}"'
        raise fault(file, problem, remedy, line=line, key=column)


def _check_date_and_zone(file: Path | str, layout: Layout, header: Row, row: Row) -> None:
    """Check a date and a zone in columns of a record that the mapping does not name."""
    taken = {layout.time, layout.date, layout.zone, *(column.index for column in layout.columns)}
    at_utc, at_zone = layout.time_us(row, 0), layout.time_us(row, 3600)
    for k, (name, cell) in enumerate(zip(header.cells, row.cells, strict=False)):
        if k in taken or at_utc is None:
            continue
        day = parse_date(cell) if "date" in name.lower() else None
        if day is not None:
            _check_date(file, layout.mapping, row.line, name, day)
        zone = parse_offset(cell) if cell[:1] in "+-" and ":" in cell else None
        used = layout.mapping.zone if isinstance(layout.mapping.zone, int) else 0
        # A time with a zone of its own does not depend on the column.
        if zone is not None and at_utc != at_zone and layout.zone is None and zone != used:
            mapped = f"has zone = {used} s" if layout.mapping.zone is not None else "takes the times as UTC"
            problem, remedy = (
                f"states the zone {cell}, but the mapping {mapped}",
                f'write zone = "{name}", the name of the column',
            )
            raise fault(file, problem, f"{remedy}, or delete that column if it is wrong", line=row.line, key=name)
