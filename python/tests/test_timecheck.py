"""Promise: the clock on a screen is read within its standard deviation or not at all, and delays are those of the truth."""

from __future__ import annotations

import json
import math
import shutil
import subprocess
from pathlib import Path

import cv2
import numpy as np
import pytest

from wingd import WingdError
from wingd.commands.time_check import main
from wingd.conditions.times import format_time
from wingd.timecheck import TICK_MS, Screen, check_exposures, clock_page, estimate_delay, read_time, summarise
from wingd.timecheck.check import Frame, Reading
from wingd.timecheck.code import MARGIN, SIDE, encode
from wingd.timecheck.images import ShownTime, time_of_codes

#: About 22 November 2026.
BEGIN_S = 1_795_300_000.0
REFRESH_S = 1 / 60
SCREEN = Screen()


def shown_time(now_ms: float, code: int) -> int:
    """What the page shows; the test with node compares it with the page's own function."""
    return int(math.floor((now_ms - code * TICK_MS) / (2 * TICK_MS))) * 2 * TICK_MS + code * TICK_MS


class Display:
    """Screen with a latency, whose frames begin at a phase; it shows what was drawn at the beginning of a frame."""

    def __init__(self, latency_s: float, phase_s: float) -> None:
        self.latency_s, self.phase_s = latency_s, phase_s

    def states(self, middle_s: float, exposure_s: float) -> list[tuple[float, tuple[int, int]]]:
        """Fractions of an exposure in which the screen shows a pair of times."""
        moments = middle_s + exposure_s * ((np.arange(300) + 0.5) / 300 - 0.5)
        frames = np.floor((moments - self.latency_s - self.phase_s) / REFRESH_S)
        found: dict[tuple[int, int], float] = {}
        for frame in frames:
            drawn_ms = 1e3 * (self.phase_s + frame * REFRESH_S)
            state = (shown_time(drawn_ms, 0), shown_time(drawn_ms, 1))
            found[state] = found.get(state, 0) + 1 / len(frames)
        return [(share, state) for state, share in found.items()]

    def readable(self, middle_s: float, exposure_s: float, least: float = 0.95) -> set[str]:
        """Texts of the codes that are at rest for this fraction of an exposure."""
        states = self.states(middle_s, exposure_s)
        out = set()
        for code in (0, 1):
            for time in {state[code] for _, state in states}:
                if sum(share for share, state in states if state[code] == time) >= least:
                    out.add(f"{time}{code}")
        return out


def photograph(display: Display, middle_s: float, exposure_s: float, random: np.random.Generator) -> np.ndarray:
    """An image of the page: turned, blurred, noisy, with uneven light."""
    light = np.zeros((29 * 12, 2 * 29 * 12 + 120))
    for share, state in display.states(middle_s, exposure_s):
        page = np.ones_like(light)
        for code in (0, 1):
            modules = np.pad(~encode(state[code], code), MARGIN, constant_values=True).astype(float)
            big = cv2.resize(modules, None, fx=12, fy=12, interpolation=cv2.INTER_NEAREST)
            left = code * (29 * 12 + 120)
            page[:, left : left + big.shape[1]] = big
        light += share * page
    light = np.pad(light, 60, constant_values=1.0)
    h, w = light.shape
    corners = np.array([[0, 0], [w, 0], [w, h], [0, h]], np.float32)
    aim = np.array([[120, 180], [1080, 180], [1080, 700], [120, 700]], np.float32) + random.uniform(
        -45, 45, (4, 2)
    ).astype(np.float32)
    image = cv2.warpPerspective(light, cv2.getPerspectiveTransform(corners, aim), (1200, 900), borderValue=0.1)
    image = cv2.GaussianBlur(image, (0, 0), random.uniform(0.5, 1.6))
    uneven = random.uniform(0.7, 1.0) + random.uniform(-0.2, 0.2) * np.linspace(-1, 1, 1200)
    image = 255 * (0.05 + 0.75 * image * uneven) ** (1 / random.uniform(1.4, 2.4)) + random.normal(
        0, random.uniform(1, 5), image.shape
    )
    return np.clip(image, 0, 255).astype(np.uint8)


def test_the_instant_of_exposure_is_read_within_its_standard_deviation() -> None:
    random = np.random.default_rng(31)
    both, one, unread = [], [], 0
    for _ in range(45):
        display = Display(random.uniform(0.01, 0.05), random.uniform(0, REFRESH_S))
        # From 0.2 ms to two thirds of a tick.
        exposure_s = 0.0002 * 133 ** random.uniform()
        middle_s = BEGIN_S + random.uniform(0, 3000)
        try:
            shown = read_time(photograph(display, middle_s, exposure_s, random))
        except WingdError:
            unread += 1
            continue
        error_s = 1e-3 * shown.middle_ms + display.latency_s + 0.5 * REFRESH_S - middle_s
        # Both parts are uniform; a code is read if it is at rest for most of the exposure.
        assert abs(error_s) < 0.5 * (1e-3 * shown.width_ms + REFRESH_S) + 0.5 * exposure_s, (shown, exposure_s, error_s)
        (both if shown.codes == 2 else one).append(error_s / SCREEN.read_sigma_s(1e-3 * shown.width_ms))
    rms = math.sqrt(np.mean(np.square(both)))
    print(f"{len(both)} with both codes, normalised rms {rms:.2f}; {len(one)} with one; {unread} unread")
    assert len(both) >= 28 and unread <= 2 and 0.7 < rms < 1.3, (len(both), len(one), unread, rms)
    assert not one or np.max(np.abs(one)) < math.sqrt(3)


def test_a_delay_is_recovered_with_the_latency_of_the_screen_in_its_standard_deviation() -> None:
    random, squares, read = np.random.default_rng(32), [], 0
    for _ in range(60):
        display = Display(random.uniform(0.01, 0.05), random.uniform(0, REFRESH_S))
        truth_s, jitter_s = random.uniform(-0.1, 0.1), random.uniform(0, 0.01)
        delays = []
        for _ in range(30):
            middle_s = BEGIN_S + random.uniform(0, 2000)
            event_s = middle_s - truth_s - jitter_s * random.standard_normal()
            codes = display.readable(middle_s, 0.004)
            if codes:
                shown = time_of_codes(codes)
                told_s = 1e-3 * shown.middle_ms + SCREEN.display_delay_s
                delays.append((told_s - event_s, SCREEN.read_sigma_s(1e-3 * shown.width_ms)))
        read += len(delays)
        found = estimate_delay(delays, SCREEN.systematic_s)
        assert found is not None and found.sigma_s is not None and found.sigma_s >= found.mean_sigma_s
        squares.append(((found.mean_s - truth_s) / found.mean_sigma_s) ** 2)
    rms = math.sqrt(np.mean(squares))
    print(f"normalised rms {rms:.2f}, {read} of {60 * 30} read")
    assert read > 0.99 * 60 * 30 and 0.7 < rms < 1.3, (read, rms)


def test_a_hidden_or_mixed_clock_is_named_and_never_misread() -> None:
    random = np.random.default_rng(33)
    with pytest.raises(WingdError, match="no code of the clock can be read"):
        read_time(np.full((300, 400), 200, np.uint8))
    right = refused = 0
    for _ in range(24):
        display = Display(0.03, random.uniform(0, REFRESH_S))
        middle_s, exposure_s = BEGIN_S + random.uniform(0, 3000), 0.001 * 200 ** random.uniform()
        image = photograph(display, middle_s, exposure_s, random)
        cv2.circle(
            image,
            (int(random.integers(200, 1000)), int(random.integers(200, 700))),
            int(random.integers(10, 260)),
            int(random.choice([0, 255])),
            -1,
        )
        try:
            shown = read_time(image)
        except WingdError as error:
            refused += 1
            assert "; " in str(error)
            continue
        right += 1
        error_s = 1e-3 * shown.middle_ms + 0.03 + 0.5 * REFRESH_S - middle_s
        assert abs(error_s) < 0.5 * (1e-3 * shown.width_ms + REFRESH_S) + 0.5 * exposure_s, (shown, error_s, exposure_s)
    assert right >= 6 and refused >= 3, (right, refused)


def test_codes_that_no_moment_shows_are_refused() -> None:
    time = 22_441_250_000 * 2 * TICK_MS
    assert time_of_codes({f"{time}0", f"{time + TICK_MS}1"}) == ShownTime(time + 1.5 * TICK_MS, TICK_MS, 2)
    assert time_of_codes({f"{time}0", f"{time - TICK_MS}1"}) == ShownTime(time + 0.5 * TICK_MS, TICK_MS, 2)
    assert time_of_codes({f"{time}0"}) == ShownTime(time + TICK_MS, 2 * TICK_MS, 1)
    for texts, words in (
        ({f"{time}0", f"{time + 3 * TICK_MS}1"}, "the codes are 120 ms apart, not 40; shorten the exposure"),
        ({f"{time}0", f"{time + 2 * TICK_MS}0"}, "a code is not one of this clock"), ({f"{time + 1}0"}, "a code is not one of this clock"),
        ({f"{time}7"}, "no code of the clock"), (set(), "no code of the clock"),
    ):  # fmt: skip
        with pytest.raises(WingdError, match=words):
            time_of_codes(texts)


def test_scatter_beyond_the_reading_error_is_attributed_to_the_delay() -> None:
    """The values of the program's own test."""

    def jumps(far: float) -> list[tuple[float, float]]:
        return [(0.05 + (far if k % 2 == 0 else -far), 0.005) for k in range(200)]

    found = estimate_delay(jumps(0.02), 0.0)
    assert found.mean_s == pytest.approx(0.05, abs=1e-12)
    assert found.sigma_s == pytest.approx(math.sqrt(0.02**2 - 0.005**2), abs=3e-4)
    still = estimate_delay(jumps(0.005), 0.01)
    assert still.mean_sigma_s == pytest.approx(0.01, abs=1e-4) and still.sigma_s < 0.011
    one = estimate_delay([(0.05, 0.005)], 0.0)
    assert estimate_delay([], 0.0) is None and (one.sigma_s, one.scatter_s, one.mean_sigma_s) == (None, None, 0.005)
    assert not check_exposures(estimate_delay(jumps(0.02), 1.0), [0.001]).agrees, "the scatter"
    assert check_exposures(estimate_delay(jumps(0.005), 0.02), [0.01]).agrees


def readings(n: int, source: str, late_s: float) -> list[Reading]:
    frame = Frame("a", Path("a"), 0, 0, 0.005, 0.02, source)
    return [Reading(frame, 0, 0.007, 2, late_s - 0.5, late_s + (0.003 if k % 2 == 0 else -0.003)) for k in range(n)]


def test_an_exposure_that_is_recorded_too_late_shortens_the_delay() -> None:
    screen = Screen(1 / 60, 0.03, 0.0)
    found = summarise(readings(20, "end_of_frame", 0.05), 20, screen)
    assert not found.exposure.agrees and found.lines.startswith("stamp_delay_s = -0.0300\nstamp_delay_sigma_s = 0.00")
    found = summarise(readings(20, "release_edge", 0.004), 20, screen)
    assert (
        found.exposure.agrees and found.lines.startswith("exposure_delay_s = 0.0160\n") and "release" in found.section
    )
    for some, words in (
        (readings(20, "asked_and_delivered", 0.0), "reports no event"), (readings(4, "end_of_frame", 0.0), "4 images are too few"),
        (readings(5, "end_of_frame", 0.0) + readings(5, "release_edge", 0.0), "different sources"),
    ):  # fmt: skip
        found = summarise(some, len(some), screen)
        assert found.lines is None and words in found.no_lines_because


def test_the_page_is_self_contained_and_draws_the_codes(tmp_path: Path) -> None:
    page = clock_page()
    assert "{{" not in page and "http" not in page and "src=" not in page and page.count("<canvas") == 2
    assert len(page) < 40_000
    node = shutil.which("node")
    if node is None:
        pytest.skip("node is not installed: the page's script is not run")
    script = page.split("<script>")[1].split("</script>")[0]
    times = [1_795_300_000_000, 1_795_300_123_456, 9_999_999_999_999, 0, 7]
    (tmp_path / "clock.js").write_text(script)
    (tmp_path / "run.js").write_text(
        "const c = require('./clock.js');"
        f"console.log(JSON.stringify({times}.map(t => [0, 1].map(k => [c.encode(t, k), c.shownTime(t, k)]))));"
    )
    done = subprocess.run([node, "run.js"], cwd=tmp_path, capture_output=True, text=True, check=True)
    for time, codes in zip(times, json.loads(done.stdout), strict=True):
        for code, (rows, shown) in enumerate(codes):
            drawn = np.array([[row >> (SIDE - 1 - x) & 1 for x in range(SIDE)] for row in rows], bool)
            assert (drawn == encode(time, code)).all() and shown == shown_time(time, code)


def test_the_codes_are_those_of_another_encoder() -> None:
    """OpenCV's encoder chooses the mask by itself: the same text is read back from both."""
    for k in range(40):
        time = 1_795_300_000_000 + 7_919 * k**3
        image = np.pad(~encode(time, k % 2), MARGIN, constant_values=True).astype(np.uint8) * 255
        text, _, _ = cv2.QRCodeDetector().detectAndDecode(
            cv2.resize(image, None, fx=8, fy=8, interpolation=cv2.INTER_NEAREST)
        )
        assert text == f"{time:013d}{k % 2}"


@pytest.fixture
def store(tmp_path: Path) -> tuple[Path, float]:
    """A store whose record puts each exposure 80 ms after the truth: a stamp whose delay of 20 ms is -60 ms."""
    random = np.random.default_rng(7)
    folder = tmp_path / "store" / "flights" / "f0001" / "s000001"
    folder.mkdir(parents=True)
    (tmp_path / "store" / "store.toml").write_text("format = 2\n")
    display, shots = Display(0.03, 0.004), []
    for k in range(8):
        middle_s = BEGIN_S + 10 * k + random.uniform()
        cv2.imwrite(str(folder / f"{k:04}.png"), photograph(display, middle_s, 0.002, random))
        stamp = {"utc": format_time(round(1e6 * (middle_s - 0.3)))}
        exposure = {"exposure_time": format_time(round(1e6 * (middle_s + 0.08))), "exposure_sigma_s": 0.005, "exposure_delay_s": 0.02,
                    "exposure_source": "end_of_frame"}  # fmt: skip
        shots.append({"stamp": stamp, "exposure": exposure, "frame": {"file": f"{k:04}.png"}})
    shots.append({"stamp": stamp, "exposure": None, "frame": None})
    (folder / "series.json").write_text(json.dumps({"shots": shots}))
    return tmp_path / "store", -0.06


def test_the_command_reads_a_store(store: tuple[Path, float], capsys: pytest.CaptureFixture[str]) -> None:
    root, truth_s = store
    assert main([str(root), "--json"]) == 0
    lines = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert (
        len(lines) == 9
        and all(line["status"] == "ok" for line in lines[:-1])
        and lines[0]["image"] == "s000001/0000.png"
    )
    delay = lines[-1]["summary"]["delay"]
    assert abs(delay["mean_s"] - truth_s) < 2.5 * delay["mean_sigma_s"] < 0.05, delay
    assert not lines[-1]["summary"]["exposure"]["agrees"]
    assert main([str(root), "--series", "s000001", "--latency-sigma-ms", "1"]) == 0
    printed = capsys.readouterr().out
    assert "8 of 8 images read" in printed and "stamp_delay_s = -0.0" in printed and "disagrees" in printed
    (root / "flights/f0001/s000001/0003.png").write_bytes(b"no image")
    cv2.imwrite(str(root / "flights/f0001/s000001/0004.png"), np.full((200, 300), 90, np.uint8))
    assert main([str(root)]) == 1
    printed = capsys.readouterr().out
    assert "s000001/0003.png: failed: " in printed and "is not an image that can be decoded" in printed
    assert "s000001/0004.png: failed: no code of the clock can be read" in printed and "6 of 8 images read" in printed


def test_other_inputs_are_named(store: tuple[Path, float], tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    root, _ = store
    folder = root / "flights/f0001/s000001"

    def refused(words: str, *call: str) -> None:
        assert main(list(call)) == 1
        error = capsys.readouterr().err
        assert words in error and error.count("\n") == 1 and "; " in error, error

    images = [str(folder / f"{k:04}.png") for k in range(3)]
    refused("give --times FILE.csv", *images)
    (tmp_path / "times.csv").write_text(
        "image,utc\n" + "".join(f"{k:04}.png,{format_time(round(1e6 * (BEGIN_S + 10 * k + 0.5)))}\n" for k in range(3))
    )
    assert main([*images, "--times", str(tmp_path / "times.csv")]) == 0
    assert "3 of 3 images read" in capsys.readouterr().out
    (tmp_path / "times.csv").write_text("image,utc\n0000.png,2026-06-01T08:00:00Z\n")
    refused("has no line of 0001.png", *images, "--times", str(tmp_path / "times.csv"))
    refused("none of 1 images shows a readable clock", images[0], "--times", str(tmp_path / "times.csv"))
    refused("is not a store", str(tmp_path))
    refused("has no frame of that flight and series", str(root), "--flight", "f0009")
    (folder / "series.json").write_text("{")
    refused("is not the record of a series", str(root))
    page = tmp_path / "clock.html"
    assert main(["--page", str(page)]) == 0 and page.read_text() == clock_page()
    for call in ([], [str(root), "--page", "x"], [str(root), "--refresh-hz", "0"], [str(root), "--latency-ms", "-1"]):
        with pytest.raises(SystemExit, match="2"):
            main(call)
