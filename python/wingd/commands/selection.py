"""Frames as arguments of commands: ``STORE[:FLIGHT[/SERIES[/FRAME]]]`` or an exported file in place of STORE."""

from __future__ import annotations

import argparse
import json
import math
import sys
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from wingd import WingdError, WingdWarning

if TYPE_CHECKING:
    import xarray as xr

#: Stations of tables.
TENTHS = tuple(k / 10 for k in range(1, 11))


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the options of commands that average frames."""
    parser.add_argument(
        "--where",
        metavar="CONDITIONS",
        help="frames by their aircraft data: 'mach between .78 and .80 and weight_t < 190'",
    )
    parser.add_argument(
        "--eta",
        metavar="ETA,ETA",
        type=parse_numbers,
        default=list(TENTHS),
        help="stations as fractions of the length to the tip [default: 0.1, 0.2, ... 1]",
    )
    parser.add_argument("--json", action="store_true", help="print one JSON object")


def parse_numbers(text: str) -> list[float]:
    """Parse numbers between commas."""
    try:
        numbers = [float(part) for part in text.split(",")]
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r}: give numbers between commas, such as 0.5,1") from None
    if not all(map(math.isfinite, numbers)):
        raise argparse.ArgumentTypeError(f"{text!r}: give finite numbers")
    return numbers


def read_frames(text: str, where: str | None = None, installation: str | None = None) -> xr.Dataset:
    """Return the frames that `text` selects."""
    import numpy as np

    import wingd

    place, rest = text, ""
    if not Path(text).exists() and ":" in text.removeprefix("s3://").removeprefix("file://"):
        place, _, rest = text.rpartition(":")
    flight, _, within = rest.partition("/")
    opened = wingd.open(place, installation)
    names = list(opened.names)
    if not flight and len(names) != 1:
        raise WingdError(f"{text}: has the flights {', '.join(names) or 'none'}; name one as {place}:FLIGHT")
    frames = opened[flight or names[0]].frames()
    if within:
        images = np.asarray(frames["image"].values, dtype=str)
        keep = np.flatnonzero((images == within) | np.char.startswith(images, f"{within}/"))
        if not len(keep):
            raise WingdError(f"{text}: no frame with this name has a shape; known are {', '.join(images[:20])}")
        frames = frames.isel(frame=keep)
    return frames.wingd.where(where) if where else frames


def count_frames(shape: xr.Dataset) -> int:
    """Return the number of frames with a shape."""
    import numpy as np

    return int(np.isfinite(shape["sigma_displacement"].values).any(axis=(1, 2)).sum()) if "frame" in shape.dims else 1


def to_json(value: Any) -> str:
    """Return JSON without numbers that JSON lacks: NaN is null."""

    def clean(item: Any) -> Any:
        if isinstance(item, dict):
            return {k: clean(v) for k, v in item.items()}
        if isinstance(item, Sequence) and not isinstance(item, str):
            return [clean(v) for v in item]
        item = item.item() if hasattr(item, "dtype") else item
        return None if isinstance(item, float) and not math.isfinite(item) else item

    return json.dumps(clean(value))


@contextmanager
def notes_on_stderr() -> Iterator[None]:
    """Print warnings of the package as notes on standard error, each once."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", WingdWarning)
        yield
    for text in dict.fromkeys(str(w.message) for w in caught if issubclass(w.category, WingdWarning)):
        print(f"note: {text}", file=sys.stderr)
