"""``python -m wingd COMMAND``: the same as ``wingd-COMMAND``."""

from __future__ import annotations

import importlib
import sys

from wingd import __version__
from wingd.commands import COMMANDS


def main(arguments: list[str] | None = None) -> int:
    """Run a command of the package; returns its exit status."""
    arguments = sys.argv[1:] if arguments is None else arguments
    if arguments[:1] in (["-V"], ["--version"]):
        print(f"wingd for Python {__version__}")
        return 0
    if arguments and arguments[0] in COMMANDS:
        return importlib.import_module(COMMANDS[arguments[0]]).main(arguments[1:])
    asked = arguments[:1] in ([], ["-h"], ["--help"])
    if not asked:
        print(f"error: no command {arguments[0]!r}", file=sys.stderr)
    print(
        "Usage: python -m wingd COMMAND\n\nCommands: " + ", ".join(COMMANDS), file=sys.stdout if asked else sys.stderr
    )
    return 0 if asked else 2


if __name__ == "__main__":
    sys.exit(main())
