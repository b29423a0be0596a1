"""Text files and tables of other programs: bounded reading, rows, numbers, and errors that name file, line and remedy."""

from __future__ import annotations

import csv
import math
import re
from dataclasses import dataclass
from pathlib import Path

from wingd import WingdError

#: Largest text file, bytes: a table of a long flight has 50 MB, a surface of 10 million nodes 800 MB.
MAX_TEXT_BYTES = 1 << 30
#: First bytes of files that are not text in UTF-8, with problem and remedy.
_NOT_TEXT = (
    (b"PK\x03\x04", "is a spreadsheet file or an archive", "save the table as CSV, UTF-8"),
    (b"\xd0\xcf\x11\xe0", "is a spreadsheet file", "save the table as CSV, UTF-8"),
    (b"\xff\xfe", "is UTF-16 text", "save it as UTF-8"),
    (b"\xfe\xff", "is UTF-16 text", "save it as UTF-8"),
)
_NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?", re.ASCII)


def fault(file: Path | str, problem: str, remedy: str, *, line: int = 0, key: str = "") -> WingdError:
    """Create the error of a file: ``file: line 3, key: problem; remedy``, in one line."""
    place = ", ".join(part for part in (f"line {line}" if line else "", key) if part)
    text = f"{file}: {place}: {problem}; {remedy}" if place else f"{file}: {problem}; {remedy}"
    return WingdError("".join(c if c.isprintable() else "\N{REPLACEMENT CHARACTER}" for c in text))


def excerpt(text: str, length: int = 60) -> str:
    """Return the beginning of a text in quotes, for messages."""
    return f'"{text[:length]}..."' if len(text) > length else f'"{text}"'


def read_bytes(file: Path | str, largest: int = MAX_TEXT_BYTES, is_text: bool = False) -> bytes:
    """Read a regular file of bounded size.

    Parameters
    ----------
    file
        Path of the file.
    largest
        Largest size, bytes.
    is_text
        Stop after the first zero, which no text has.

    Raises
    ------
    WingdError
        The file is missing, is no file, cannot be read, is larger than `largest`, or has holes instead of its content.
    """
    path = Path(file)
    try:
        facts = path.stat()
        if not path.is_file():
            raise fault(file, "is not a file", "name a file")
        if facts.st_size > largest:
            raise fault(file, f"has {facts.st_size} bytes, more than {largest}", "name a smaller file")
        stored = getattr(facts, "st_blocks", facts.st_size) * 512
        # A copy that was cut has its size, but not its content; a compressing file system saves less.
        if facts.st_size > 1 << 20 and stored < facts.st_size / 50:
            problem = f"has {facts.st_size} bytes, of which {stored} are on the disk: the others are holes"
            raise fault(file, problem, "export or copy the file again")
        parts = []
        with path.open("rb") as opened:
            while part := opened.read(1 << 22):
                parts.append(part)
                if is_text and b"\0" in part:
                    break
        content = b"".join(parts)
    except (OSError, ValueError) as error:
        raise fault(file, f"cannot be read ({error})", "name a file that exists and can be read") from None
    if content and not content[: 1 << 16].strip(b"\0"):
        raise fault(file, "has no content but zeros", "export or copy the file again")
    return content


def read_text(file: Path | str, largest: int = MAX_TEXT_BYTES) -> str:
    r"""Read a text in UTF-8, with line ends as ``\n`` and without a byte order mark.

    Raises
    ------
    WingdError
        The file cannot be read or is not text in UTF-8.
    """
    content = read_bytes(file, largest, is_text=True)
    for start, problem, remedy in _NOT_TEXT:
        if content.startswith(start):
            raise fault(file, problem, remedy)
    if not content.strip():
        raise fault(file, "is empty", "export it again")
    at = content.find(b"\0")
    try:
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        at = error.start if at < 0 else min(at, error.start)
        text = ""
    if at >= 0:
        raise fault(file, "is not text in UTF-8", "save it as UTF-8", line=content[:at].count(b"\n") + 1)
    return text.replace("\r\n", "\n").replace("\r", "\n")


def parse_number(text: str) -> float | None:
    """Return a finite decimal number with a point; None for any other text."""
    if not _NUMBER.fullmatch(text):
        return None
    value = float(text)
    return value if math.isfinite(value) else None


@dataclass(frozen=True)
class Row:
    """Row of a table."""

    #: Line on which it begins, from 1.
    line: int
    #: Cells without surrounding blanks and quotes.
    cells: list[str]


def split_rows(file: Path | str, text: str, separator: str = ",") -> list[Row]:
    """Split a table into rows by RFC 4180, without blank rows.

    Raises
    ------
    WingdError
        A quote is not closed, or text follows a closing quote.
    """
    rows: list[Row] = []
    reader = csv.reader(text.split("\n"), delimiter=separator, skipinitialspace=True, strict=True)
    begin = 1
    try:
        for cells in reader:
            stripped = [cell.strip() for cell in cells]
            if any(stripped):
                rows.append(Row(begin, stripped))
            begin = reader.line_num + 1
    except csv.Error as error:
        cause = "a quote is not closed, or text follows a closing quote" if "field" not in str(error) else str(error)
        raise fault(file, f"{cause} ({error})", "put quotes around whole cells", line=begin) from None
    return rows


def read_table(file: Path | str, columns: str) -> tuple[Row, list[Row]]:
    """Read a CSV with a header; lines that begin with ``# `` are comments.

    Parameters
    ----------
    file
        Path of the table.
    columns
        Header of a right table, for messages.

    Returns
    -------
    tuple
        Header, and rows with as many cells as it has.
    """
    rows = [row for row in split_rows(file, read_text(file)) if not row.cells[0].startswith("# ")]
    if not rows:
        raise fault(file, "is empty", f"write the header {columns}")
    header, *data = rows
    for sign, name in ((";", "semicolons"), ("\t", "tabs")):
        if len(header.cells) == 1 and sign in header.cells[0]:
            raise fault(file, f"is separated by {name}", f"separate by commas: {columns}", line=header.line)
    for name in header.cells:
        if name and header.cells.count(name) > 1:
            raise fault(file, "occurs twice in the header", "keep the valid column", line=header.line, key=name)
    width = len(header.cells)
    for row in data:
        if len(row.cells) != width:
            problem = f"has {len(row.cells)} cells under a header of {width}"
            raise fault(file, problem, "put quotes around a cell with a comma", line=row.line)
    return header, data
