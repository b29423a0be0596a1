"""``wingd-loads``: extremes, load cycles and damage of bending moments."""

from __future__ import annotations

import argparse

from wingd import WingdError
from wingd.commands import run_command
from wingd.commands.selection import notes_on_stderr, parse_numbers, to_json


def main(arguments: list[str] | None = None) -> int:
    """Run the command; returns the exit status."""
    parser = argparse.ArgumentParser(
        prog="wingd-loads",
        description="Extremes, exceedances, rainflow cycles and relative damage of the bending moments that results contain.",
        epilog="Example: wingd-loads store --bending-hz 1.3",
    )
    parser.add_argument(
        "source", metavar="STORE|FILE", help="store, exported shapes, or a table with bending moments (CSV, Parquet)"
    )
    parser.add_argument("--flight", metavar="FLIGHT", help="flight [default: all flights]")
    parser.add_argument(
        "--live", action="store_true", help="use the results of live mode, whose rate is high enough to count cycles"
    )
    parser.add_argument(
        "--structure",
        metavar="FILE",
        help="stiffness, CSV: s_m,ei_n_m2,sigma_ei_n_m2 and optionally ground_n_m,ultimate_n_m (for --goodman)",
    )
    parser.add_argument(
        "--bending-hz",
        type=float,
        metavar="HZ",
        default=3.0,
        help="lowest bending frequency; counting needs 10 frames per period [default: 3]",
    )
    parser.add_argument(
        "--slopes",
        type=parse_numbers,
        default=[3.0, 5.0, 10.0],
        metavar="M,M",
        help="slopes of the S-N curves [default: 3,5,10]",
    )
    parser.add_argument(
        "--goodman", action="store_true", help="correct each cycle for its mean, relative to ultimate_n_m"
    )
    parser.add_argument("--levels", type=int, default=10, metavar="N", help="number of exceedance levels [default: 10]")
    parser.add_argument("--moments", metavar="FILE", help="write the moments of every frame to this file, CSV")
    parser.add_argument("--json", action="store_true", help="print one JSON object per flight")
    args = parser.parse_args(arguments)
    if not args.bending_hz > 0:
        parser.error("--bending-hz: give a frequency above 0 Hz")
    if not all(1 <= m <= 30 for m in args.slopes):
        parser.error("--slopes: give slopes of S-N curves from 1 to 30, such as 3,5,10")
    if not 1 <= args.levels <= 1000:
        parser.error("--levels: give 1 to 1000")
    return run_command(lambda: run(args))


def run(args: argparse.Namespace) -> None:
    """Print the loads of each flight."""
    import pandas as pd

    from wingd import loads

    structure = loads.read_structure(args.structure) if args.structure else None
    with notes_on_stderr():
        flights = _moments(args)
    if args.moments:
        pd.concat(flights.values()).to_csv(args.moments, index=False)
    for name, moments in flights.items():
        result = _evaluate(moments, structure, args)
        if args.json:
            tables = {
                k: v.reset_index().to_dict("records") if isinstance(v, pd.DataFrame) else v for k, v in result.items()
            }
            print(to_json({"flight": name, "live": args.live, **tables}))
            continue
        print(f"Flight {name}; moments relative to the ground")
        print(
            (result["extremes"].select_dtypes("number") * 1e-3)
            .rename(columns=lambda c: c.replace("_nm", " / kN m"))
            .to_string(float_format=lambda v: f"{v:.2f}")
        )
        if result["no_cycles_because"]:
            print(f"No cycles: {result['no_cycles_because']}")
        else:
            print(result["damage"].to_string(index=False, float_format=lambda v: f"{v:.4g}"))


def _moments(args: argparse.Namespace) -> dict:
    import wingd
    from wingd import loads

    if str(args.source).endswith((".csv", ".parquet")):
        table = loads.read_moments(args.source)
        if "flight" not in table:
            return {"-": table}
        flights = {str(name): part for name, part in table.groupby("flight")}
    else:
        opened = wingd.open(args.source)
        names = [args.flight] if args.flight else opened.names
        flights = {name: loads.read_moments(opened[name].live) if args.live else opened[name].moments for name in names}
    if args.flight:
        flights = {k: v for k, v in flights.items() if k == args.flight}
    if not flights:
        raise WingdError(f"{args.source}: there is no flight {args.flight or ''} with bending moments")
    return flights


def _evaluate(moments, structure, args: argparse.Namespace) -> dict:
    from wingd import loads

    one = moments[moments["s_m"] == moments["s_m"].iloc[0]]
    sampling = loads.analyse_sampling(loads.seconds_of(one), args.bending_hz)
    reason = sampling.reason(args.bending_hz)
    result = {
        "frames": len(one),
        "rate_hz": sampling.rate_hz,
        "needed_hz": sampling.needed_hz,
        "gaps": {"count": sampling.gaps, "longest_s": sampling.longest_gap_s},
        "no_cycles_because": reason,
        "extremes": loads.extremes(moments, structure),
        "exceedances": loads.exceedances(moments, args.levels),
    }
    if reason is None:
        result["cycles"] = loads.rainflow(moments, args.bending_hz, structure)
        result["damage"] = loads.damage(moments, args.slopes, args.bending_hz, structure, args.goodman)
    return result
