"""The notebooks, on a store of the demonstration's flight that the program solves."""

import runpy
from pathlib import Path

import matplotlib
import pytest

NOTEBOOKS = sorted((Path(__file__).parents[1] / "notebooks").glob("*.py"))


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
