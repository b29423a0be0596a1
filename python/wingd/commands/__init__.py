"""Commands ``wingd-X``; ``wingd X`` finds them on the PATH.

Each module has ``main(arguments: list[str] | None = None) -> int``. Wrap its body with :func:`run_command`, so that
every command reports errors in the same way.
"""

from __future__ import annotations

import sys
from collections.abc import Callable

from wingd import WingdError

#: Name of a command -> its module in this package.
COMMANDS = {
    name: f"wingd.commands.{name.replace('-', '_')}"
    for name in ("mean", "difference", "deform", "loads", "upload", "convert", "table", "time-check", "fleet")
}


def run_command(body: Callable[[], int | None]) -> int:
    """Run `body`; an expected error is one line on standard error and exit status 1.

    Parameters
    ----------
    body
        Returns the exit status, None for 0.

    Returns
    -------
    int
        Exit status.
    """
    try:
        return body() or 0
    except BrokenPipeError:
        return 1
    except (WingdError, OSError) as error:
        # One line, also if a library's message in it has several.
        print("error: " + " ".join(str(error).split()), file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        return 130
