"""The `sh` blocks of docs/fleet.md, line by line: a recorder's page, the S3 server, both tables' tools."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
import time
import urllib.request
from pathlib import Path

import pytest

from demo.prepare import call, recalibrated, recorder_of
from demo.server import HOST, free_ports
from wingd.fleet import parquet, solves
from wingd.fleet.lake import Lake
from wingd.fleet.state import State

PAGE = Path(__file__).parents[3] / "docs/fleet.md"
LAKE = "s3://wings/fleet"
# The page assumes a cluster; this is one machine.
SMALLER = {"--workers 8": "--workers 2", "-P 8 ": "-P 2 "}


@pytest.fixture
def recorder(wingd, recorders):
    """Serves the page of a recorder's store; yields its port."""
    port = free_ports(1)[0]
    serving = subprocess.Popen([wingd, "serve", str(recorders[0]), "--listen", f"{HOST}:{port}"])
    try:
        for _ in range(200):
            try:
                urllib.request.urlopen(f"http://{HOST}:{port}/status.json").close()
                break
            except OSError:
                time.sleep(0.05)
        yield port
    finally:
        serving.kill()
        serving.wait()


def blocks(port: int) -> list[str]:
    text = PAGE.read_text().replace("seat12a.local:8080", f"{HOST}:{port}")
    for large, small in SMALLER.items():
        assert large in text, f"{large} is no longer in the page"
        text = text.replace(large, small)
    return re.findall(r"^```sh\n(.*?)^```$", text, re.M | re.S)


def test_every_command_of_the_page_runs(wingd, recorders, recorder, server, tmp_path):
    shutil.copy(recorders[0].parent / "input/frames/ground.jpg", tmp_path)
    for folder in ("new/left", "new/right", "same/right"):
        (tmp_path / folder).parent.mkdir(exist_ok=True)
        recalibrated(wingd, recorders[0].parent, tmp_path / folder)
    server.make("wings")
    # The flight of the other wing is already in the lake, and its store on the workstation.
    shutil.copytree(recorders[1], tmp_path / "incoming/D-ABCE")
    call(
        wingd,
        "upload",
        str(recorders[1]),
        "--to",
        LAKE,
        "--aircraft",
        "D-ABCD",
        "--aircraft-type",
        "A320",
        "--wing",
        "right",
    )
    # The page calls it wingd, whatever the file of the program is called.
    (tmp_path / "bin").mkdir()
    (tmp_path / "bin/wingd").symlink_to(wingd)
    path = f"{tmp_path / 'bin'}:{Path(sys.executable).parent}:{os.environ['PATH']}"
    named = {"LEFT": recorder_of(recorders[0])[:8], "RIGHT": recorder_of(recorders[1])[:8], "WINGD": wingd}
    environment = {**os.environ, **named, "PATH": path, "HOME": str(tmp_path)}
    script = "\n".join(blocks(recorder))
    said = subprocess.run(["sh", "-eux", "-c", script], cwd=tmp_path, env=environment)
    assert said.returncode == 0
    state = State(Lake(LAKE))
    assert state.solves == ["cal-2026-11", "compared", "onboard"] and len(state.published()) == 6
    for report in ("fleet.html", "changed.html"):
        assert "</html>" in (tmp_path / report).read_text()
    assert len(solves.flights(Lake(f"file://{tmp_path / 'staging'}"))) == 1


def test_the_pages_of_the_tables_name_every_column():
    pages = [PAGE.parent / "fleet/tables.md", PAGE.parent / "tables.md"]
    text = "".join(page.read_text() for page in pages)
    named = set(re.findall(r"`([a-z_0-9]+)`", text)) | set(
        re.findall(r"`([a-z_0-9]+)`", PAGE.parent.joinpath("aircraft-data.md").read_text())
    )
    for table in parquet.TABLES:
        assert f"| `{table}` |" in text
        for column in parquet.schema(table):
            assert column.removeprefix("sigma_") in named or column in named, column
