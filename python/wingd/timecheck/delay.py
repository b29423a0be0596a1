"""Delay of a camera from the time differences of many images, and test of recorded times."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from scipy.stats import chi2

#: Largest mean difference of recorded and shown times, in standard deviations, for them to agree.
MAX_NORMALISED = 3.0
#: Significance level of the test of the scatter.
SIGNIFICANCE = 0.001


@dataclass(frozen=True)
class Screen:
    """Delay of a screen between reading the clock and its light.

    Attributes
    ----------
    refresh_s
        Refresh interval, s.
    latency_s, latency_sigma_s
        Delay from drawing to light in the middle of the screen and its standard deviation, s: the same error in every image.
    """

    refresh_s: float = 1 / 60
    latency_s: float = 0.030
    latency_sigma_s: float = 0.040 / math.sqrt(12)

    @property
    def display_delay_s(self) -> float:
        """Mean delay from the time of a code to its light, s: a code waits half a refresh to be drawn."""
        return self.latency_s + 0.5 * self.refresh_s

    @property
    def phase_s(self) -> float:
        """Standard deviation of the phase of an image in the refresh, s."""
        return self.refresh_s / math.sqrt(12)

    def read_sigma_s(self, width_s: float) -> float:
        """Return the standard deviation of the time of one image without the latency, s: uniform in a width and in the refresh."""
        return math.hypot(width_s / math.sqrt(12), self.phase_s)

    @property
    def systematic_s(self) -> float:
        """Standard deviation of errors common to all images, s: the latency, and the phase for images at a fixed rate."""
        return math.hypot(self.latency_sigma_s, self.phase_s)


@dataclass(frozen=True)
class DelayEstimate:
    """Delay from several images, s.

    Attributes
    ----------
    mean_s, mean_sigma_s
        Mean, and its standard deviation with errors common to all images.
    scatter_s
        Standard deviation of one image about the mean; None for one image.
    read_sigma_s
        Scatter expected from reading the images alone.
    sigma_s
        Standard deviation of the delay of a future image: that of the mean, and an upper limit of the scatter beyond the
        reading errors; None for one image.
    """

    images: int
    mean_s: float
    mean_sigma_s: float
    scatter_s: float | None
    read_sigma_s: float
    sigma_s: float | None


def estimate_delay(delays: Sequence[tuple[float, float]], systematic_s: float) -> DelayEstimate | None:
    """Estimate a delay from that of each image and the standard deviation of its reading, s; None without images."""
    n = len(delays)
    if not n:
        return None
    mean = sum(d for d, _ in delays) / n
    read2 = sum(s * s for _, s in delays) / n
    scatter2 = sum((d - mean) ** 2 for d, _ in delays) / (n - 1) if n > 1 else None
    mean_sigma = math.hypot(math.sqrt(max(scatter2 if scatter2 is not None else read2, read2) / n), systematic_s)
    if scatter2 is None:
        return DelayEstimate(n, mean, mean_sigma, None, math.sqrt(read2), None)
    # A variance from n images has the relative standard deviation sqrt(2 / (n - 1)).
    excess2 = max(scatter2 - read2 + math.sqrt(2 / (n - 1)) * read2, 0.0)
    sigma = math.hypot(math.sqrt(excess2), mean_sigma)
    return DelayEstimate(n, mean, mean_sigma, math.sqrt(scatter2), math.sqrt(read2), sigma)


@dataclass(frozen=True)
class ExposureTest:
    """Test of recorded times of exposure: their difference from the screen, their standard deviation, and the verdict."""

    difference: DelayEstimate
    recorded_s: float
    normalised: float
    agrees: bool


def check_exposures(difference: DelayEstimate, recorded_sigmas_s: Sequence[float]) -> ExposureTest:
    """Test the mean, assuming that the recorded standard deviations are one error common to all images, and the scatter."""
    recorded2 = sum(s * s for s in recorded_sigmas_s) / max(len(recorded_sigmas_s), 1)
    normalised = abs(difference.mean_s) / math.sqrt(difference.mean_sigma_s**2 + recorded2)
    freedom = difference.images - 1
    scattered = False
    if difference.scatter_s is not None:
        omega = freedom * difference.scatter_s**2 / (difference.read_sigma_s**2 + recorded2)
        scattered = float(chi2.sf(omega, freedom)) < SIGNIFICANCE
    return ExposureTest(difference, math.sqrt(recorded2), normalised, normalised <= MAX_NORMALISED and not scattered)
