"""Every export of a store is read back by the readers of the field, with equal numbers."""

import subprocess
import sys
from pathlib import Path

SCRIPT = Path(__file__).parents[3] / "tests/validation/exports.py"


def test_exports_are_read_by_other_programs(wingd, tmp_path):
    subprocess.run([wingd, "demo", "--output", str(tmp_path / "demo")], check=True, capture_output=True)
    store = str(tmp_path / "demo/store")
    for jointly in (False, True):
        if jointly:
            subprocess.run([wingd, "solve", store], check=True, capture_output=True)
        read = subprocess.run([sys.executable, str(SCRIPT), wingd, store], capture_output=True, text=True)
        assert read.returncode == 0, read.stderr
