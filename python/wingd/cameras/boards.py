"""Calibration targets of Kalibr as ``board.toml``."""

from __future__ import annotations

import re
from pathlib import Path

from wingd.keyed import Node, parse_keyed
from wingd.textfiles import read_text


def read_kalibr_board(file: Path | str) -> dict[str, str | int | float]:
    """Read a calibration target of Kalibr as the keys of ``board.toml``; checkerboards count inner corners in both.

    Raises
    ------
    WingdError
        The target is not supported, or a key is missing, unknown or impossible.
    """
    path = Path(file)
    tree = parse_keyed(path, "yaml")

    def need(key: str) -> Node:
        return tree.require(key, "add it as described in Kalibr's wiki")

    def count(key: str, least: int) -> int:
        number = need(key).number(key)
        if number != int(number) or not least <= number <= 100:
            raise need(key).fault(key, f"is {number:g}", f"give a whole number from {least} to 100")
        return int(number)

    def length(key: str, of: int) -> float:
        number = need(key).number(key)
        if not 1e-4 <= number <= 100:
            raise need(key).fault(key, f"is {number:g}", "give a number from 0.0001 to 100")
        if key != "tagSpacing" and number * of > 10:
            problem = f"is {number:g}: {of} of {number:g} m, a board of {number * of:.0f} m"
            raise need(key).fault(key, problem, f"give metres: {number / 1000:g} for {number:g} mm")
        return number

    kind = need("target_type")
    if kind.text == "aprilgrid":
        columns, rows = count("tagCols", 1), count("tagRows", 1)
        board = {"pattern": "aprilgrid", "columns": columns, "rows": rows, "tag_m": length("tagSize", max(columns, rows)),
                 "spacing": length("tagSpacing", 1)}  # fmt: skip
        used = {"tagCols", "tagRows", "tagSize", "tagSpacing"}
    elif kind.text == "checkerboard":
        columns, rows = count("targetCols", 3), count("targetRows", 3)
        along, across = (length(f"{side}SpacingMeters", max(columns, rows)) for side in ("col", "row"))
        if along != across:
            problem = f"is {across:g} m, colSpacingMeters {along:g} m"
            remedy = "only squares are supported: measure both spacings, and describe other boards by scale_sigma"
            raise need("rowSpacingMeters").fault("rowSpacingMeters", problem, remedy)
        board = {"pattern": "checkerboard", "columns": columns, "rows": rows, "square_m": along}
        used = {"targetCols", "targetRows", "rowSpacingMeters", "colSpacingMeters"}
    else:
        problem = f'"{kind.text or "a list"}" is not a supported target'
        raise kind.fault("target_type", problem, "use an aprilgrid or a checkerboard")
    for key, node in tree.entries:
        if key == "codeOffset" and node.number(key) != 0:
            raise node.fault(key, "is not 0", "print the grid with tags numbered from 0")
        if key not in used | {"target_type", "codeOffset"}:
            raise node.fault(
                key, "is not a known key of a target", "delete it if it does not affect the board's geometry"
            )
    return board


def write_board(file: Path | str, board: dict[str, str | int | float]) -> None:
    """Write the keys of a board as ``board.toml``."""
    Path(file).write_text(
        "".join(f'{k} = "{v}"\n' if isinstance(v, str) else f"{k} = {v!r}\n" for k, v in board.items())
    )


def is_kalibr_board(file: Path | str) -> bool:
    """Return whether a file describes a target of Kalibr."""
    path = Path(file)
    if path.suffix.lower() not in (".yaml", ".yml"):
        return False
    return re.search(r"^\s*['\"]?target_type['\"]?\s*:", read_text(path, 1 << 24), re.M) is not None
