"""Promise: a table of aircraft data is read as its program meant it, or refused with the cause; no line wins in silence."""

from __future__ import annotations

import json
from datetime import date
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from wingd import WingdError
from wingd.commands.table import main
from wingd.conditions import read_conditions, read_mapping
from wingd.conditions.times import format_time, parse_date, parse_offset, parse_time
from wingd.conditions.units import Conversion, check_name, find_unit, unit_in_name

DATA = Path(__file__).parent / "data" / "tables"
GOLDEN = json.loads((DATA / "golden.json").read_text())


@pytest.mark.parametrize("golden", GOLDEN, ids=[f"{g['table']}-{g['mapping']}" for g in GOLDEN])
def test_values_equal_those_of_the_program_to_1e_9(golden: dict, tmp_path: Path) -> None:
    out = tmp_path / "canonical.csv"
    assert (
        main([str(DATA / golden["table"]), "--mapping", str(DATA / golden["mapping"]), "-o", str(out)])
        == golden["status"]
    )
    table = pd.read_csv(out)
    counts = {q: int(table[q].count()) for q in table.columns[1:]}
    assert counts == golden["values"] and len(table) == golden["read"]
    for utc, values in golden["frames"].items():
        # Day numbers of a spreadsheet have six decimals here: half of the last one is 43.2 ms. Of IRIG, lines are 2 s apart.
        near = (pd.to_datetime(table.utc, format="ISO8601") - pd.Timestamp(utc)).abs()
        assert near.min() < pd.Timedelta("43.2ms") or "irig" in golden["table"], near.min()
        row = table.loc[near.idxmin()]
        for quantity, value in values.items():
            assert row[quantity] == pytest.approx(value, rel=1e-9), quantity
    # The canonical table is canonical.
    again = read_conditions(out)
    pd.testing.assert_frame_equal(again.table, table, check_exact=True)
    assert not again.doubts


def write(folder: Path, text: str, mapping: str) -> tuple[Path, Path]:
    (folder / "table.csv").write_text(text)
    (folder / "map.toml").write_text(mapping)
    return folder / "table.csv", folder / "map.toml"


def refusal(folder: Path, text: str, mapping: str, flight_date: date | None = None) -> str:
    file, mapped = write(folder, text, mapping)
    with pytest.raises(WingdError) as error:
        read_conditions(file, mapped, flight_date)
    assert "; " in str(error.value) and "\n" not in str(error.value)
    return str(error.value)


def read(folder: Path, text: str, mapping: str) -> pd.DataFrame:
    return read_conditions(*write(folder, text, mapping)).table


CAUSES = [
    ("c-decimal-comma.csv", 'decimal commas (350,0); write decimal = ","'),
    ("e-excel-serial.csv", 'time_format = "excel_days" (a spreadsheet\'s day numbers, 2026-06-01'),
    ("f-epoch-ms.csv", 'time_format = "unix_ms"'),
    ("g-seconds-of-day.csv", 'time_format = "seconds_of_day", date = "2026-06-01"'),
    ("g2-gps-week-seconds.csv", 'time_format = "gps_seconds"'),
    ("q2-compact-noT.csv", 'time_format = "compact"'),
    ("v-text-values.csv", "texts instead of numbers (NCD)"),
    ("z-otherday.csv", "are 2026-06-02T07:59:50Z to 2026-06-02T08:01:49Z"),
]


@pytest.mark.parametrize(("name", "cause"), CAUSES)
def test_tables_that_match_no_frame_are_refused_with_the_cause(
    name: str, cause: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    day = "2026-06-04" if name.startswith("z") else "2026-06-01"
    out = tmp_path / "o.csv"
    status = main([str(DATA / name), "--mapping", str(DATA / "map.toml"), "--flight-date", day, "-o", str(out)])
    printed = capsys.readouterr()
    assert status == 1 and cause in printed.err and printed.err.count("\n") == 1 and not out.exists(), printed.err


@pytest.mark.parametrize(("name", "mapping", "causes"), [
    # GPS seconds of 2026 are seconds since 1970 of 2016: without a date both fit.
    ("g2-gps-week-seconds.csv", "map.toml", ['time_format = "unix_s" (seconds since 1970, 2016-05-27T08:00:08Z)', 'time_format = "gps_seconds" (GPS seconds since 1980, 2026-06-01T07:59:50Z)']),
    ("a-plain.csv", "map-flwrong.toml", ["line 1, FL: is in FL, but the mapping converts it", "write scale = 30.48, offset = 0"]),
])  # fmt: skip
def test_what_could_be_read_in_two_ways_is_refused_without_a_date(
    name: str, mapping: str, causes: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "o.csv"
    assert main([str(DATA / name), "--mapping", str(DATA / mapping), "-o", str(out)]) == 1 and not out.exists()
    printed = capsys.readouterr().err
    assert all(cause in printed for cause in causes) and printed.count("\n") == 1, printed


def test_units_of_a_table_agree_with_those_of_the_mapping_or_both_are_named(tmp_path: Path) -> None:
    of_day = "time = 'T'\ntime_format = 'seconds_of_day'\ndate = 2026-06-01\n"
    mapping = of_day + "[[column]]\nname = 'ALT'\nquantity = 'pressure_altitude_m'\n"
    rows = "".join(f"07:59:{s},35000\n" for s in range(30, 50))
    for head in (
        "#hh:mm:ss, ft Baro,\nT,ALT\n",
        "UTC (hh:mm:ss),Pressure altitude (ft.)\nT,ALT\n",
        "Time tag,Pressure altitude\n-,[feet]\nT,ALT\n",
        "ALT,ft,of the standard atmosphere\nT,s,UTC\nT,ALT\n",
        "T,ALT\n-,Pressure altitude\n-,FT\n",
    ):
        words = refusal(tmp_path, head + rows, mapping)
        assert "ALT: is in" in words and "scale = 1, offset = 0; write scale = 0.3048, offset = 0, or unit =" in words
        assert 'unit = "m": scale = 1' in refusal(tmp_path, head + rows, mapping + "unit = 'm'\n")
        found = read(tmp_path, head + rows, mapping + "unit = 'ft'\n").pressure_altitude_m
        np.testing.assert_allclose(found, 10_668.0, rtol=1e-12)
    for name in ("ALT_FT", "Alt / ft", "Alt (ft Baro)", "Alt [foot]", "Alt (kft)"):
        text = f"T,{name}\n{rows}"
        assert "but the mapping converts it" in refusal(tmp_path, text, mapping.replace("'ALT'", f"'{name}'"))
    named = mapping.replace("'ALT'", "'Alt (furlongs)'")
    text = f"T,Alt (furlongs)\n{rows}"
    assert "column.unit: is parsnips, which is not a known unit" in refusal(
        tmp_path, text, named + "unit = 'parsnips'\n"
    )
    assert "is given with scale or offset" in refusal(tmp_path, text, named + "unit = 'ft'\nscale = 1.0\n")
    assert "not a unit of pressure_altitude_m" in refusal(tmp_path, f"T,ALT\n-,kg\n{rows}", mapping)
    read_it = read_conditions(
        *write(
            tmp_path, f"T,ALT (nosuch)\n{rows}".replace("35000", "10668"), mapping.replace("'ALT'", "'ALT (nosuch)'")
        )
    )
    assert any("the unit nosuch of pressure_altitude_m is unknown" in remark for remark in read_it.remarks)


@pytest.mark.parametrize(("name", "words"), [
    ("above-header", "AltB: is in ft Baro"), ("in-brackets", "is in deg F"), ("long-and-short-names", "AltP: is in ft"),
])  # fmt: skip
def test_units_above_and_in_headers_are_heard(name: str, words: str) -> None:
    with pytest.raises(WingdError, match=words):
        read_conditions(DATA / f"table-units-unheard-{name}.csv", DATA / f"table-units-unheard-{name}.toml")


def test_units_are_found_in_any_spelling() -> None:
    for text in ("ft", "FT", "foot", "feet", "ft.", "ft Baro", "ft msl"):
        assert find_unit("pressure_altitude_m", text) == pytest.approx((0.3048, 0))
    assert find_unit("pressure_altitude_m", "kft") == pytest.approx((304.8, 0))
    assert [find_unit("pressure_altitude_m", t) for t in ("kg", "in Hg", "parsnip", "-", "", "a;b")] == [
        "wrong",
        "wrong",
        "unknown",
        "absent",
        "absent",
        "unknown",
    ]
    for text in ("deg F", "degF", "° F", "°F", "Fahrenheit", "degrees F", "F"):
        found = find_unit("static_temperature_c", text)
        assert isinstance(found, Conversion) and found.scale * 19.4 + found.offset == pytest.approx(-7)
    assert find_unit("static_temperature_c", "deg K") == pytest.approx((1, -273.15))
    # The conventional inch of mercury (BIPM: 3386.389 Pa at 0 degrees Celsius), torr, and pound-force per square foot.
    for text, hpa in (
        ("in Hg", 33.86389),
        ("inHg", 33.86389),
        ("inches Hg", 33.86389),
        ("mmHg", 1.333224),
        ("psf", 0.4788026),
        ("psi", 68.94757),
        ("bar", 1000),
    ):
        assert find_unit("static_pressure_hpa", text) == pytest.approx((hpa, 0), rel=1e-6), text
    assert find_unit("mach", "M") == (1, 0) and find_unit("mach", "%") == pytest.approx((0.01, 0))
    assert find_unit("centre_of_gravity_percent", "%MAC") == pytest.approx((1, 0))
    assert find_unit("load_factor", "g") == pytest.approx((1, 0)) and find_unit("weight_kg", "g") == "wrong"
    assert (
        find_unit("flap_deg", "rad") == pytest.approx((57.29577951308232, 0), rel=1e-12)
        and find_unit("flap_deg", "%") == "wrong"
    )
    assert find_unit("load_factor", "m/s2") == pytest.approx((1 / 9.80665, 0)) and find_unit(
        "true_airspeed_m_s", "mph"
    ) == pytest.approx((0.44704, 0))
    assert (
        unit_in_name("pressure_altitude_m", "ALT_FT"),
        unit_in_name("pressure_altitude_m", "Alt_m"),
        unit_in_name("mach", "MACH_1"),
        unit_in_name("pressure_altitude_m", "FL"),
        unit_in_name("static_temperature_c", "TAT"),
    ) == ("FT", None, None, "FL", None)


def test_names_in_another_case_or_unit_are_errors(tmp_path: Path) -> None:
    for name, remedy in (("Mach", "write mach"), ("WEIGHT_KG", "write weight_kg"), ("weight_lb", 'write weight_kg, with the column\'s unit: unit = "lb"'),
                         ("true_airspeed_kt", "write true_airspeed_m_s"), ("static_temperature", "write static_temperature_c")):  # fmt: skip
        assert remedy in (check_name(name) or ""), name
        file = tmp_path / "t.csv"
        file.write_text(f"utc,{name}\n2026-06-01T08:00:00Z,1\n")
        with pytest.raises(WingdError, match=f"line 1, {name}: is almost the name of a quantity"):
            read_conditions(file)
        mapping = f"time = 'utc'\n[[column]]\nname = 'x'\nquantity = '{name}'\n"
        assert remedy in refusal(tmp_path, "utc,x\n2026-06-01T08:00:00Z,1\n", mapping)
    file.write_text("UTC,mach\n2026-06-01T08:00:00Z,1\n")
    with pytest.raises(WingdError, match="line 1, UTC: is almost the name of a quantity; write utc"):
        read_conditions(file)
    file.write_text("utc,mach,remark\n2026-06-01T08:00:00+02:00,0.8,a\n")
    read_it = read_conditions(file)
    assert (
        read_it.table.iloc[0].tolist() == ["2026-06-01T06:00:00Z", 0.8]
        and "columns not read: remark" in read_it.remarks
    )


MACH = "time = 'T'\n[[column]]\nname = 'M'\nquantity = 'mach'\n"


def test_lines_of_one_time_and_different_values_are_an_error_that_names_them(tmp_path: Path) -> None:
    rows = [("2026-06-01T08:00:00Z", ".78"), ("2026-06-01T08:00:01Z", ".79"), ("2026-06-01T08:00:00Z", ".78")]
    text = "T,M\n" + "".join(f"{t},{m}\n" for t, m in rows)
    found = read_conditions(*write(tmp_path, text, MACH))
    assert found.table.mach.tolist() == [0.78, 0.79] and "1 lines repeat a time with the same values" in found.remarks
    words = refusal(tmp_path, text + "2026-06-01T10:00:01+02:00,.80\n", MACH)
    assert (
        "lines 3 and 5 have the time 2026-06-01T08:00:01Z and different mach (0.79, 0.8); keep the valid line" in words
    )
    two = MACH + "[[column]]\nname = 'W'\nquantity = 'weight_kg'\n"
    merged = read(tmp_path, "T,M,W\n2026-06-01T08:00:00Z,.78,\n2026-06-01T08:00:00Z,,70000\n", two)
    assert merged.iloc[0].tolist()[1:] == [0.78, 70_000], "values that complete each other are one line"


def test_incomplete_tables_are_written_and_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    two = MACH + "[[column]]\nname = 'W'\nquantity = 'weight_kg'\n"
    file, mapping = write(
        tmp_path, "EVENT,T,M,W\n,2026-06-01T08:00:00Z,.78,NCD\nx,later,.78,NCD\n,2026-06-01T08:00:01Z,-9999,\n", two
    )
    out = tmp_path / "o.csv"
    assert main([str(file), "--mapping", str(mapping), "-o", str(out)]) == 1
    printed = capsys.readouterr()
    for words in (
        "columns not read: EVENT",
        '1 lines without a time, line 3 first ("later")',
        "mach: 2 values, 1 implausible",
        "weight_kg has texts instead of numbers (NCD)",
    ):
        assert words in printed.err, printed.err
    assert (
        out.read_text() == "utc,mach\n2026-06-01T08:00:00Z,0.78\n2026-06-01T08:00:01Z,\n" and "2 lines" in printed.out
    )


HOSTILE = [
    ("T,M\n2026-06-01T08:00:00Z,=A1*2\n", "mach has formulas (=A1*2); save the values"),
    ("T,M\n2026-06-01T08:00:00Z,1e308\n", "mach cannot be 1e+308, only 0 to 3"),
    ("T,M\n2026-06-01T08:00:00Z,1e999\n", "mach has texts instead of numbers (1e999)"),
    ("T,M\n1e308,0.8\n", "its times"),
    ("T,M\n2026-06-01T08:00:00Z,\n", "the column of mach is empty"),
    ("T,M\n", "has no lines below its header"),
    ("", "is empty"),
    ("T,M,M\n2026-06-01T08:00:00Z,1,1\n", "M: occurs twice in the header"),
    ("t,M\n2026-06-01T08:00:00Z,1\n", "no line has the column T"),
    ("T,N\n2026-06-01T08:00:00Z,1\n", "M: is not a column of the table; its header has T, N"),
    ('T,M\n"2026-06-01T08:00:00Z,1\n', "a quote is not closed"),
    ("T,M\n2026-06-01T08:00:00Z,climb, flaps,1\n", "line 2: has 4 cells under a header of 2"),
    ("T  M\n2026-06-01T08:00:00Z  1\n", "separated by blanks"),
    ("T;M\n2026-06-01 08:00:00;35,000\n", "separate thousands, or decimals (35,000)"),
    ("T;M\n2026-06-01 08:00:00;0,78\n", "mach has decimal commas (0,78)"),
    ("T;M\n2026-06-01 08:00:00;35.000,5\n", "points and decimal commas (35.000,5)"),
    ("T,M\n01.06.2026 08:00:00,.78\n", 'its times ("01.06.2026 08:00:00") are in an unsupported format'),
    ("T,M\n1,.78\n2,.78\n", "write in the mapping time_format = "),
    ("T,M\n2026-06-01T08:00:00Z,.78\n2026-06-01T08:00:01Z,.78\n0001-06-01T08:00:00Z,.78\n", "line 4: has the time"),
    ("T,M\n152:07:59:50,.78\n", 'time_format = "irig", year = YYYY'),
]


@pytest.mark.parametrize(("text", "words"), HOSTILE)
def test_hostile_tables_are_refused_by_name(text: str, words: str, tmp_path: Path) -> None:
    assert words in refusal(tmp_path, text, MACH)


def test_files_that_are_no_text_and_huge_ones_are_refused(tmp_path: Path) -> None:
    file, mapping = write(tmp_path, "", MACH)
    for content, words in (
        ("T,M\n".encode("utf-16"), "is UTF-16 text; save it as UTF-8"), (b"PK\x03\x04\x14\0", "is a spreadsheet file or an archive"),
        (b"T,M\n2026-06-01T08:00:00Z,\0\n", "line 2: is not text in UTF-8"), (b"T,M\xe9\n", "line 1: is not text in UTF-8"),
    ):  # fmt: skip
        file.write_bytes(content)
        with pytest.raises(WingdError, match=words):
            read_conditions(file, mapping)
    with file.open("wb") as opened:
        opened.truncate(1 << 30)
    with pytest.raises(WingdError, match="has 1073741824 bytes, more than"):
        read_conditions(file, mapping)
    for path in (tmp_path, tmp_path / "none.csv"):
        with pytest.raises(WingdError, match="is not a file|cannot be read"):
            read_conditions(path, mapping)


MAPPINGS = [
    ("tme = 'T'\n", "tme: is not a key of a mapping"),
    ("[[column]]\nname = 'M'\nquantity = 'mach'\n", "time: is missing"),
    ("time = 'T'\n", "column: is missing"),
    (MACH + "[[column]]\nname = 'x'\nquantity = 'mach'\n", "column.quantity: is mach twice"),
    (MACH.replace("'T'", "'T'\ntime_format = 'seconds_of_day'"), "date: is missing"),
    (MACH.replace("'T'", "'T'\ndate = 'June'"), "is not a date and not a column"),
    (MACH.replace("'T'", "'T'\nyear = 2026"), "line 2, year: is for days of the year"),
    (MACH.replace("'T'", "'T'\nseparator = ',,'"), "separator: is ',,'"),
    (MACH.replace("'T'", "'T'\ntime_format = 'Excel'"), "time_format: is 'Excel'; give one of utc"),
    (MACH.replace("time = 'T'", "format = 'iwg1'"), "column.field: is missing for mach"),
    ("format = 'iwg1'\ntime = 'T'\n", "defines time, zone, separator"),
    ("format = 'icartt'\n" + MACH, "line 1: is not the first line of an ICARTT file"),
    (MACH + "scale = 0\n", "column.scale: is 0 for mach"),
    (MACH + "scale = nan\n", "column.scale: is nan"),
    (MACH + "speed = 1\n", "column.speed: is not a key"),
    ("time = ", "is not TOML"),
    (MACH.replace("'T'", "'T'\nseparator = ';'"), "separated by commas"),
]


@pytest.mark.parametrize(("mapping", "words"), MAPPINGS)
def test_mappings_are_checked_by_key(mapping: str, words: str, tmp_path: Path) -> None:
    assert words in refusal(tmp_path, "T,M\n2026-06-01T08:00:00Z,.78\n", mapping)


def test_local_times_and_dates_are_read_or_named(tmp_path: Path) -> None:
    column = "[[column]]\nname = 'ALT'\nquantity = 'pressure_altitude_m'\n"
    of_day = "time = 'T'\ntime_format = 'seconds_of_day'\ndate = 2026-06-01\n"
    columns = "DATE,T,UTCOFST,ALT\n" + "".join(f"2026-06-01,02:59:{s},-05:00,10668\n" for s in range(30, 60))
    words = refusal(tmp_path, columns, of_day + column)
    assert "UTCOFST: states the zone -05:00, but" in words and 'write zone = "UTCOFST"' in words
    right = "time = 'T'\ntime_format = 'seconds_of_day'\ndate = 'DATE'\nzone = 'UTCOFST'\n"
    assert read(tmp_path, columns, right + column).utc[0] == "2026-06-01T07:59:30Z"
    other = of_day.replace("06-01", "06-02") + "zone = '-05:00'\n"
    assert "states the date 2026-06-01" in refusal(tmp_path, columns, other + column)
    iso = "T,ALT\n2026-06-01T02:59:30,10668\n"
    assert read(tmp_path, iso, "time = 'T'\nzone = '-05:00'\n" + column).utc[0] == "2026-06-01T07:59:30Z"
    midnight = "T,ALT\n23:59:59,1\n00:00:00,2\n"
    assert "line 3: the seconds of the day restart at midnight" in refusal(tmp_path, midnight, of_day + column)


def test_times_are_read_in_every_format() -> None:
    begin = 1_780_300_790_000_000
    day = date(2026, 6, 1)
    for format, text in (
        ("utc", "2026-06-01T07:59:50Z"), ("utc", "2026-06-01 07:59:50"), ("utc", "20260601T075950"), ("unix_s", "1780300790"), ("utc", "2026-152T07:59:50Z"),
        ("utc", "2026-06-01T09:59:50+02:00"), ("utc", "2026-06-01T09:59:50+0200"), ("unix_ms", "1780300790000"), ("unix_us", "1780300790000000"),
        ("unix_ns", "1780300790000000000"), ("gps_seconds", "1464336008"), ("seconds_of_day", "28790"), ("seconds_of_day", "07:59:50"),
        ("seconds_of_day", "07:59:50.000"), ("compact", "20260601075950"), ("irig", "152:07:59:50.0"), ("irig", "2026:152:07:59:50"),
    ):  # fmt: skip
        assert parse_time(text, format, day) == begin, (format, text)
    for format, origin in (
        ("excel_days", 25_569),
        ("excel1904_days", 24_107),
        ("matlab_days", 719_529),
        ("julian_days", 2_440_587.5),
    ):
        text = repr(origin + begin * 1e-6 / 86_400)
        assert abs((parse_time(text, format) or 0) - begin) < 50, format
        assert abs((parse_time(text, format, None, 3600) or 0) - begin + 3_600_000_000) < 50
    for format, text in (
        ("utc", "yesterday"), ("utc", "2026-13-01T00:00:00Z"), ("utc", "2026-06-01"), ("utc", "nan"), ("utc", "-5"), ("utc", "1780300790"), ("unix_s", "-5"), ("utc", "2026-06-01T07:59:50+99:00"),
        ("seconds_of_day", "345601"), ("seconds_of_day", "24:00:00"), ("gps_seconds", "1"), ("compact", "2026060107595"), ("irig", "367:00:00:00"), ("utc", "٢٠٢٦-06-01T00:00:00Z"),
    ):  # fmt: skip
        assert parse_time(text, format, day) is None, (format, text)
    assert parse_time("152:07:59:50", "irig") is None and parse_time("28790", "seconds_of_day") is None
    assert [parse_date(t) for t in ("2026-06-01", "2026/06/01", "20260601", "2026-152")] == [day] * 4
    assert [parse_date(t) for t in ("17", "07:59:50", "0.78", "2026-02-30")] == [None] * 4
    zones = {"+05:45": 20_700, "-03:30": -12_600, "Z": 0, "+2": 7200, "+0200": 7200, "UTC+2": 7200, "GMT": 0}
    assert {text: parse_offset(text) for text in zones} == zones
    assert [parse_offset(t) for t in ("", "02:00", "+aa:00", "+02:75", "+99:00", "   :  ", "+-1:00")] == [None] * 7
    assert format_time(begin + 250_000) == "2026-06-01T07:59:50.25Z"


def test_a_static_pressure_of_another_altitude_is_named(tmp_path: Path) -> None:
    mapping = "time = 'T'\n" + "".join(
        f"[[column]]\nname = '{name}'\nquantity = '{quantity}'\nunit = '{unit}'\n"
        for name, quantity, unit in (("H", "pressure_altitude_m", "m"), ("P", "static_pressure_hpa", "hPa"))
    )
    # Standard atmosphere: 250.0 hPa at 10,363 m, 540.2 hPa at 5,000 m, 120.4 hPa at 15,000 m.
    sound = [(10363.2, 250.0), (5000, 540.2), (15000, 120.4), ("", 250.0), (-30, 1016.9)]
    for rows, count in ((sound, 0), ([*sound, (10363.2, 300.0), (10363.2, 251.0), (10363.2, 258.0)], 2)):
        lines = [f"2026-06-01T08:00:{k:02}Z,{h},{p}\n" for k, (h, p) in enumerate(rows)]
        found = read_conditions(*write(tmp_path, "T,H,P\n" + "".join(lines), mapping)).remarks
        found = [remark for remark in found if "contradicts" in remark]
        assert len(found) == (count > 0), found
    assert found[0].startswith(
        "static_pressure_hpa contradicts pressure_altitude_m at 2 times, 2026-06-01T08:00:05Z first"
    )
    assert "300.0 hPa at 10363 m, where the pressure is 250.0 hPa" in found[0]


def test_displaced_fields_of_iwg1_are_named(tmp_path: Path) -> None:
    sound = (DATA / "n-iwg1-noheader.txt").read_text()
    moved = sound.replace(",38.1,", ",", 1).replace("08:00:00,", "08:00:00,,", 1)
    found = read_conditions(*write(tmp_path, moved, "format = 'iwg1'"))
    assert len(found.table) == 118
    assert any("omitted: 2 records that do not have 33 fields like most, line 1 first" in r for r in found.remarks)
    header = (
        (DATA / "o-iwg1-glued.txt")
        .read_text()
        .split("\n")[0]
        .replace("Mach Number,Vertical Velocity", "Vertical Velocity,Mach Number")
    )
    found = read_conditions(*write(tmp_path, f"{header}\n{sound}", "format = 'iwg1'"))
    assert sum("names field" in r for r in found.remarks) == 1
    assert any('names field 12 "Vertical Velocity", which is read as mach' in r for r in found.remarks)
    own = "format = 'iwg1'\n[[column]]\nfield = {}\nquantity = 'weight_kg'\nunit = 'lb'\n"
    with_weight = "".join(line.rstrip() + ",150000\n" for line in sound.splitlines())
    assert read(tmp_path, with_weight, own.format(34)).weight_kg[0] == pytest.approx(150_000 * 0.45359237)
    assert "column.field: is field 35 for weight_kg, but the records have 34" in refusal(
        tmp_path, with_weight, own.format(35)
    )
    with pytest.raises(WingdError, match='write format = "iwg1"'):
        read_conditions(DATA / "n-iwg1-noheader.txt", DATA / "map-iwg1.toml")
    with pytest.raises(WingdError, match="line 3: has 65 cells under a header of 33"):
        read_conditions(DATA / "o-iwg1-glued.txt", DATA / "map-iwg1.toml")


def strictly(text: str) -> list[tuple[str, float, float]] | None:
    """A second reading of a changed table, by RFC 4180 alone and without the package; None if it determines nothing."""
    if '"' in text or text.count("UTC") != 1:
        return None
    rows = [[c.strip() for c in line.split(",")] for line in text.split("\n") if line.strip(" ,")]
    header, out = rows[0], []
    if any(header.count(n) != 1 for n in ("UTC", "FL", "MACH")):
        return None
    for row in rows[1:]:
        if len(row) < len(header):
            continue
        if len(row) > len(header) and any(row[len(header) :]):
            return None
        time, fl, mach = (row[header.index(n)] for n in ("UTC", "FL", "MACH"))
        numbers = []
        for cell, scale, low, high in ((fl, 30.48, -1e3, 3e4), (mach, 1, 0, 3)):
            try:
                value = float(cell) * scale if "_" not in cell and cell.isascii() else float("nan")
            except ValueError:
                value = float("nan")
            numbers.append(value if low <= value <= high else float("nan"))
        out.append((time, *numbers))
    return out


def test_a_changed_table_never_silently_gives_another_value(tmp_path: Path) -> None:
    random = np.random.default_rng(9)
    mapping = "time = 'UTC'\nseparator = ','\n[[column]]\nname = 'FL'\nquantity = 'pressure_altitude_m'\nscale = 30.48\n[[column]]\nname = 'MACH'\nquantity = 'mach'\n"
    (tmp_path / "map.toml").write_text(mapping)
    mapped, file = read_mapping(tmp_path / "map.toml"), tmp_path / "t.csv"
    sound = [
        ["UTC", "FL", "MACH", "REMARK"],
        *([f"2026-06-01T08:00:0{k}Z", f"35{k}", f"0.78{k}", f"note {k}"] for k in range(8)),
    ]
    before = strictly("\n".join(",".join(r) for r in sound))
    refused = 0
    for k in range(900):
        rows = [list(row) for row in sound]
        at, column, kind = int(random.integers(1, 9)), int(random.integers(4)), k % 9
        meaning = kind in (0, 1, 8)
        if kind == 0:
            order = random.permutation(4)
            rows = [[row[n] for n in order] for row in rows]
        elif kind == 1:
            rows = [[f'"{c}"' if random.random() < 0.5 else f" {c} " for c in row] for row in rows]
        elif kind == 2:
            rows[0][column] += "x"
        elif kind == 3:
            other = int(random.integers(4))
            rows[0][column], rows[0][other] = rows[0][other], rows[0][column]
        elif kind == 4:
            del rows[at][column]
        elif kind == 5:
            rows[at].insert(column, str(random.choice(["", "1.5", "x"])))
        elif kind == 6:
            rows[at][column] = str(
                random.choice(["nan", "inf", "NCD", "", "1,5", "1e400", "-", '"1"2', '"1', "1_0", "٣"])
            )
        text = "\n".join(",".join(row) for row in rows) + "\n"
        if kind == 7:
            place = int(random.integers(len(text)))
            text = text[:place] + str(random.choice(list(',"\n ;.0#-e\t9'))) + text[place + int(random.integers(2)) :]
        if kind == 8:
            text = text.replace("\n", "\r\n")
        file.write_bytes(text.encode())
        try:
            conditions = read_conditions(file, mapped)
        except WingdError as error:
            refused += 1
            assert not meaning and "; " in str(error) and "\n" not in str(error), (text, error)
            continue
        found, notes = conditions.table, " ".join(conditions.remarks + conditions.doubts)
        expected = before if meaning else strictly(text)
        if expected is None:
            expected = before
        values = {t: v for t, *v in expected}
        read_values = {
            t: [row.get("pressure_altitude_m", np.nan), row.get("mach", np.nan)]
            for t, row in zip(found.utc, found.to_dict("records"), strict=True)
        }
        for time, value in read_values.items():
            if time in values:
                left_out = np.isnan(value) & ~np.isnan(values[time])
                # A cell that is left out is not another value, and is counted.
                assert not left_out.any() or (
                    not meaning and any(w in notes for w in (" text", " blank", "no value"))
                ), text
                np.testing.assert_allclose(
                    np.where(left_out, values[time], value), values[time], rtol=1e-12, err_msg=text
                )
            else:
                # A time that was changed, and is written in another way.
                assert kind in (5, 6, 7) and value in [v for v in values.values()], (text, time, value)
    assert refused > 180, refused
