"""Shapes of a fleet: equal wings are equal whatever their tip markers, and each standard deviation is that of its mean."""

from __future__ import annotations

import re
import shutil
from pathlib import Path

import numpy as np
import pytest

from demo.prepare import call, recorder_of
from wingd.backend import open_shape
from wingd.fleet import program, report, shapes, solves, task
from wingd.fleet.desk import Desk
from wingd.fleet.lake import FleetError, Lake

# Markers that the second survey lacks: the outermost ones.
OUTER = ("M24", "M25", "M26", "M27")
# Within the model of both, m.
LENGTH_M = 24.0
# The second model, m.
SHORT_M = 24.9


def shorter(wingd: str, demo: Path, folder: Path) -> Path:
    """Create a recorder's installation without its outermost markers, and orient it."""
    shutil.copytree(demo / "input/installation", folder, ignore=shutil.ignore_patterns("orientation.toml"))
    survey = folder / "survey.csv"
    lines = [line for line in survey.read_text().splitlines() if line.split(",")[0] not in OUTER]
    survey.write_text("\n".join(lines) + "\n")
    main = folder / "installation.toml"
    text = main.read_text().replace('"M26"', '"M23"').replace('"M27"', '"M22"')
    # The model ends further inboard, with the same skin.
    root, tip, end = (float(re.search(rf"{name} = ([0-9.]+)", text)[1]) for name in ("root", "tip", "tip_span_m"))
    skin = f"root = {root}, tip = {tip + (root - tip) * (1 - SHORT_M / end):.4f}, tip_span_m = {SHORT_M} }}"
    main.write_text(re.sub(r"root = [0-9.]+, tip = .*}", skin, text))
    call(wingd, "orient", "--installation", str(folder), str(demo / "input/frames/ground.jpg"))
    return folder


@pytest.fixture(scope="module")
def equal(wingd, recorders, tmp_path_factory) -> Lake:
    """One flight of two aircraft, with the same loads: the second is solved without its outermost markers."""
    folder = tmp_path_factory.mktemp("equal")
    lake, stores = Lake(f"file://{folder}/lake"), []
    for name, recorder in zip(("D-ONE", "D-TWO"), recorders, strict=True):
        store = folder / name
        shutil.copytree(recorder, store)
        stores.append(store)
    table = recorders[0].parent / "aircraft.csv"
    call(wingd, "aircraft-data", str(stores[1]), str(table), "--flight", "f0001")
    for store in stores:
        labels = ("--aircraft", store.name, "--aircraft-type", "DEMO", "--wing", "left")
        call(wingd, "upload", str(store), "--to", lake.url, *labels)
    own = [recorders[0].parent / "input/installation", shorter(wingd, recorders[1].parent, folder / "short")]
    rules = [({"recorder": recorder_of(s), "from": None}, i) for s, i in zip(stores, own, strict=True)]
    for solve, lengths in (("own", {}), ("24m", {"DEMO": LENGTH_M})):
        solves.define(lake, solve, rules, [], program.version(wingd), lengths)
        for flight in solves.flights(lake):
            assert task.run(lake, solve, flight, wingd, folder / "work") == "done"
    return lake


def test_equal_wings_are_equal_at_equal_arc_lengths(equal):
    """Their tips differ by 0.2 m, 11.7 standard deviations, because the tip is another marker."""
    desk = Desk(equal, ["24m"])
    tips = desk.rows("SELECT tip_marker, deflection_m FROM deflection_by_aircraft ORDER BY aircraft")
    assert tips[0]["tip_marker"] != tips[1]["tip_marker"]
    assert abs(tips[0]["deflection_m"] - tips[1]["deflection_m"]) > 0.1
    rows = desk.rows("FROM aircraft_against_type ORDER BY aircraft, eta")
    assert [(row["aircraft"], row["eta"]) for row in rows] == [
        (a, eta) for a in ("D-ONE", "D-TWO") for eta in shapes.ETA
    ]
    for row in rows:
        assert row["arc_length_m"] == pytest.approx(LENGTH_M * row["eta"], abs=1e-3)
        assert abs(row["over_sigma"]) < 1 and abs(row["offset_m"]) < 0.008, row
    both = desk.rows(
        "SELECT eta, max(deflection_m) - min(deflection_m) AS apart, min(sigma_m) AS s FROM shape_by_wing GROUP BY eta"
    )
    assert len(both) == len(shapes.ETA) and all(row["apart"] < row["s"] for row in both), both
    assert not any("not compared" in text for text in desk.incomplete())


def test_wings_of_different_lengths_are_not_compared_and_both_lengths_are_named(equal, tmp_path):
    desk = Desk(equal, ["own"])
    lines = desk.rows("SELECT eta, count(*) AS lines, max(frames) AS frames FROM line_of_type GROUP BY eta")
    assert [(row["lines"], row["frames"]) for row in lines] == [(2, 10)] * len(shapes.ETA)
    (text,) = [text for text in desk.incomplete() if "not compared" in text]
    lengths = [row["length_m"] for row in desk.rows("SELECT DISTINCT length_m FROM shape ORDER BY length_m")]
    assert len(lengths) == 2 and all(f"{length:.3f} m" in text for length in lengths) and "--length" in text
    report.write(desk, tmp_path / "fleet.html")
    assert text in (tmp_path / "fleet.html").read_text()


def test_left_and_right_are_lines_of_their_own(wingd, equal, tmp_path):
    from wingd.fleet import corrections

    shutil.copytree(equal.folder, tmp_path / "lake")
    lake = Lake(f"file://{tmp_path}/lake")
    corrections.add(lake, "set", {"aircraft": "D-TWO"}, "tests", "to see", {"wing": "right"})
    rows = Desk(lake, ["24m"]).rows("SELECT side, eta, frames FROM line_of_type ORDER BY side, eta")
    assert [(row["side"], row["frames"]) for row in rows] == [("left", 10)] * 4 + [("right", 10)] * 4


@pytest.mark.parametrize("jointly", [False, True])
def test_the_sigma_of_a_mean_is_that_of_wingd_for_python(wingd, recorders, tmp_path, jointly):
    """Errors that frames share stay in the mean of the view, as in `wingd.Values.mean`."""
    store, export = tmp_path / "store", tmp_path / "shape.nc"
    shutil.copytree(recorders[0], store)
    own = recorders[0].parent / "input/installation"
    how = [] if jointly else ["--single"]
    lake = Lake(f"file://{tmp_path}/lake")
    call(wingd, "upload", str(store), "--to", lake.url)
    solves.define(lake, "kept", None, [], "as recorded", {"": LENGTH_M})
    rules = [({"recorder": recorder_of(store), "from": None}, own)]
    solves.define(lake, "solved", rules, how, program.version(wingd), {"": LENGTH_M})
    for solve in ("kept", "solved"):
        assert task.run(lake, solve, solves.flights(lake)[0], wingd, tmp_path / "work") == "done"
    if jointly:
        call(wingd, "solve", str(store), "--installation", str(own))
    eta = ",".join(map(str, shapes.EXPORTED_ETA))
    call(wingd, "export", str(store), "--format", "netcdf", "--table", "shape", "--eta", eta, "--output", str(export))
    dataset = open_shape(export)
    values = dataset.wingd.displacement(axis="z").at(arc_length=LENGTH_M * np.array(shapes.ETA))
    if dataset["jointly"].values.all():
        mean = values.mean()
        wanted = mean.value.values, mean.sigma.values
    else:
        wanted = values.value.values.mean(axis=0), values.sigma.values.mean(axis=0)
    desk = Desk(lake)
    rows = desk.rows("FROM shape_by_flight WHERE solve = 'solved' ORDER BY eta")
    assert [row["frames"] for row in rows] == [10] * 4
    np.testing.assert_allclose([row["deflection_m"] for row in rows], wanted[0], rtol=1e-8)
    np.testing.assert_allclose([row["sigma_m"] for row in rows], wanted[1], rtol=1e-6)
    wing = desk.rows("SELECT sigma_m FROM shape_by_wing WHERE solve = 'solved' ORDER BY eta")
    np.testing.assert_allclose([row["sigma_m"] for row in wing], wanted[1], rtol=1e-6)
    # The loads of the frames differ: their scatter is no standard deviation of the mean.
    scatter = np.array([row["scatter_m"] for row in rows])
    assert np.all(scatter[1:] / np.sqrt(10) > 2 * wanted[1][1:])
    if not jointly:
        # Without the frames, from the curves as uploaded.
        kept = desk.rows("FROM shape_by_flight WHERE solve = 'kept' ORDER BY eta")
        for one, other in zip(kept, rows, strict=True):
            assert abs(one["deflection_m"] - other["deflection_m"]) < 1e-4
            assert one["sigma_m"] == pytest.approx(other["sigma_m"], rel=1e-3)


@pytest.mark.parametrize("table", ["span", "shape", "markers", "parameters"])
def test_a_table_that_is_gone_is_one_line_with_the_remedy(solved, tmp_path, capsys, table):
    from wingd.commands.fleet import main

    shutil.rmtree(solved.folder / f"tables/v3/{table}")
    views = {
        "span": "shape_by_series",
        "shape": "aircraft_against_type",
        "markers": "detection",
        "parameters": "mount_by_aircraft",
    }
    for asked in (
        f"FROM {table}",
        f"FROM {views[table]}",
        f"SELECT count(*) FROM shots JOIN {table} USING (series, shot)",
    ):
        assert main(["query", "--lake", solved.url, "--cache", str(tmp_path), asked]) == 1
        out, err = capsys.readouterr()
        lines = [line for line in err.splitlines() if "no shapes" not in line]
        assert out == "" and len(lines) == 1, (out, err)
        assert f"table {table}: 4 of 4 files are missing" in lines[0] and "wingd-fleet repair" in lines[0]
    assert main(
        ["report", "--lake", solved.url, "--cache", str(tmp_path), "--output", str(tmp_path / "page.html")]
    ) == 1 or (table == "span")


def test_lengths_are_parsed_or_refused():
    assert shapes.parse_lengths(["17.1", "A320=16.9"]) == {"": 17.1, "A320": 16.9}
    assert shapes.length_of({"lengths": {"": 17.1, "A320": 16.9}}, "A320") == 16.9
    assert shapes.length_of({"lengths": {"A320": 16.9}}, "A321") is None and shapes.length_of({}, None) is None
    for wrong in (["A320"], ["A320=-1"], ["nan"], ["17", "18"], ["A=inf"]):
        with pytest.raises(FleetError, match="--length"):
            shapes.parse_lengths(wrong)


def test_views_name_what_they_hold():
    folder = Path(shapes.__file__).parent
    text = "".join(path.read_text() for path in folder.glob("*.sql"))
    assert not re.search(r"/ sqrt\(count\(\*\)\) AS sigma", text), "a scatter is no standard deviation of a mean"
