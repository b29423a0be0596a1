"""Check of recorded times of exposure with images of a screen that shows the clock, and the delay of the camera from them."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from wingd import WingdError
from wingd.conditions.times import format_time, parse_time
from wingd.textfiles import fault, read_table, read_text
from wingd.timecheck.code import DIGITS, MARGIN, SIDE, page_tables
from wingd.timecheck.delay import DelayEstimate, ExposureTest, Screen, check_exposures, estimate_delay
from wingd.timecheck.images import TICK_MS, read_image, read_time

#: Largest difference of screen and recorder, s: longer than a shot takes.
MAX_OFFSET_S = 60.0
#: Fewest images for a delay.
MIN_IMAGES = 5
#: Key of the configuration and its section, by the evidence of the exposure.
_KEYS = {
    **dict.fromkeys(("start_of_exposure", "end_of_frame"), ("stamp_delay", 'the section with kind = "v4l"')),
    **dict.fromkeys(("release_edge", "trigger_and_event"),
                    ("exposure_delay", '[camera] with kind = "release" (a camera on USB alone has no such key)')),
}  # fmt: skip


@dataclass(frozen=True)
class Frame:
    """Image with its recorded times, microseconds since 1970, and the record of its exposure."""

    name: str
    file: Path
    command_us: int
    exposure_us: int | None = None
    exposure_sigma_s: float | None = None
    delay_s: float | None = None
    source: str | None = None


@dataclass(frozen=True)
class Reading:
    """Clock in one image.

    Attributes
    ----------
    shown_us, sigma_s
        Middle of the exposure by the screen (microseconds since 1970), and its standard deviation without the latency, s.
    command_s, exposure_s
        Command to the camera, and recorded exposure, minus the screen, s.
    """

    frame: Frame
    shown_us: int
    sigma_s: float
    codes: int
    command_s: float
    exposure_s: float | None

    @property
    def delay_s(self) -> float | None:
        """Delay from the recorded event (stamp, edge, trigger) to the exposure by the screen, s."""
        recorded = self.frame.delay_s
        return None if recorded is None or self.exposure_s is None else recorded - self.exposure_s


@dataclass(frozen=True)
class Summary:
    """Differences from the screen, test of the recorded exposures, delay, and lines for the configuration or why there are none."""

    images: int
    command: DelayEstimate | None
    exposure: ExposureTest | None
    delay: DelayEstimate | None
    lines: str | None
    section: str | None
    no_lines_because: str | None


def clock_page() -> str:
    """Return the page that shows the clock: a single file that needs no server."""
    page = (Path(__file__).parent / "clock.html").read_text(encoding="utf-8")
    base, inverted = page_tables()
    values = {"BASE": base, "INVERTED": inverted, "SIDE": SIDE, "MARGIN": MARGIN, "SIZE": SIDE + 2 * MARGIN, "TICK_MS": TICK_MS,
              "DIGITS": DIGITS}  # fmt: skip
    for name, value in values.items():
        page = page.replace(f"{{{{{name}}}}}", json.dumps(value, separators=(",", ":")))
    return page


def stored_frames(store: Path | str, flight: str | None = None, series: str | None = None) -> list[Frame]:
    """Return the frames of a store in order, of one flight and series if they are given.

    Raises
    ------
    WingdError
        The folder is not a store, a record cannot be read, or there is no frame.
    """
    root = Path(store)
    if not (root / "store.toml").exists():
        raise fault(root, "is not a store: store.toml is missing", "name a store, or images with --times")
    frames: list[Frame] = []
    for record in sorted(root.glob(f"flights/{flight or '*'}/{series or '*'}/series.json")):
        try:
            shots = json.loads(read_text(record))["shots"]
            frames += [f for shot in shots if (f := _frame(record.parent, shot)) is not None]
        except (ValueError, KeyError, TypeError, AttributeError) as error:
            raise fault(record, f"is not the record of a series ({error!r})", "run `wingd verify STORE`") from None
    if not frames:
        raise fault(root, "has no frame of that flight and series", "list them with `ls flights/*` in the store")
    return frames


def _frame(folder: Path, shot: dict[str, Any]) -> Frame | None:
    if not shot.get("frame"):
        return None
    name, exposure = str(shot["frame"]["file"]), shot.get("exposure") or {}
    if Path(name).name != name:
        raise ValueError(f"file {name}")
    command = parse_time(shot["stamp"]["utc"], "utc")
    if command is None:
        raise ValueError(f"utc {shot['stamp']['utc']}")
    at = parse_time(exposure["exposure_time"], "utc") if exposure else None
    sigma, delay = exposure.get("exposure_sigma_s"), exposure.get("exposure_delay_s")
    return Frame(f"{folder.name}/{name}", folder / name, command, at, sigma, delay, exposure.get("exposure_source"))


def listed_frames(images: Sequence[Path | str], times: Path | str) -> list[Frame]:
    """Return images with their recorded times of a table ``image,utc``.

    Raises
    ------
    WingdError
        An image has no time in the table.
    """
    header, rows = read_table(times, "image,utc")
    if not {"image", "utc"} <= set(header.cells):
        raise fault(times, "has no columns image and utc", "write the header image,utc", line=header.line)
    image, utc = header.cells.index("image"), header.cells.index("utc")
    found: dict[str, int] = {}
    for row in rows:
        time = parse_time(row.cells[utc], "utc")
        if time is None:
            raise fault(times, f"has no time ({row.cells[utc]})", "write it as 2026-06-01T08:00:00.25Z", line=row.line)
        if found.setdefault(row.cells[image], time) != time:
            raise fault(times, f"gives {row.cells[image]} two times", "keep the valid line", line=row.line)
    frames = []
    for path in map(Path, images):
        key = str(path) if str(path) in found else path.name
        if key not in found:
            raise fault(times, f"has no line of {path.name}", "add it")
        frames.append(Frame(path.name, path, found[key], found[key], 0.0, 0.0))
    return frames


def read_frame(frame: Frame, screen: Screen) -> Reading:
    """Read the clock in a frame.

    Raises
    ------
    WingdError
        The image shows no readable clock, or another one than the recorder's.
    """
    shown = read_time(read_image(frame.file))
    shown_us = round(1e3 * shown.middle_ms + 1e6 * screen.display_delay_s)
    recorded_us = frame.command_us if frame.exposure_us is None else frame.exposure_us
    later_s = 1e-6 * (shown_us - recorded_us)
    if abs(later_s) > MAX_OFFSET_S:
        raise WingdError(
            f"the screen differs from the recorder's clock by {later_s:+.0f} s; show the recorder's own clock"
        )
    exposure_s = None if frame.exposure_us is None else 1e-6 * (frame.exposure_us - shown_us)
    sigma_s = screen.read_sigma_s(1e-3 * shown.width_ms)
    return Reading(frame, shown_us, sigma_s, shown.codes, 1e-6 * (frame.command_us - shown_us), exposure_s)


def summarise(readings: Sequence[Reading], images: int, screen: Screen) -> Summary:
    """Estimate the differences and the delay from the readings of a number of images."""

    def over(values: list[float | None]) -> DelayEstimate | None:
        pairs = [(v, r.sigma_s) for v, r in zip(values, readings, strict=True) if v is not None]
        return estimate_delay(pairs, screen.systematic_s)

    difference, delay = over([r.exposure_s for r in readings]), over([r.delay_s for r in readings])
    sigmas = [r.frame.exposure_sigma_s for r in readings if r.frame.exposure_sigma_s is not None]
    exposure = None if difference is None else check_exposures(difference, sigmas)
    lines, section, why = _configuration(readings, delay)
    return Summary(images, over([r.command_s for r in readings]), exposure, delay, lines, section, why)


def _configuration(
    readings: Sequence[Reading], delay: DelayEstimate | None
) -> tuple[str | None, str | None, str | None]:
    """Return the lines for the configuration and their section, or why there are none."""
    sources = {r.frame.source for r in readings if r.frame.source is not None}
    if not sources:
        return None, None, "the record has no times of exposure"
    if len(sources) > 1:
        return None, None, "the times of exposure come from different sources; choose one --series"
    key, section = _KEYS.get(sources.pop() or "", (None, None))
    if key is None:
        return None, None, "the camera reports no event at the exposure, so there is no delay to configure"
    if delay is None:
        return None, None, "the images were recorded without the delay that was configured then; record them again"
    if delay.sigma_s is None or delay.images < MIN_IMAGES:
        return None, None, f"{delay.images} images are too few; {MIN_IMAGES} are needed"
    return f"{key}_s = {delay.mean_s:.4f}\n{key}_sigma_s = {delay.sigma_s:.4f}\n", section, None


def reading_record(reading: Reading, screen: Screen) -> dict[str, Any]:
    """Return an image's reading as JSON; its standard deviations include the latency of the screen."""
    sigma_s = (reading.sigma_s**2 + screen.latency_sigma_s**2) ** 0.5
    recorded = reading.frame.exposure_sigma_s
    return {
        "image": reading.frame.name,
        "status": "ok",
        "shown_time": format_time(reading.shown_us),
        "sigma_shown_s": sigma_s,
        "codes": reading.codes,
        "command_less_shown_s": reading.command_s,
        "sigma_command_less_shown_s": sigma_s,
        "exposure_less_shown_s": reading.exposure_s,
        "sigma_exposure_less_shown_s": None if recorded is None else (recorded**2 + sigma_s**2) ** 0.5,
        "exposure_sigma_s": recorded,
        "exposure_source": reading.frame.source,
        "delay_s": reading.delay_s,
    }
