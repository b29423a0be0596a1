"""``wingd-difference``: compare measured shapes with each other or with a computation."""

from __future__ import annotations

import argparse

from wingd.commands import run_command
from wingd.commands.selection import add_options, notes_on_stderr, read_frames, to_json


def main(arguments: list[str] | None = None) -> int:
    """Run the command; returns the exit status."""
    parser = argparse.ArgumentParser(
        prog="wingd-difference",
        description="Subtract a measured shape or a computation from a measured shape, at equal arc lengths from the root. Errors "
        "that both have in common cancel: those of a flight within it, those of the installation between its flights.",
        epilog="Examples: wingd-difference store:f0001/s000001 --against fem.csv; wingd-difference before:f0003 after:f0001",
    )
    parser.add_argument("frames", metavar="FRAMES", help="measured frames, as for wingd-mean; the mean of several")
    parser.add_argument("other", nargs="?", metavar="OTHER", help="frames to subtract")
    parser.add_argument(
        "--against",
        metavar="FILE",
        help="computation to subtract, CSV: arc_length_m and any of displacement_x_m, displacement_y_m, displacement_z_m, slope_deg, twist_deg, streamwise_twist_deg, all as changes from the surveyed state",
    )
    parser.add_argument(
        "--axes",
        choices=("survey", "cad"),
        default="survey",
        help="axes of the computation's displacements [default: survey]",
    )
    parser.add_argument(
        "--load-correction",
        "--slope",
        action="append",
        default=[],
        metavar="FILE:CONDITION",
        help="effect to subtract, so that loads are equal: FILE:weight_kg, FILE:weight_kg=60000 (of the computation) or FILE:DELTA,SIGMA",
    )
    parser.add_argument("--mirror", action="store_true", help="the frames are of the left and the right wing")
    parser.add_argument("--no-thermal", action="store_true", help="without the thermal contraction of the wing")
    parser.add_argument("--full", action="store_true", help="test every combination of the single values")
    add_options(parser)
    parser.set_defaults(eta=None)
    args = parser.parse_args(arguments)
    if (args.other is None) == (args.against is None):
        parser.error("give either OTHER or --against FILE")
    if args.against and args.mirror:
        parser.error("--mirror is for two measured shapes")
    return run_command(lambda: run(args))


def run(args: argparse.Namespace) -> None:
    """Print the difference and its test."""
    from wingd.commands.selection import TENTHS
    from wingd.comparison import compare, difference

    with notes_on_stderr():
        one = read_frames(args.frames, args.where)
        options = {"load": args.load_correction, "thermal": not args.no_thermal}
        if args.against:
            found = compare(one, args.against, eta=args.eta, axes=args.axes, **options)
        else:
            found = difference(
                one, read_frames(args.other, args.where), eta=args.eta or TENTHS, mirror=args.mirror, **options
            )
        test = found.test(args.full)
    if args.json:
        result = {
            "stations": found.table().drop(columns="eta", errors="ignore").to_dict("records"),
            "chi_square": test.chi_square,
        }
        result |= {"freedom": test.freedom, "p": test.p, "combinations": test.combinations.to_dict("records")}
        print(to_json(result | {"bands": test.bands.to_dict("records"), "notes": found.notes}))
        return
    print(found.table().to_string(index=False, float_format=lambda v: f"{v:.4f}"))
    print(test)
    for note in found.notes:
        print(note)
