"""The notebooks, on a store of the demonstration's flight that the program solves."""

import os
import runpy
import shutil
import subprocess
from pathlib import Path

import matplotlib
import pytest

NOTEBOOKS = sorted((Path(__file__).parents[1] / "notebooks").glob("*.py"))
ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="session")
def demo_store(tmp_path_factory):
    program = os.environ.get("WINGD") or shutil.which("wingd") or str(ROOT / "target" / "release" / "wingd")
    assert Path(program).exists(), f"{program}: build the program first, or set WINGD="
    os.environ["WINGD"] = program
    folder = tmp_path_factory.mktemp("demo")
    subprocess.run([program, "demo", "--output", "demo"], cwd=folder, check=True, capture_output=True)
    # The results of the recorder are of single frames; these share their errors.
    together = subprocess.run([program, "solve", "demo/store", "--joint"], cwd=folder, capture_output=True)
    if together.returncode:
        subprocess.run([program, "solve", "demo/store", "--together"], cwd=folder, check=True, capture_output=True)
    return folder / "demo" / "store"


@pytest.mark.long
@pytest.mark.filterwarnings("ignore::wingd.values.WingdWarning")
@pytest.mark.parametrize("notebook", NOTEBOOKS, ids=lambda p: p.stem)
def test_notebook(notebook, demo_store, tmp_path, monkeypatch):
    matplotlib.use("Agg")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("WINGD_STORE", str(demo_store))
    monkeypatch.setenv("WINGD_CACHE", str(tmp_path / "cache"))
    runpy.run_path(str(notebook))
    assert list(tmp_path.glob("*.png")), "the notebook draws no figure"


def test_there_is_a_notebook_for_each_question():
    questions = {
        "deflection_over_lift",
        "fem",
        "before_and_after",
        "left_and_right",
        "surface",
        "loads",
        "modes",
        "fleet",
    }
    assert questions == {p.stem for p in NOTEBOOKS}
