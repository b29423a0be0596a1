import subprocess
import sys

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
