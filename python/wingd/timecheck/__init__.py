"""Time of exposure checked with images of a screen that shows the clock as QR codes.

>>> Path("clock.html").write_text(clock_page())         # open it on the recorder's computer, and photograph it
>>> readings = [read_frame(frame, Screen()) for frame in stored_frames("store")]
>>> summarise(readings, len(readings), Screen()).lines
"""

from wingd.timecheck.check import (
    Frame,
    Reading,
    Summary,
    clock_page,
    listed_frames,
    read_frame,
    reading_record,
    stored_frames,
    summarise,
)
from wingd.timecheck.delay import DelayEstimate, ExposureTest, Screen, check_exposures, estimate_delay
from wingd.timecheck.images import TICK_MS, ShownTime, read_image, read_time

__all__ = ["TICK_MS", "DelayEstimate", "ExposureTest", "Frame", "Reading", "Screen", "ShownTime", "Summary", "check_exposures",
           "clock_page", "estimate_delay", "listed_frames", "read_frame", "read_image", "read_time", "reading_record",
           "stored_frames", "summarise"]  # fmt: skip
