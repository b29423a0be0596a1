"""QR codes of a clock: version 1, error correction H, fourteen digits (ISO/IEC 18004).

The code is linear over GF(2): a bit of the digits inverts always the same modules. The page needs no more than these
modules (:func:`page_tables`), and no encoder of its own.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from wingd import WingdError

Modules = np.ndarray[Any, np.dtype[np.bool_]]

#: Side of the code, modules; white margin around it, modules.
SIDE, MARGIN = 21, 4
#: Digits: milliseconds since 1970, and the number of the code on the screen.
DIGITS = 14


def encode(time_ms: int, code: int) -> Modules:
    """Return the modules of a time, shape (21, 21); True is black.

    Parameters
    ----------
    time_ms
        Milliseconds since 1970.
    code
        Number of the code on the screen, one digit.
    """
    return _encode(f"{time_ms:0{DIGITS - 1}d}{code}")


def _encode(digits: str) -> Modules:
    try:
        import segno
    except ImportError:
        raise WingdError("the page needs segno; install it: pip install 'wingd[vision]'") from None
    code = segno.make_qr(digits, version=1, error="h", mode="numeric", mask=3, boost_error=False)
    return np.array(code.matrix, dtype=bool)


def page_tables() -> tuple[list[int], list[list[int]]]:
    """Return the rows of the empty code, and those that each bit of the digits inverts; the left module is the highest bit."""
    base = _encode("0" * DIGITS)
    places = range(0, DIGITS, 3)
    # Three digits have ten bits, two have seven; the most significant first.
    words = [(at, 1 << bit) for at in places for bit in range(9 if DIGITS - at >= 3 else 6, -1, -1)]
    texts = ["0" * at + f"{word:0{min(3, DIGITS - at)}d}" + "0" * max(DIGITS - at - 3, 0) for at, word in words]

    def rows(modules: Modules) -> list[int]:
        return [int("".join("1" if m else "0" for m in row), 2) for row in modules]

    return rows(base), [rows(_encode(text) ^ base) for text in texts]
