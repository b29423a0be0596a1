"""Reading of the clock in images."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from wingd import WingdError
from wingd.textfiles import fault, read_bytes
from wingd.timecheck.code import DIGITS

#: Tick of the clock, ms: each of two codes changes every two ticks, one tick after the other. Longer than two frames of a
#: screen at 60 Hz, so that one of them is at rest during an exposure of up to a tick.
TICK_MS = 40
#: Largest image file, bytes.
MAX_IMAGE_BYTES = 1 << 28

Image = np.ndarray[Any, np.dtype[np.uint8]]


class ShownTime(NamedTuple):
    """Middle of an exposure by the clock, without the delay of the screen: ms since 1970, and the width of its uniform error, ms."""

    middle_ms: float
    width_ms: float
    codes: int


def _cv2() -> Any:
    try:
        import cv2
    except ImportError:
        raise WingdError("images need opencv-python-headless; install it: pip install 'wingd[vision]'") from None
    return cv2


def read_image(file: Path | str) -> Image:
    """Read an image as grey values, shape (height, width).

    Raises
    ------
    WingdError
        The file is not an image.
    """
    cv2 = _cv2()
    content = read_bytes(file, MAX_IMAGE_BYTES)
    try:
        image = cv2.imdecode(np.frombuffer(content, np.uint8), cv2.IMREAD_GRAYSCALE)
    except cv2.error:
        image = None
    if image is None:
        raise fault(file, "is not an image that can be decoded", "give JPEG, PNG or TIFF")
    return image


def _decode(image: Image) -> set[str]:
    """Return the texts of the codes in an image: of reduced images first, which suffice for most; full size only if no code is found."""
    cv2 = _cv2()
    found: set[str] = set()
    for longest in (800, 1600, max(image.shape)):
        scale = longest / max(image.shape)
        if scale > 1 or (found and longest > 1600):
            continue
        one = image if scale == 1 else cv2.resize(image, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
        half, overlap = one.shape[1] // 2, one.shape[1] // 10
        for part in (one, one[:, : half + overlap], one[:, half - overlap :]):
            # Each of OpenCV's detectors finds codes that the other does not.
            for detector in (cv2.QRCodeDetectorAruco(), cv2.QRCodeDetector()):
                try:
                    texts = detector.detectAndDecodeMulti(part)[1]
                except cv2.error:
                    continue
                found |= {t for t in texts if re.fullmatch(rf"\d{{{DIGITS}}}", t, re.ASCII)}
                if {t[-1] for t in found} >= {"0", "1"}:
                    return found
    return found


def read_time(image: Image) -> ShownTime:
    """Read the clock in an image; see :func:`time_of_codes`."""
    return time_of_codes(_decode(image))


def time_of_codes(texts: set[str]) -> ShownTime:
    """Return the time of an exposure that shows these codes.

    With both codes the exposure lies between the change to the later one and the next change, a tick later. If one cannot
    be read, it changed during the exposure or is hidden: the exposure lies in the two ticks of the other.

    Raises
    ------
    WingdError
        No code, or codes that no moment shows together.
    """
    times: list[set[int]] = [set(), set()]
    for text in texts:
        if text[-1] in "01":
            times[int(text[-1])].add(int(text[:-1]))
    if not any(times):
        raise WingdError("no code of the clock can be read; show both codes sharply, without glare, in full screen")
    for code, of_code in enumerate(times):
        if len(of_code) > 1 or any(t % (2 * TICK_MS) != code * TICK_MS for t in of_code):
            raise WingdError(
                "a code is not one of this clock; open a page of `wingd time-check --page` of this version"
            )
    if not all(times):
        return ShownTime(next(iter(times[0] or times[1])) + TICK_MS, 2 * TICK_MS, 1)
    first, second = next(iter(times[0])), next(iter(times[1]))
    if abs(first - second) != TICK_MS:
        apart = abs(first - second)
        raise WingdError(f"the codes are {apart} ms apart, not {TICK_MS}; shorten the exposure, or use a faster screen")
    return ShownTime(max(first, second) + 0.5 * TICK_MS, TICK_MS, 2)
