"""``wingd-time-check``: check recorded times of exposure with images of a screen that shows the clock."""

from __future__ import annotations

import argparse
import dataclasses
import json
import math
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

from wingd import WingdError
from wingd.commands import run_command


def main(arguments: list[str] | None = None) -> int:
    """Run the command; returns its exit status."""
    parser = argparse.ArgumentParser(
        prog="wingd-time-check",
        description="Check recorded times of exposure with images of a screen that shows the clock, and determine the delay "
        "for [camera].",
    )
    parser.add_argument(
        "source", nargs="*", metavar="STORE|IMAGE", help="store with the images, or images with --times"
    )
    parser.add_argument("--page", metavar="FILE.html", help="write the page that shows the clock, and exit")
    parser.add_argument("--times", metavar="FILE.csv", help="recorded times of IMAGEs: image,utc")
    parser.add_argument("--flight", help="flight of the store, for example f0001 [default: all]")
    parser.add_argument("--series", help="series of the store, for example s000003 [default: all]")
    parser.add_argument(
        "--refresh-hz", type=float, default=60.0, metavar="HZ", help="refresh rate of the screen; the page shows it"
    )
    parser.add_argument(
        "--latency-ms", type=float, default=30.0, metavar="MS", help="latency from drawing to light [default: 30]"
    )
    parser.add_argument("--latency-sigma-ms", type=float, default=40 / math.sqrt(12), metavar="MS",
                        help="standard deviation of the latency [default: uniform between 10 and 50 ms]")  # fmt: skip
    parser.add_argument("--json", action="store_true", help="print a JSON object per image, and a summary")
    parser.add_argument(
        "--jobs", type=int, default=None, metavar="N", help="images in parallel [default: number of cores]"
    )
    args = parser.parse_args(arguments)
    if bool(args.page) == bool(args.source):
        parser.error("give a store or images, or --page alone")
    in_range = 1 <= args.refresh_hz <= 1000 and all(0 <= v <= 1000 for v in (args.latency_ms, args.latency_sigma_ms))
    if not in_range or (args.jobs is not None and args.jobs < 1):
        parser.error(
            "--refresh-hz must be in 1 to 1000, --latency-ms and --latency-sigma-ms in 0 to 1000, --jobs above 0"
        )
    return run_command(lambda: _run(args))


def _run(args: argparse.Namespace) -> int:
    from wingd import timecheck

    if args.page:
        Path(args.page).write_text(timecheck.clock_page(), encoding="utf-8")
        print(f"{args.page}: open it on the recorder's computer, full screen")
        return 0
    screen = timecheck.Screen(1 / args.refresh_hz, 1e-3 * args.latency_ms, 1e-3 * args.latency_sigma_ms)
    if args.times:
        frames = timecheck.listed_frames(args.source, args.times)
    elif len(args.source) > 1 or Path(args.source[0]).is_file():
        raise WingdError("images have no recorded times; give --times FILE.csv (image,utc), or a store")
    else:
        frames = timecheck.stored_frames(args.source[0], args.flight, args.series)

    def read(frame: Any) -> Any:
        try:
            return timecheck.read_frame(frame, screen)
        except WingdError as error:
            return frame, str(error)

    with ThreadPoolExecutor(args.jobs) as pool:
        results = list(pool.map(read, frames))
    readings = [r for r in results if not isinstance(r, tuple)]
    for result in results:
        if isinstance(result, tuple):
            failed = {"image": result[0].name, "status": "failed", "reason": result[1]}
            print(json.dumps(failed) if args.json else f"{failed['image']}: failed: {failed['reason']}")
        elif args.json:
            print(json.dumps(timecheck.reading_record(result, screen)))
    if not readings:
        raise WingdError(
            f"none of {len(frames)} images shows a readable clock; `wingd time-check --page FILE.html` writes the page to photograph"
        )
    summary = timecheck.summarise(readings, len(frames), screen)
    if args.json:
        print(json.dumps({"summary": dataclasses.asdict(summary)}))
    else:
        _print_table(readings, summary, screen)
    return 0 if len(readings) == len(frames) else 1


def _print_table(readings: list[Any], summary: Any, screen: Any) -> None:
    from wingd.conditions.times import format_time

    def ms(seconds: float | None) -> str:
        return "-" if seconds is None else f"{1e3 * seconds:.1f}"

    print(
        "image, exposure on the screen (UTC), sigma / ms, codes, command minus screen / ms, exposure minus screen / ms"
    )
    for r in readings:
        shown = format_time(round(r.shown_us, -3))
        print(f"{r.frame.name}  {shown}  {ms(r.sigma_s)}  {r.codes}  {ms(r.command_s)}  {ms(r.exposure_s)}")
    print(
        f"\n{len(readings)} of {summary.images} images read; the standard deviation of each mean includes "
        f"{ms(screen.latency_sigma_s)} ms for the latency of the screen, common to all images and not in the rows"
    )
    named = (("command minus screen", summary.command), ("exposure minus screen", summary.exposure and summary.exposure.difference),
             ("delay from stamp or edge to exposure", summary.delay))  # fmt: skip
    for name, d in named:
        if d is not None:
            scatter = (
                ""
                if d.scatter_s is None
                else f", scatter {ms(d.scatter_s)} ms, of which {ms(d.read_sigma_s)} ms from reading"
            )
            print(f"{name}: {1e3 * d.mean_s:+.1f} ± {ms(d.mean_sigma_s)} ms{scatter}")
    if summary.exposure is not None:
        verdict = "agrees" if summary.exposure.agrees else "disagrees"
        recorded, normalised = ms(summary.exposure.recorded_s), summary.exposure.normalised
        print(f"recorded standard deviation {recorded} ms: {verdict} ({normalised:.1f} standard deviations)")
    if summary.lines:
        print(f"\nFor {summary.section}:\n{summary.lines}", end="")
    else:
        print(f"\nNo delay to enter in the configuration: {summary.no_lines_because}")
