"""``wingd-convert``: convert cameras from or to the files of OpenCV, ROS, Kalibr and mrcal, and boards of Kalibr."""

from __future__ import annotations

import argparse

from wingd.commands import run_command


def main(arguments: list[str] | None = None) -> int:
    """Run the command; returns its exit status."""
    parser = argparse.ArgumentParser(
        prog="wingd-convert",
        description="Convert a camera from or to the files of OpenCV, ROS, Kalibr and mrcal, or a board of Kalibr to board.toml.",
    )
    parser.add_argument("input", metavar="IN", help="camera file, or a target of Kalibr")
    parser.add_argument("output", metavar="OUT", help="camera.toml, NAME.cameramodel, camchain.yaml, camera_info.yaml, "
                        "NAME.yaml (OpenCV), or board.toml")  # fmt: skip
    formats = ["wingd", "opencv", "ros", "kalibr", "mrcal"]
    parser.add_argument("--camera", metavar="NAME", help="camera of IN if it holds several: Kalibr's cam0, cam1")
    parser.add_argument("--from", dest="source", choices=formats, help="format of IN if it is not detected")
    parser.add_argument("--to", choices=formats, help="format of OUT if its name does not determine it")
    args = parser.parse_args(arguments)
    return run_command(lambda: _run(args))


def _run(args: argparse.Namespace) -> None:
    from wingd import cameras

    if args.source is None and cameras.is_kalibr_board(args.input):
        board = cameras.read_kalibr_board(args.input)
        cameras.write_board(args.output, board)
        print(
            f"{args.input}: Kalibr's {board['pattern']}, {board['columns']} x {board['rows']}\n{args.output}: written"
        )
        return
    read = cameras.read_camera(args.input, args.source, args.camera)
    to = cameras.write_camera(args.output, read.camera, args.to)
    c = read.camera
    print(", ".join([f"{args.input}: {cameras.FORMATS[read.format]}", *filter(None, [read.name, read.model])]))
    print(f"  {c.width} x {c.height} px, fx {c.fx} fy {c.fy} cx {c.cx} cy {c.cy} px")
    rest = f" k4 {c.k4} k5 {c.k5} k6 {c.k6}" if c.is_rational else ""
    print(f"  k1 {c.k1} k2 {c.k2} p1 {c.p1} p2 {c.p2} k3 {c.k3}{rest}")
    print(f"  dropped: {', '.join(read.dropped) or 'nothing'}")
    for remark in read.remarks:
        print(f"  warning: {remark}")
    print(f"{args.output}: written, {cameras.FORMATS[to]}")
