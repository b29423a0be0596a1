import subprocess
import sys
from pathlib import Path

import pytest

import wingd
from wingd.__main__ import main


def test_import_loads_no_heavy_module():
    code = "import wingd, sys; print([m for m in ('numpy', 'xarray', 'pandas', 'matplotlib') if m in sys.modules])"
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout == "[]\n"


def test_unknown_names_are_errors(capsys):
    with pytest.raises(AttributeError, match="no attribute 'shape'"):
        wingd.shape  # noqa: B018
    assert main(["means"]) == 2
    assert "no command 'means'" in capsys.readouterr().err
    assert main([]) == 0


def test_a_query_of_a_fleet_loads_no_module_of_shapes():
    pytest.importorskip("duckdb")
    code = "import sys, wingd.commands.fleet, wingd.fleet.desk; print([m for m in ('xarray', 'scipy', 'matplotlib') if m in sys.modules])"
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout == "[]\n"


@pytest.mark.parametrize(("missing", "call"), [
    ("yaml", ["convert", "cameras/opencv.yaml", "OUT"]), ("pint", ["table", "tables/all-units.csv", "--mapping", "tables/all-units.toml", "-o", "OUT"]),
    ("meshio", ["deform", "surfaces/shape.nc", "--surface", "surfaces/points.csv", "-o", "OUT"]), ("cv2", ["time-check", "IMAGE", "--times", "TIMES"]),
])  # fmt: skip
def test_a_missing_library_is_one_line_with_the_extra(missing, call, tmp_path, monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, missing, None)
    from wingd.conditions import units

    units._registry.cache_clear()
    units.find_unit.cache_clear()
    (tmp_path / "a.png").write_bytes(b"x")
    (tmp_path / "times.csv").write_text("image,utc\na.png,2026-06-01T08:00:00Z\n")
    names = {"OUT": str(tmp_path / "o"), "IMAGE": str(tmp_path / "a.png"), "TIMES": str(tmp_path / "times.csv")}
    data = Path(__file__).parent / "data"
    arguments = [names.get(a, str(data / a) if "/" in a else a) for a in call]
    assert main(arguments) == 1
    printed = capsys.readouterr()
    assert "pip install 'wingd[" in printed.out + printed.err and not (tmp_path / "o").exists(), printed
