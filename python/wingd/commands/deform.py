"""``wingd-deform``: move the nodes of a surface by the measured shape of the wing."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import numpy as np

from wingd.commands import run_command
from wingd.commands.selection import notes_on_stderr, read_frames


def main(arguments: list[str] | None = None) -> int:
    """Run the command; returns its exit status."""
    parser = argparse.ArgumentParser(prog="wingd-deform", description="Move the nodes of a surface from CAD, CFD or FEM "
                                     "by the measured shape of the wing, section by section.")  # fmt: skip
    parser.add_argument("frames", metavar="FRAMES", help="measured frames, as for wingd-mean; the mean of several")
    parser.add_argument("--surface", required=True, metavar="FILE",
                        help="wing.stl, nodes.csv, model.bdf, mesh.su2:MARKER,MARKER, or a mesh of VTK, PLY, OBJ")  # fmt: skip
    parser.add_argument("--unit", choices=["m", "cm", "mm", "in", "ft"], help="unit of the surface [default: m]")
    parser.add_argument("--axes", choices=["survey", "cad"], default="survey", help="axes of the surface")
    parser.add_argument("--id", default="id", metavar="COLUMN", help="column of a list with the numbers of the nodes")
    parser.add_argument("--installation", metavar="DIR", help="installation of a store [default: the one kept in it]")
    parser.add_argument("--frame", metavar="NAME", help="frame, for example s000001/0001.jpg [default: the mean]")
    parser.add_argument("--draws", type=int, default=0, metavar="N", help="write N sampled surfaces, too")
    parser.add_argument("--seed", type=int, default=1, help="seed of the samples")
    parser.add_argument(
        "--without-thermal", action="store_true", help="move the wing without its contraction by temperature"
    )
    parser.add_argument("-o", "--output", required=True, metavar="DIR", help="folder of the files")
    args = parser.parse_args(arguments)
    if not 0 <= args.draws <= 1000:
        parser.error("--draws: give a number from 0 to 1000")
    return run_command(lambda: _run(args))


def _run(args: argparse.Namespace) -> int:
    from wingd import surfaces

    surface = surfaces.read_surface(args.surface, args.unit, args.id)
    with notes_on_stderr():
        shape = read_frames(args.frames, installation=args.installation)
    moved = surfaces.deform(
        shape, surface, args.frame, args.axes, thermal=not args.without_thermal, draws=args.draws, seed=args.seed
    )
    for note in moved.notes:
        print(f"note: {note}", file=sys.stderr)
    written = surfaces.write_files(moved, args.output)
    for k, one in enumerate(moved.draws, 1):
        written += surfaces.write_files(one, Path(args.output) / f"draw-{k:03}")
    for file in written:
        print(file)
    length = np.linalg.norm(moved.displacement_m, axis=1)
    k = int(np.argmax(length))
    sigma = float(np.linalg.norm(moved.sigma_m[k]))
    outboard = int((moved.arc_m > 0).sum())
    name = args.frame or f"mean of {shape.sizes['frame']} frames"
    print(f"{name}: {outboard} of {len(length)} nodes moved, by at most {length[k]:.3f} ± {sigma:.3f} m; "
          f"markers {moved.marker_distance_m:.2f} m from the surface")  # fmt: skip
    return 1 if moved.folded else 0
