"""``wingd-upload``: upload flights of a store to an object store."""

from __future__ import annotations

import argparse
import json
import re
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from . import run_command

if TYPE_CHECKING:
    from ..upload import Outcome, Target

#: Exit status for a wrong configuration, as of the program `wingd`.
CONFIGURATION = 78


def _name(text: str) -> str:
    from ..upload.manifest import is_name

    if not is_name(text):
        raise argparse.ArgumentTypeError("give letters, digits, '.', '_', '-' (64 at most, not '.' first)")
    return text


def parse_rate(text: str) -> int:
    """Parse bytes per second; k, M, G are powers of 1000.

    Raises
    ------
    argparse.ArgumentTypeError
        It is no number, or less than 1,000.
    """
    found = re.fullmatch(r"([0-9]{1,12})([kmg]?)", text, re.IGNORECASE)
    rate = int(found[1]) * 1000 ** " kmg".index(found[2].lower() or " ") if found else 0
    if rate < 1_000:
        raise argparse.ArgumentTypeError("give bytes per second, for example 250k or 2M")
    return rate


def _between(least: int, most: int):
    def parse(text: str) -> int:
        if not text.isascii() or not text.isdigit() or not least <= int(text) <= most:
            raise argparse.ArgumentTypeError(f"give a number from {least} to {most}")
        return int(text)

    return parse


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="wingd-upload",
        description="Upload flights to an object store: inventory first, then results, then frames. Never overwrites; an "
        "interrupted upload is resumed. Credentials, region and endpoint are read from the environment: AWS_ACCESS_KEY_ID, "
        "AWS_SECRET_ACCESS_KEY, AWS_REGION, AWS_ENDPOINT_URL, AWS_ALLOW_HTTP.",
        epilog="Example: wingd-upload store --to file:///srv/wings --aircraft D-ABCD. Exit status: 0 success, 1 failure, 2 "
        "wrong usage, 78 wrong destination or credentials.",
    )
    parser.add_argument("store", type=Path, metavar="STORE")
    parser.add_argument("--to", required=True, metavar="URL", help="s3://BUCKET/PREFIX, or file:///DIRECTORY")
    parser.add_argument("--flight", metavar="NAME", help="for example f0001 [default: all flights]")
    parser.add_argument("--aircraft", type=_name, metavar="NAME", help="registration [default: recorder-ID]")
    parser.add_argument("--aircraft-type", type=_name, metavar="TYPE", help="for tables and figures")
    parser.add_argument("--wing", type=_name, metavar="NAME", help="[default: the installation's side]")
    parser.add_argument(
        "--jobs", type=_between(1, 64), default=4, metavar="N", help="maximum number of parallel transfers [4]"
    )
    parser.add_argument("--retries", type=_between(0, 20), default=5, metavar="N", help="of a failed request [5]")
    parser.add_argument(
        "--limit-rate", type=parse_rate, metavar="RATE", help="maximum mean rate, bytes per second, e.g. 250k or 2M"
    )
    parser.add_argument(
        "--repair",
        action="store_true",
        help="replace objects that were changed or damaged at the destination, and restore missing ones",
    )
    parser.add_argument("--json", action="store_true", help="print one JSON object per flight")
    return parser


def main(arguments: list[str] | None = None) -> int:
    """Upload the flights of a store, or the requested one; return the exit status."""
    args = _parser().parse_args(arguments)
    return run_command(lambda: _run(args))


def _run(args: argparse.Namespace) -> int:
    from ..objects import PlaceError
    from ..upload import Labels, Target, upload_flights
    from ..upload.bundle import flights

    try:
        target = Target(args.to, args.jobs, args.retries, args.limit_rate)
    except PlaceError as error:
        print(f"error: {error}", file=sys.stderr)
        return CONFIGURATION
    labels = Labels(args.aircraft, args.aircraft_type, args.wing)
    names = flights(args.store, args.flight)
    bar = _Progress()
    outcomes = upload_flights(args.store, names, target, labels, repair=args.repair, progress=bar.add)
    bar.end()
    for outcome in outcomes:
        _print(outcome, target, as_json=args.json)
    return 0 if all(outcome.error is None for outcome in outcomes) else 1


def _print(outcome: Outcome, target: Target, *, as_json: bool) -> None:
    counts, manifest = outcome.counts, outcome.manifest
    if outcome.error is not None or manifest is None:
        print(f"error: {outcome.flight}: {outcome.error}", file=sys.stderr)
        failed = {"flight": outcome.flight, "status": "failed", "reason": str(outcome.error)}
        print(json.dumps(failed, ensure_ascii=False) if as_json else f"{outcome.flight}  not completely uploaded")
        return
    fields, url = manifest.fields, target.shown(manifest.key)
    if as_json:
        about = {key: fields[key] for key in ("recorder", "aircraft", "aircraft_type", "wing")}
        number = {key: getattr(counts, key) for key in ("objects", "bytes", "sent", "sent_bytes", "repaired")}
        line = {"flight": outcome.flight, "status": "ok", **about, **number, "aged": counts.expired, "manifest": url}
        print(json.dumps(line, ensure_ascii=False))
        return
    more = f", {counts.repaired} replacing damaged ones" if counts.repaired else ""
    more += f", {counts.expired} frames expired at the destination" if counts.expired else ""
    print(
        f"{outcome.flight}  {fields['aircraft']}: {counts.objects} objects ({counts.bytes / 1e6:.1f} MB) uploaded, "
        f"{counts.sent} of them now ({counts.sent_bytes / 1e6:.1f} MB){more}: {url}"
    )


class _Progress:
    """A line with the uploaded bytes, on a terminal only."""

    def __init__(self) -> None:
        self.shown, self.bytes = sys.stderr.isatty(), 0

    def add(self, length: int) -> None:
        self.bytes += length
        if self.shown:
            print(f"\rupload: {self.bytes / 1e6:.1f} MB", end="", file=sys.stderr, flush=True)

    def end(self) -> None:
        if self.shown:
            print("\r\033[K", end="", file=sys.stderr, flush=True)


if __name__ == "__main__":
    sys.exit(main())
