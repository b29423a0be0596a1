"""Concurrency and rate limit of an upload."""

from __future__ import annotations

import threading
import time
from collections import deque

# Time bound for an object: an interruption should not cost more than this much sending, s. More objects are sent concurrently
# only if each is finished sooner.
MAX_OBJECT_S = 2.0
# Number of recent objects from which the rate is measured.
RATE_WINDOW = 8


class Pace:
    """Measured rate, which determines the number of concurrent objects: one at first, never more than `most`."""

    def __init__(self, most: int, now: float):
        self.most = max(most, 1)
        self.arrived: deque[tuple[float, int]] = deque([(now, 0)], RATE_WINDOW)

    def record(self, length: int, now: float) -> None:
        """Record an object of `length` bytes that arrived at `now`, s."""
        self.arrived.append((now, length))

    def concurrent(self, length: int) -> int:
        """Return the number of objects of this length, bytes, to send at the same time."""
        sent = sum(length for _, length in list(self.arrived)[1:])
        seconds = self.arrived[-1][0] - self.arrived[0][0]
        if seconds <= 0 or length == 0:
            return 1
        return min(max(int(sent / seconds * MAX_OBJECT_S / length), 1), self.most)


class RateLimit:
    """Maximum mean rate of sending over all objects, bytes per second."""

    def __init__(self, rate: int):
        self.rate = max(rate, 1)
        self.free = time.monotonic()
        self.lock = threading.Lock()

    def reserve(self, length: int, now: float) -> float:
        """Reserve the time that sending `length` bytes may take; return its end, s."""
        with self.lock:
            self.free = max(self.free, now) + length / self.rate
            return self.free

    def wait(self, end: float) -> None:
        """Wait until the reserved time is over: an object goes out as fast as the network is, the next one after a pause."""
        time.sleep(max(0.0, end - time.monotonic()))
