"""Shape that a surface is moved by: an exported file, or the export of a store."""

from __future__ import annotations

import os
import shutil
import subprocess
import tempfile
from pathlib import Path

import xarray as xr

from wingd import WingdError


def open_shape(source: Path | str, flight: str | None = None) -> xr.Dataset:
    """Open the joint shape of a flight, of a store or of a file of ``wingd export --table shape``.

    Raises
    ------
    WingdError
        The source does not exist or is no shape; the program's message, if it cannot export.
    """
    path = Path(source)
    if path.is_dir():
        with tempfile.TemporaryDirectory() as folder:
            file = Path(folder) / "shape.nc"
            program = os.environ.get("WINGD") or shutil.which("wingd")
            if program is None:
                raise WingdError("the program wingd is not on the PATH; install it, or name it with WINGD=")
            chosen = ["--flight", flight] if flight else []
            call = [
                program,
                "export",
                str(path),
                "--format",
                "netcdf",
                "--table",
                "shape",
                "--output",
                str(file),
                *chosen,
            ]
            done = subprocess.run(call, capture_output=True, text=True, check=False)
            if done.returncode or not file.exists():
                raise WingdError((done.stderr.strip().splitlines() or ["wingd export failed"])[-1])
            return _load(file)
    if flight is not None:
        raise WingdError(f"--flight {flight}: {path} is a file of one export; omit --flight, or name the store")
    return _load(path)


def _load(file: Path) -> xr.Dataset:
    try:
        with xr.open_dataset(file, decode_times=False) as shape:
            return shape.load()
    except (OSError, ValueError) as error:
        cause = " ".join(str(error).split())[:120]
        raise WingdError(f"{file}: is not a shape ({cause}); write it with `wingd export --table shape`") from None
