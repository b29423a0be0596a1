"""Modes from live results: two known modes are identified within their standard deviations, by day and by window."""

from __future__ import annotations

import csv
import io
import json
import os
from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from wingd import WingdError, modes
from wingd.commands import fleet as cli

RATE_HZ, STATIONS = 10.0, 20
# Frequency in Hz, damping, rms of the tip in m.
TRUE = ((1.3, 0.03, 0.10), (3.7, 0.02, 0.03))


def swing(hz: float, damping: float, rms_m: float, count: int, random) -> np.ndarray:
    """Simulates a mode excited by white noise, in its steady state."""
    omega = 2 * np.pi * hz / RATE_HZ
    decay = np.exp(-damping * omega)
    first, second = 2 * decay * np.cos(omega * np.sqrt(1 - damping**2)), decay**2
    gain = (1 - second) * ((1 + second) ** 2 - first**2) / (1 + second)
    noise, out = random.standard_normal(count + 2000) * rms_m * np.sqrt(gain), np.zeros(count + 2000)
    for k in range(2, len(out)):
        out[k] = first * out[k - 1] - second * out[k - 2] + noise[k]
    return out[2000:]


def shapes() -> list[np.ndarray]:
    """Returns the bending shape of a uniform load and the second mode of a uniform cantilever, 1 at the tip."""
    eta = np.linspace(0, 1, STATIONS)
    root = 4.694091
    free = (np.cosh(root) + np.cos(root)) / (np.sinh(root) + np.sin(root))
    b = root * eta
    second = np.cosh(b) - np.cos(b) - free * (np.sinh(b) - np.sin(b))
    return [eta**2 * (6 - 4 * eta + eta**2) / 3, second / second[-1]]


def export(path: Path, seed: int, seconds: float = 300, true=TRUE, skipped: float = 0.0, hole: bool = False) -> Path:
    """Creates a table as `wingd export --table live`, from a curve with correlated noise of 2 mm at the tip."""
    random, count = np.random.default_rng(seed), round(seconds * RATE_HZ)
    deflections = 2.0 + sum(
        np.outer(swing(*one, count, random), shape) for one, shape in zip(true, shapes(), strict=False)
    )
    deflections += 0.002 * random.standard_normal((count, 2)) @ np.vstack(shapes())
    times = 1000 + np.arange(count) / RATE_HZ + 0.001 * random.standard_normal(count)
    kept = random.random(count) >= skipped
    if hole:
        kept &= abs(np.arange(count) - count / 2) > 100
    arcs = np.linspace(0, 30, STATIONS)
    columns = {
        "recorder_id": ["ab"] * count,
        "flight": ["f0001"] * count,
        "boot_id": ["b"] * count,
        "since_boot_s": times,
    }
    columns["exposure_time"] = pa.array((1e6 * times).astype(int), pa.timestamp("us", "UTC"))
    for k in range(STATIONS):
        columns[f"deflection_s{k + 1:02}_m"], columns[f"arc_length_s{k + 1:02}_m"] = (
            deflections[:, k],
            np.full(count, arcs[k]),
        )
    columns |= {"mach": np.full(count, 0.78), "sigma_mach": np.full(count, 0.002)}
    columns |= {"fuel_kg": np.linspace(20000, 19000, count), "sigma_fuel_kg": np.full(count, 50.0)}
    pq.write_table(pa.table(columns).filter(pa.array(kept)), path)
    return path


def found(path: Path, capsys, *more: str) -> list[dict]:
    assert cli.main(["modes", str(path), *more]) == 0
    rows = list(csv.DictReader(io.StringIO(capsys.readouterr().out)))
    return [{k: float(v) if _is_number(v) else v for k, v in row.items()} for row in rows]


def _is_number(text: str) -> bool:
    try:
        return bool(text) and float(text) == float(text)
    except ValueError:
        return False


def check(rows: list[dict], true=TRUE) -> list[float]:
    """Frequency to 1 %, shape's MAC 0.99; the normalised errors are consistent."""
    off = []
    for row, (hz, damping, _), shape in zip(rows, true, shapes(), strict=True):
        assert abs(row["frequency_hz"] / hz - 1) < 0.01, row
        labels = [name[6:] for name in row if name.startswith("shape_")]
        truth = np.array([shape[int(label[1:]) - 1] for label in labels])
        assert modes.mac(np.array([row[f"shape_{label}"] for label in labels]), truth) > 0.99, row
        assert row[f"shape_{labels[-1]}"] == 1 and row[f"arc_length_{labels[-1]}_m"] == 30
        off += [
            (row["frequency_hz"] - hz) / row["sigma_frequency_hz"],
            (row["damping"] - damping) / row["sigma_damping"],
        ]
    return off


def test_two_modes_are_found_again_within_their_standard_deviations(tmp_path, capsys):
    """Ten flights of five minutes, 3 % of their results skipped in half of them."""
    off = []
    for seed in range(10):
        rows = found(export(tmp_path / "live.parquet", seed, skipped=0.03 * (seed % 2)), capsys)
        off += check(rows)
        assert {row["flight"] for row in rows} == {"f0001"} and rows[0]["mach"] == pytest.approx(0.78)
        assert rows[0]["fuel_kg"] == pytest.approx(19500, abs=20) and 280 < rows[0]["sigma_fuel_kg"] < 300
        assert rows[0]["missing_share"] == pytest.approx(0.03 * (seed % 2), abs=0.015)
    rms = float(np.sqrt(np.mean(np.square(off))))
    print(f"normalised {rms:.2f}, worst {np.abs(off).max():.2f}")
    assert 0.6 < rms < 1.4 and np.abs(off).max() < 4


def test_windows_and_holes_have_modes_of_their_own(tmp_path, capsys):
    rows = found(export(tmp_path / "live.parquet", 3, seconds=600), capsys, "--seconds", "300", "--count", "1")
    assert [row["mode"] for row in rows] == [1, 1] and rows[0]["ended"] < rows[1]["began"]
    rows = found(export(tmp_path / "hole.parquet", 4, seconds=600, hole=True), capsys, "--count", "2")
    assert [row["mode"] for row in rows] == [1, 2, 1, 2]
    assert all(abs(row["seconds"] - 290) < 2 for row in rows)


def test_noise_has_no_modes_and_wrong_exports_say_what_to_do(tmp_path, capsys):
    assert cli.main(["modes", str(export(tmp_path / "noise.parquet", 5, true=()))]) == 1
    assert "no mode above 1 Hz" in capsys.readouterr().err
    pq.write_table(pa.table({"since_boot_s": [1.0, 2.0]}), tmp_path / "other.parquet")
    assert cli.main(["modes", str(tmp_path / "other.parquet")]) == 1
    assert "no deflections of stations" in capsys.readouterr().err
    with pytest.raises(WingdError, match="less than 20 periods"):
        modes.rows(pd.DataFrame({"since_boot_s": [1.0]}), 10, 1.0, 3, "stations")
    (tmp_path / "live.txt").write_text("")
    assert cli.main(["modes", str(tmp_path / "live.txt")]) == 1


@pytest.mark.skipif(
    "WINGD_MODES" not in os.environ,
    reason="WINGD_MODES names the folder of `make table TABLE=modes`",
)
def test_modes_through_the_adjustment_of_live_frames(capsys):
    folder = Path(os.environ["WINGD_MODES"])
    truth = json.loads((folder / "truth.json").read_text())
    rows = found(folder / "live.csv", capsys, "--of", "markers", "--count", "2")
    for row, one in zip(rows, truth, strict=True):
        labels = [name[6:] for name in row if name.startswith("shape_")]
        agreement = modes.mac(
            np.array([row[f"shape_{label}"] for label in labels]), np.array([one["shape"][label] for label in labels])
        )
        off = (row["frequency_hz"] - one["hz"]) / row["sigma_frequency_hz"]
        with capsys.disabled():
            print(
                f"{one['hz']} Hz: {row['frequency_hz']:.4f} +- {row['sigma_frequency_hz']:.4f} ({off:+.2f} sigma), MAC {agreement:.4f}"
            )
            print(f"  damping {one['damping']}: {row['damping']:.4f} +- {row['sigma_damping']:.4f}")
        assert abs(row["frequency_hz"] / one["hz"] - 1) < 0.01 and abs(off) < 2
        assert agreement > 0.99
