"""Faults on purpose: a lake that dies at its n-th operation, bits that flip; and answers as a thing to compare."""

from __future__ import annotations

import random
import threading
from pathlib import Path
from typing import Callable, Iterator

from wingd_fleet.desk import Desk
from wingd_fleet.lake import Lake

# Columns that tell a row, and that must not be wrong.
KEYS = {
    "shots": "series, shot",
    "markers": "series, shot, marker",
    "parameters": "series, shot, parameter, index",
    "span": "series, shot, arc_length_m",
}
VALUES = {"shots": "tip_deflection_m", "markers": "deflection_m", "parameters": "value", "span": "deflection_m"}


class Died(BaseException):
    """As when the power goes: no handler of ours sees it."""


class Dying(Lake):
    """A lake whose process dies at its n-th change, before it is done or after. A death while it reads is as one before the
    next change."""

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
    """Lakes on which a work died, at each of its changes in turn, before and after; until it does not die any more."""
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
    """What is answered of every table: rows and sum of values by solve, flight and whose it is. No row stands there twice."""
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
