"""The demonstration's flight, recorded and solved by the program: WINGD, or that of the PATH or the build."""

import os
import shutil
from pathlib import Path

import pytest

from demo.prepare import solve_jointly

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="session")
def demo_store(tmp_path_factory):
    program = os.environ.get("WINGD") or shutil.which("wingd") or str(ROOT / "target" / "release" / "wingd")
    assert Path(program).exists(), f"{program}: build the program first, or set WINGD="
    os.environ["WINGD"] = program
    return solve_jointly(program, tmp_path_factory.mktemp("demo") / "demo")
