"""Times as tables write them, as microseconds since 1970, UTC."""

from __future__ import annotations

import re
from dataclasses import dataclass
from datetime import UTC, date, datetime, timedelta

from wingd.textfiles import parse_number

DAY_S = 86_400
#: Day number of 1 January 1970, midnight, of spreadsheets from 1900 and 1904, MATLAB's datenum, and Julian dates.
_DAYS_1970 = {"excel_days": 25_569.0, "excel1904_days": 24_107.0, "matlab_days": 719_529.0, "julian_days": 2_440_587.5}
#: Microseconds of a unit of numbers since 1970.
_UNIX_US = {"unix_s": 1e6, "unix_ms": 1e3, "unix_us": 1.0, "unix_ns": 1e-3}
#: From 1970 to the origin of GPS time (IS-GPS-200), GPS time minus UTC since 2017 (IERS Bulletin C 52), and GPS time of 2017, s.
_GPS_EPOCH_S, _GPS_LESS_UTC_S, _GPS_2017_S = 315_964_800, 18, 1_167_264_018
#: Largest second of a day: files of several days count on after midnight (ICARTT).
_MAX_SECONDS_OF_DAY = 4.0 * DAY_S
_EPOCH = datetime(1970, 1, 1, tzinfo=UTC)

FORMATS = {
    "utc": "ISO 8601",
    "unix_s": "seconds since 1970",
    "unix_ms": "milliseconds since 1970",
    "unix_us": "microseconds since 1970",
    "unix_ns": "nanoseconds since 1970",
    "excel_days": "a spreadsheet's day numbers",
    "excel1904_days": "day numbers of a spreadsheet that begins with 1904",
    "matlab_days": "MATLAB's day numbers",
    "julian_days": "Julian dates",
    "gps_seconds": "GPS seconds since 1980",
    "seconds_of_day": "seconds or times of a day",
    "compact": "14 digits, year to second",
    "irig": "days of the year with a time (IRIG)",
}
_ISO = re.compile(
    r"(?:(\d{4})-(\d\d)-(\d\d)|(\d{4})(\d\d)(\d\d))[T t](?:(\d\d):(\d\d)(?::(\d\d)(?:[.,](\d{1,9}))?)?|(\d\d)(\d\d)(\d\d)(?:[.,](\d{1,9}))?)"
    r"\s*(Z|z|[+-]\d\d(?::?\d\d)?)?",
    re.ASCII,
)
_DAY_OF_YEAR = re.compile(r"(?:(\d{4})[: /-])?(\d{1,3})[: T/-](\d{1,2}):(\d{1,2}):(\d{1,2}(?:\.\d*)?)[Zz]?", re.ASCII)


def parse_offset(text: str) -> int | None:
    """Return an offset from UTC, s: ``+02:00``, ``-0330``, ``+2``, ``Z``, ``UTC+2``."""
    found = re.fullmatch(r"(?:UTC|GMT)?\s*(?:([+−-])(\d{1,2})(?::?(\d\d))?)?", text.strip(), re.ASCII)
    if text.strip() in ("Z", "z", "UTC", "GMT"):
        return 0
    if not found or not found[1]:
        return None
    hours, minutes = int(found[2]), int(found[3] or 0)
    seconds = 3600 * hours + 60 * minutes
    return (seconds if found[1] == "+" else -seconds) if hours <= 14 and minutes < 60 else None


def parse_hours(text: str) -> int | None:
    """Return an offset from UTC, s, of a cell: as :func:`parse_offset`, or hours."""
    hours = parse_number(text)
    offset = parse_offset(text)
    return offset if offset is not None or hours is None or abs(hours) > 14 else round(3600 * hours)


def parse_date(text: str) -> date | None:
    """Return a date: ``2026-06-01``, ``2026/06/01``, ``20260601``, or ``2026-152`` by the day of the year."""
    found = re.fullmatch(r"(\d{4})([-/:.]?)(\d\d)\2(\d\d)|(\d{4})-(\d{3})", text.strip(), re.ASCII)
    try:
        if found and found[5]:
            return _year_day(int(found[5]), int(found[6]))
        return date(int(found[1]), int(found[3]), int(found[4])) if found and int(found[1]) >= 1950 else None
    except ValueError:
        return None


def _year_day(year: int, day: int) -> date:
    if not 1 <= day <= 366:
        raise ValueError(day)
    return date(year, 1, 1) + timedelta(days=day - 1)


def _iso(text: str, zone_s: int) -> int | None:
    found = _ISO.fullmatch(text)
    if not found:
        return None
    day = [int(found[k] or found[k + 3]) for k in (1, 2, 3)]
    hour, minute = int(found[7] or found[11]), int(found[8] or found[12])
    second, digits = int(found[9] or found[13] or 0), found[10] or found[14] or ""
    try:
        # A leap second counts as the last one of its minute.
        time = datetime(*day, hour, minute, min(second, 59), tzinfo=UTC)
    except ValueError:
        return None
    if second > 60:
        return None
    if found[15]:
        compact = found[15] if ":" in found[15] or len(found[15]) < 4 else found[15][:3] + ":" + found[15][3:]
        own = parse_offset(compact)
        if own is None:
            return None
        zone_s = own
    return (time - _EPOCH) // timedelta(microseconds=1) - zone_s * 1_000_000 + int(f"{digits[:6]:0<6}" if digits else 0)


def _day_of_year(text: str, year: int | None, zone_s: int) -> int | None:
    found = _DAY_OF_YEAR.fullmatch(text)
    if not found or not (found[1] or year):
        return None
    hour, minute, second = int(found[3]), int(found[4]), float(found[5])
    if hour > 23 or minute > 59 or second >= 61:
        return None
    try:
        day = _year_day(int(found[1] or year or 0), int(found[2]))
    except ValueError:
        return None
    return _midnight_us(day) + round(1e6 * (3600 * hour + 60 * minute + second - zone_s))


def _midnight_us(day: date) -> int:
    return (day - _EPOCH.date()).days * DAY_S * 1_000_000


def _time_of_day(text: str) -> float | None:
    found = re.fullmatch(r"(\d\d):(\d\d)(?::(\d\d(?:[.,]\d{1,9})?))?", text, re.ASCII)
    if not found or int(found[1]) > 23 or int(found[2]) > 59:
        return None
    second = float((found[3] or "0").replace(",", "."))
    return 3600 * int(found[1]) + 60 * int(found[2]) + second if second < 61 else None


def parse_time(text: str, format: str, day: date | None = None, zone_s: int = 0) -> int | None:
    """Return a time as microseconds since 1970, UTC; None if the text does not have the format.

    Parameters
    ----------
    text
        Content of the cell.
    format
        A key of :data:`FORMATS`.
    day
        Date of ``seconds_of_day``; its year is that of ``irig`` without one.
    zone_s
        Offset from UTC of times of a calendar that have no zone, s.
    """
    number = parse_number(text)
    # The largest number of a time, nanoseconds since 1970, has 19 digits.
    number = None if number is None or not 0 <= number < 1e20 else number
    if format == "utc":
        # A number has no format of its own: seconds since 1970 of 2016 are GPS seconds of 2026.
        iso = _iso(text, zone_s)
        return iso if iso is not None else _day_of_year(text, None, zone_s)
    if format in _UNIX_US:
        return None if number is None else round(number * _UNIX_US[format])
    if format in _DAYS_1970:
        days = None if number is None else number - _DAYS_1970[format]
        return None if days is None or days < 0 else round((days * DAY_S - zone_s) * 1e6)
    if format == "gps_seconds":
        since = None if number is None or number < _GPS_2017_S else number + _GPS_EPOCH_S - _GPS_LESS_UTC_S
        return None if since is None else round(1e6 * since)
    if format == "seconds_of_day":
        second = number if number is not None and number <= _MAX_SECONDS_OF_DAY else _time_of_day(text)
        return None if second is None or day is None else _midnight_us(day) + round(1e6 * (second - zone_s))
    if format == "compact":
        is_compact = re.fullmatch(r"\d{14}([.,]\d{1,9})?", text, re.ASCII)
        return _iso(f"{text[:8]}T{text[8:]}", zone_s) if is_compact else None
    return _day_of_year(text, day.year if day else None, zone_s)


def format_time(time_us: int) -> str:
    """Format microseconds since 1970 as ISO 8601 in UTC, with a fraction if there is one."""
    try:
        time = _EPOCH + timedelta(microseconds=time_us)
    except OverflowError:
        return f"{time_us * 1e-6:g} s"
    fraction = f".{time.microsecond:06}".rstrip("0").rstrip(".")
    return f"{time:%Y-%m-%dT%H:%M:%S}{fraction}Z"


#: Times of flights: any camera is younger than the first.
_YEARS = (_midnight_us(date(2000, 1, 1)), _midnight_us(date(2100, 1, 1)))


@dataclass(frozen=True)
class Window:
    """Times that a table of a flight may have: around its date, or the years 2000 to 2099 if that is not known."""

    day: date | None = None

    def holds(self, time_us: int) -> bool:
        """Return whether a time, microseconds since 1970, is possible."""
        low, high = _YEARS
        if self.day is not None:
            # A flight may pass midnight, and its local date is not that of UTC.
            low, high = (_midnight_us(self.day + timedelta(days=n)) for n in (-1, 2))
        return low <= time_us < high

    def guess_formats(self, tags: list[str], declared: str, zone_s: int) -> list[str]:
        """Return the lines for a mapping with which more than half of the tags are possible times."""
        found = []
        day = self.day or date(2026, 1, 1)
        for format, meaning in FORMATS.items():
            if format == declared and format != "irig":
                continue
            fits = [t for tag in tags if (t := parse_time(tag, format, day, zone_s)) is not None and self.holds(t)]
            if 2 * len(fits) <= len(tags):
                continue
            shown = [str(day), str(day.year)] if self.day else ["YYYY-MM-DD", "YYYY"]
            more = {"seconds_of_day": f', date = "{shown[0]}"', "irig": f", year = {shown[1]}"}.get(format, "")
            found.append(f'time_format = "{format}"{more} ({meaning}{"" if more else f", {format_time(fits[0])}"})')
        return found
