"""``wingd-table``: convert a table of aircraft data into the canonical CSV that ``wingd aircraft-data`` joins."""

from __future__ import annotations

import argparse
import sys
from datetime import date

from wingd.commands import run_command


def main(arguments: list[str] | None = None) -> int:
    """Run the command; returns its exit status."""
    from wingd.conditions.times import FORMATS

    parser = argparse.ArgumentParser(
        prog="wingd-table",
        description="Convert a table of aircraft data into the CSV that `wingd aircraft-data` joins with the frames.",
        epilog=f"time_format of a mapping: {', '.join(f'{name} ({meaning})' for name, meaning in FORMATS.items())}.",
    )
    parser.add_argument("table", metavar="TABLE", help="CSV of any separator with a header, ICARTT, or lines of IWG1")
    parser.add_argument(
        "--mapping", metavar="FILE", help="columns, units and times of the table, TOML [default: it is canonical]"
    )
    parser.add_argument(
        "--flight-date",
        type=date.fromisoformat,
        metavar="YYYY-MM-DD",
        help="refuse times that are more than a day from this one, and name the format that fits",
    )
    parser.add_argument("-o", "--output", required=True, metavar="FILE.csv", help="canonical table to write")
    args = parser.parse_args(arguments)
    return run_command(lambda: _run(args))


def _run(args: argparse.Namespace) -> int:
    from wingd.conditions import read_conditions

    read = read_conditions(args.table, args.mapping, args.flight_date)
    for text in (*read.remarks, *read.doubts):
        print(f"note: {text}", file=sys.stderr)
    read.write(args.output)
    utc = read.table["utc"]
    print(f"{args.output}: {len(utc)} lines, {utc.iloc[0]} to {utc.iloc[-1]}: {', '.join(read.table.columns[1:])}")
    return 1 if read.doubts else 0
