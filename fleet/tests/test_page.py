"""The `sh` blocks of docs/fleet.md, line by line as they stand there: a recorder's page, the S3 server, both tables' tools."""

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

from demo.prepare import call, recalibrated
from demo.server import HOST, free_ports
from wingd_fleet.lake import Lake

PAGE = Path(__file__).parents[2] / "docs/fleet.md"
LAKE = "s3://wings/fleet"
# The page speaks of a cluster; this is one machine.
SMALLER = {"--workers 8 ": "--workers 2 "}


@pytest.fixture
def recorder(wingd, recorders):
    """The page of a recorder's store: its port."""
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
        assert large in text, f"{large} stands in the page no more"
        text = text.replace(large, small)
    return re.findall(r"^```sh\n(.*?)^```$", text, re.M | re.S)


def test_every_command_of_the_page_runs(wingd, recorders, recorder, server, tmp_path):
    shutil.copy(recorders[0].parent / "input/frames/ground.jpg", tmp_path)
    for folder in ("new/D-ABCD", "same/D-ABCE"):
        (tmp_path / folder).parent.mkdir()
        recalibrated(wingd, recorders[0].parent, tmp_path / folder)
    server.make("wings")
    # The other aircraft of the page has its flight in the lake already.
    call(wingd, "upload", str(recorders[1]), "--to", LAKE, "--aircraft", "D-ABCE", "--aircraft-type", "A320")
    path = f"{Path(wingd).parent}:{Path(sys.executable).parent}:{os.environ['PATH']}"
    environment = {**os.environ, "PATH": path, "HOME": str(tmp_path)}
    script = "\n".join(blocks(recorder))
    said = subprocess.run(["sh", "-eux", "-c", script], cwd=tmp_path, env=environment)
    assert said.returncode == 0
    assert sorted(Lake(LAKE).committed()) == ["cal-2026-11", "onboard"]
    assert all(len(flights) == 2 for flights in Lake(LAKE).committed().values())
    for report in ("fleet.html", "changed.html"):
        assert "</html>" in (tmp_path / report).read_text()
    assert len(Lake(f"file://{tmp_path / 'staging'}").flights()) == 1
