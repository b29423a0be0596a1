"""Fault injection: a lake that dies at its n-th change, flipped bits; and query results in a form to compare."""

# ruff: noqa: B023 - functions are called within the loop
from __future__ import annotations

import random
import threading
from collections.abc import Callable, Iterator
from pathlib import Path

from wingd.fleet.desk import Desk
from wingd.fleet.lake import Lake

# Columns that identify a row, and columns with values that must be right.
KEYS = {
    "shots": "series, shot",
    "markers": "series, shot, marker",
    "parameters": "series, shot, parameter, index",
    "span": "series, shot, arc_length_m",
}
VALUES = {"shots": "tip_deflection_m", "markers": "deflection_m", "parameters": "value", "span": "deflection_m"}


class Died(BaseException):
    """Simulated power failure: no exception handler of ours catches it."""


class Dying(Lake):
    """A lake whose process dies at its n-th change, before or after it is done. A death during a read equals one before the next
    change."""

    def __init__(self, url: str, at: int, after: bool):
        super().__init__(url)
        self.left, self.after, self.died, self.guard = at, after, False, threading.Lock()

    def _changes(self, change: Callable):
        with self.guard:
            if self.died:
                raise Died
            self.left -= 1
            self.died = self.left == 0
            if self.died and not self.after:
                raise Died
        done = change()
        if self.died:
            raise Died
        return done

    def _again(self, place: str, work: Callable):
        if self.died and not self.after:
            raise Died
        return super()._again(place, work)

    def create(self, key: str, data: bytes) -> bool:
        return self._changes(lambda: super(Dying, self).create(key, data))

    def replace(self, key: str, data: bytes) -> None:
        self._changes(lambda: super(Dying, self).replace(key, data))

    def delete(self, keys: list[str]) -> None:
        for key in keys:
            self._changes(lambda: super(Dying, self).delete([key]))


def deaths(make: Callable[[], Lake], work: Callable[[Lake], object]) -> Iterator[Lake]:
    """Yields lakes on which `work` died, at each of its changes in turn, before and after, until it no longer dies."""
    at = 1
    while True:
        for after in (False, True):
            plain = make()
            dying = Dying(plain.url, at, after)
            try:
                work(dying)
            except Died:
                pass
            if not dying.died:
                return
            yield plain
        at += 1


def answers(lake: Lake, cache: Path | None = None) -> dict:
    """Returns row count and sum of values of every table by solve, flight and aircraft; asserts that no row is duplicated."""
    desk, found = Desk(lake, None, cache), {}
    for table, key in KEYS.items():
        whose = "solve, recorder_id, flight"
        twice = desk.rows(f"SELECT {whose}, {key} FROM {table} GROUP BY ALL HAVING count(*) > 1")
        assert not twice, f"{table} has rows twice: {twice[:3]}"
        sums = f"count(*) AS n, round(sum({VALUES[table]}), 9) AS total"
        rows = desk.rows(
            f"SELECT {whose}, aircraft, aircraft_type, wing, {sums} FROM {table} GROUP BY ALL ORDER BY ALL"
        )
        found[table] = [tuple(row.values()) for row in rows]
    return found


def flip(path: Path, chance: random.Random) -> None:
    data = bytearray(path.read_bytes())
    data[chance.randrange(len(data))] ^= 1 << chance.randrange(8)
    path.write_bytes(bytes(data))
