#!/usr/bin/env python3
"""What the usual OpenCV chain costs on the frame of benches/frame.rs, one thread: grey decode, adaptive
threshold, contours, ellipse fits, corner refinement. Prints the median of each stage, ms."""
import sys
import time

import cv2
import numpy as np

cv2.setNumThreads(1)
data = np.fromfile(sys.argv[1], np.uint8)
RUNS = 9
times = {}


def timed(name, work):
    start = time.perf_counter()
    result = work()
    times.setdefault(name, []).append(1e3 * (time.perf_counter() - start))
    return result


for _ in range(RUNS):
    grey = timed("decode", lambda: cv2.imdecode(data, cv2.IMREAD_GRAYSCALE))
    binary = timed(
        "threshold",
        lambda: cv2.adaptiveThreshold(grey, 255, cv2.ADAPTIVE_THRESH_MEAN_C, cv2.THRESH_BINARY_INV, 151, 20),
    )
    contours = timed("contours", lambda: cv2.findContours(binary, cv2.RETR_LIST, cv2.CHAIN_APPROX_NONE)[0])
    large = [c for c in contours if len(c) >= 40]
    ellipses = timed("ellipses", lambda: [cv2.fitEllipse(c) for c in large])
    # An ellipse through a part of an outline may have its centre beside the picture, which the refinement refuses.
    inside = [e[0] for e in ellipses if 0 <= e[0][0] < grey.shape[1] and 0 <= e[0][1] < grey.shape[0]]
    centres = np.array(inside, np.float32).reshape(-1, 1, 2)
    stop = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 40, 0.001)
    if len(centres):
        timed("corners", lambda: cv2.cornerSubPix(grey, centres, (5, 5), (-1, -1), stop))
total = 0.0
for name, values in times.items():
    median = sorted(values)[len(values) // 2]
    total += median
    print(f"opencv/{name:<12} {median:9.3f} ms")
print(f"opencv/{'chain':<12} {total:9.3f} ms")
