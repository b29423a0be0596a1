"""``wingd-mean``: average measured shapes, also by conditions of the flight."""

from __future__ import annotations

import argparse

from wingd.commands import run_command
from wingd.commands.selection import add_options, count_frames, notes_on_stderr, read_frames, to_json


def main(arguments: list[str] | None = None) -> int:
    """Run the command; returns the exit status."""
    parser = argparse.ArgumentParser(
        prog="wingd-mean",
        description="Average the shapes of frames. Errors that the frames share stay in the standard deviation; scatter is that "
        "of single frames about the mean of their flight.",
        epilog="Example: wingd-mean store:f0001/s000001 --eta 0.5,1",
    )
    parser.add_argument(
        "frames",
        nargs="+",
        metavar="FRAMES",
        help="STORE, STORE:FLIGHT, STORE:FLIGHT/SERIES or STORE:FLIGHT/SERIES/FRAME, or an exported file in place of STORE; several flights count equally",
    )
    add_options(parser)
    args = parser.parse_args(arguments)
    return run_command(lambda: run(args))


def run(args: argparse.Namespace) -> None:
    """Print the mean."""
    from wingd.comparison import shape_quantities, station_table
    from wingd.shapes import mean

    with notes_on_stderr():
        shapes = [read_frames(text, args.where) for text in args.frames]
        frames = [s for s in shapes for s in _single_flights(s)]
        keys = [key for s in frames for key in s["own_sources"].values.ravel()]
        if len(keys) != len(set(keys)):
            from wingd import WingdError

            raise WingdError("a frame is named twice; name each once")
        average = mean(frames)
        quantities = {k: v.sel(eta=args.eta) for k, v in shape_quantities(average).items()}
        scatter = {k: _scatter(average, k, args.eta) for k in quantities}
    table = station_table(quantities, {"scatter_": {k: v for k, v in scatter.items() if v is not None}})
    count = sum(count_frames(s) for s in shapes)
    if args.json:
        print(to_json({"frames": count, "stations": table.to_dict("records")}))
        return
    print(table.to_string(index=False, float_format=lambda v: f"{v:.4f}"))
    flights = len(
        {(str(r), str(f)) for s in frames for r, f in zip(s["lasting_sources"].values, s["flight"].values, strict=True)}
    )
    print(f"mean of {count} frame{'s' * (count != 1)} of {flights} flight{'s' * (flights != 1)}")


def _single_flights(shape):
    import numpy as np

    flights = shape["flight"].values
    known = np.isfinite(shape["sigma_displacement"].values).any(axis=(1, 2))
    return [shape.isel(frame=np.flatnonzero((flights == f) & known)) for f in dict.fromkeys(flights[known])]


def _scatter(average, quantity: str, eta: list[float]):
    from wingd.values import Values

    name = f"scatter_{quantity.removesuffix('_z')}"
    if name not in average:
        return None
    array = average[name].sel(axis="z") if quantity.endswith("_z") else average[name]
    return Values(array.drop_vars("axis", errors="ignore")).sel(eta=eta).value.values
