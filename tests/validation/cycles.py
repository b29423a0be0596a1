"""Rainflow cycles of 1,000 random histories by two public packages, for tests/adjust/stress.rs.

    python3 -m venv venv && venv/bin/pip install rainflow==3.2.0 pylife==2.3.1
    venv/bin/python tests/validation/cycles.py > tests/rainflow/cycles.csv

The histories are of whole numbers and follow from their number alone (SplitMix64), so that the test draws the same ones.
A line per history: its number, its length, cycles counted (halves as 0.5) and the first 16 digits of the SHA-256 of the
lines "range 2*mean 2*count", sorted. pylife counts closed loops and leaves a residue, whose ranges count as halves by
ASTM E1049-85, 5.4.4; the script ends with an error where the packages differ.
"""

import hashlib
from importlib.metadata import version

import numpy as np
import pylife.stress.rainflow as pylife_rainflow
import rainflow

MASK = (1 << 64) - 1


class SplitMix64:
    def __init__(self, seed):
        self.state = seed

    def next(self):
        self.state = (self.state + 0x9E3779B97F4A7C15) & MASK
        z = self.state
        z = ((z ^ (z >> 30)) * 0xBF58476D1CE4E5B9) & MASK
        z = ((z ^ (z >> 27)) * 0x94D049BB133111EB) & MASK
        return z ^ (z >> 31)


def history(number):
    """White noise, a random walk or either with plateaus; 2 to 400 points."""
    draw = SplitMix64(number)
    length = 2 + draw.next() % 399
    walks, plateaus = number % 2 == 1, number % 4 >= 2
    values = []
    for _ in range(length):
        step = draw.next() % 2_000_001 - 1_000_000
        stays = draw.next() % 10 < 3
        if plateaus and stays and values:
            values.append(values[-1])
        elif walks and values:
            values.append(values[-1] + step)
        else:
            values.append(step)
    return values


def by_rainflow(values):
    cycles = rainflow.extract_cycles(values)
    return sorted(f"{r:.0f} {2 * m:.0f} {2 * c:.0f}" for r, m, c, _, _ in cycles if r > 0)


def by_pylife(values, detector):
    recorder = pylife_rainflow.LoopValueRecorder()
    detector = detector(recorder=recorder)
    detector.process(np.array(values, dtype=float), flush=True)
    # A plateau at the end may close a loop without a range, which is none.
    loops = [(a, b) for a, b in zip(recorder.values_from, recorder.values_to) if a != b]
    lines = [f"{abs(a - b):.0f} {a + b:.0f} 2" for a, b in loops]
    rest = list(detector.residuals)
    lines += [f"{abs(a - b):.0f} {a + b:.0f} 1" for a, b in zip(rest, rest[1:]) if a != b]
    return sorted(lines)


def main():
    print(f"# rainflow {version('rainflow')}, pylife {version('pylife')}")
    print("number,length,cycles,sha256")
    for number in range(1, 1001):
        values = history(number)
        lines = by_rainflow(values)
        for detector in (pylife_rainflow.FourPointDetector, pylife_rainflow.ThreePointDetector):
            other = by_pylife(values, detector)
            if other != lines:
                raise SystemExit(f"history {number}: {detector.__name__} differs: {set(lines) ^ set(other)}")
        count = sum(int(line.split()[2]) for line in lines) / 2
        digest = hashlib.sha256("\n".join(lines).encode()).hexdigest()[:16]
        print(f"{number},{len(values)},{count},{digest}")


main()
