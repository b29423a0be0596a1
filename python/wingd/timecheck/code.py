"""QR codes of a clock: version 1, error correction H, fourteen digits (ISO/IEC 18004).

The code is linear over GF(2): a bit of the digits inverts always the same modules. The page needs no more than these
modules (:func:`page_tables`), and no encoder of its own.
"""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np

Modules = np.ndarray[Any, np.dtype[np.bool_]]

#: Side of the code, modules; white margin around it, modules.
SIDE, MARGIN = 21, 4
#: Digits: milliseconds since 1970, and the number of the code on the screen.
DIGITS = 14
_DATA_BYTES, _CHECK_BYTES = 9, 17
#: Error correction H with mask 3, and the constants of the format's own code.
_FORMAT = 0b10 << 3 | 3
_BITS = 10 * (DIGITS // 3) + (0, 4, 7)[DIGITS % 3]


def digit_bits(text: str) -> list[int]:
    """Return the bits of digits: ten for three, seven for two, four for one; the most significant first."""
    groups = [text[k : k + 3] for k in range(0, len(text), 3)]
    return [int(group) >> bit & 1 for group in groups for bit in range((0, 4, 7, 10)[len(group)] - 1, -1, -1)]


def _check_bytes(data: list[int]) -> list[int]:
    """Return the bytes of Reed and Solomon's code, over GF(256) by 0x11d."""
    powers, value = [], 1
    for _ in range(255):
        powers.append(value)
        value = value << 1 ^ (0x11D if value & 0x80 else 0)
    logs = {v: k for k, v in enumerate(powers)}

    def product(a: int, b: int) -> int:
        return powers[(logs[a] + logs[b]) % 255] if a and b else 0

    generator = [1]
    for k in range(_CHECK_BYTES):
        longer = [*generator, 0]
        for n, term in enumerate(generator):
            longer[n + 1] ^= product(term, powers[k])
        generator = longer
    rest = [*data, *[0] * _CHECK_BYTES]
    for k in range(len(data)):
        for n, term in enumerate(generator[1:], 1):
            rest[k + n] ^= product(term, rest[k])
        rest[k] = 0
    return rest[len(data) :]


def _places() -> list[tuple[int, int]]:
    """Return the modules of the bits in their order: upwards and downwards in pairs of columns, from the right."""
    places, upwards = [], True
    for right in (20, 18, 16, 14, 12, 10, 8, 5, 3, 1):
        rows = range(SIDE - 1, -1, -1) if upwards else range(SIDE)
        for row in rows:
            for column in (right, right - 1):
                of_corner = (row < 9 and (column < 9 or column > 12)) or (row > 12 and column < 9)
                if not of_corner and row != 6:
                    places.append((row, column))
        upwards = not upwards
    return places


def _functions() -> Modules:
    """Return finders, timing, format and mask of an empty code; True is black."""
    modules = np.zeros((SIDE, SIDE), bool)
    for top, left in ((0, 0), (0, 14), (14, 0)):
        ring = np.maximum(*np.abs(np.mgrid[-3:4, -3:4]))
        modules[top : top + 7, left : left + 7] = ring != 2
    for k in range(8, 13):
        modules[6, k] = modules[k, 6] = k % 2 == 0
    modules[13, 8] = True
    rest = _FORMAT << 10
    for bit in range(14, 9, -1):
        rest ^= 0x537 << (bit - 10) if rest >> bit & 1 else 0
    word = (_FORMAT << 10 | rest) ^ 0x5412
    around = [(8, c) for c in (0, 1, 2, 3, 4, 5, 7, 8)] + [(r, 8) for r in (7, 5, 4, 3, 2, 1, 0)]
    apart = [(r, 8) for r in range(20, 13, -1)] + [(8, c) for c in range(13, 21)]
    for bit, (one, other) in enumerate(zip(around, apart, strict=True)):
        modules[one] = modules[other] = bool(word >> (14 - bit) & 1)
    for row, column in _places():
        modules[row, column] = (row + column) % 3 == 0
    return modules


def _bit_modules(digits: list[int], with_frame: bool) -> Modules:
    """Return the modules that bits of the digits invert; with the constant bits around them."""
    # Numeric mode and the number of digits; zeros end the message and fill the last byte.
    head = [0, 0, 0, 1, *(DIGITS >> k & 1 for k in range(9, -1, -1))]
    bits = (head if with_frame else [0] * len(head)) + digits
    bits += [0] * (8 * _DATA_BYTES - len(bits))
    data = [int("".join(map(str, bits[k : k + 8])), 2) for k in range(0, len(bits), 8)]
    content = [*data, *_check_bytes(data)]
    modules = np.zeros((SIDE, SIDE), bool)
    for k, place in enumerate(_places()):
        modules[place] = bool(content[k // 8] >> (7 - k % 8) & 1)
    return modules


@cache
def _tables() -> tuple[Modules, Modules]:
    base = _functions() ^ _bit_modules([0] * _BITS, True)
    unit = np.eye(_BITS, dtype=int).tolist()
    return base, np.array([_bit_modules(bits, False) for bits in unit])


def encode(time_ms: int, code: int) -> Modules:
    """Return the modules of a time, shape (21, 21); True is black.

    Parameters
    ----------
    time_ms
        Milliseconds since 1970.
    code
        Number of the code on the screen, one digit.
    """
    base, inverted = _tables()
    bits = np.array(digit_bits(f"{time_ms:0{DIGITS - 1}d}{code}"), bool)
    return base ^ np.logical_xor.reduce(inverted[bits], axis=0)


def page_tables() -> tuple[list[int], list[list[int]]]:
    """Return the rows of the empty code, and those that each bit of the digits inverts; the left module is the highest bit."""
    base, inverted = _tables()

    def rows(modules: Modules) -> list[int]:
        return [int("".join("1" if m else "0" for m in row), 2) for row in modules]

    return rows(base), [rows(one) for one in inverted]
