"""Tables as seen by queries, engines and Iceberg, also if newer files have more columns; live results; the report."""

from __future__ import annotations

import os
import subprocess
import sys

import pyarrow as pa
import pytest

from demo import engines, synthesise
from demo.prepare import WEIGHT_KG, call, fly, recorder_of
from wingd.fleet import charts, desk, iceberg, parquet, records, report, snapshot, solves, task
from wingd.fleet.corrections import ATTRIBUTES
from wingd.fleet.desk import Desk
from wingd.fleet.lake import FleetError, Flight, Lake
from wingd.fleet.records import sha256
from wingd.fleet.state import State

from .faults import answers


def newer(lake: Lake, change) -> Flight:
    """Adds a flight whose tables are from a newer program: `change` creates its columns."""
    template = State(lake).published(["onboard"])[0]
    flight = Flight(template.flight.recorder, "f0002")
    lake.create(flight.manifest, lake.need(template.flight.manifest))
    commit = records.read(lake, template.commit) | {"flight": flight.flight}
    for name, table in template.tables.items():
        content = parquet.read(lake.need(table.key))
        place = content.schema.get_field_index("flight")
        content = change(content.set_column(place, "flight", pa.array(["f0002"] * len(content), pa.string())))
        data = parquet.write(content)
        key = flight.table(name, "onboard", sha256(data))
        lake.create(key, data)
        commit["tables"][name] = {
            "key": key,
            "sha256": sha256(data),
            "rows": len(content),
            "columns": parquet.columns(content.schema),
        }
    lake.create(flight.commit("onboard", 1), records.dump({k: v for k, v in commit.items() if k != "seal"}))
    return flight


def gusty(content: pa.Table) -> pa.Table:
    return content.append_column("gust_m_s", pa.array([0.5] * len(content)))


def test_every_engine_reads_old_and_new_flights_the_same(solved, tmp_path, capsys):
    """Returns the files of a snapshot, as in docs/fleet.md."""
    newer(solved, gusty)
    snapshot.make(solved, tmp_path / "work")
    assert engines.compare(solved, "onboard", tmp_path / "cache")
    assert capsys.readouterr().out.count(" 30 ") == 4, "thirty frames by each of four"
    files = [str(path) for path in desk.files(solved, "shots", ["onboard"], tmp_path / "cache")]
    import pandas
    import polars
    import pyarrow.dataset as ds

    assert polars.read_parquet(files, hive_partitioning=False)["gust_m_s"].null_count() == 20
    assert ds.dataset(files).to_table()["gust_m_s"].null_count == 20
    assert pandas.read_parquet(files[0], partitioning=None)["gust_m_s"].isna().sum() == 20


def test_a_snapshot_answers_as_the_flights_do(solved, tmp_path):
    whole = answers(solved)
    first = snapshot.make(solved, tmp_path / "work")
    assert answers(solved) == whole
    assert snapshot.make(solved, tmp_path / "work") == first
    # A flight uploaded later is read in addition.
    newer(solved, gusty)
    assert Desk(solved).rows("SELECT count(*) AS n, count(gust_m_s) AS g FROM shots") == [{"n": 50, "g": 10}]
    second = snapshot.make(solved, tmp_path / "work", prune=True)
    assert snapshot.ids(solved) == [second] != [first]
    assert Desk(solved).rows("SELECT count(*) AS n, count(gust_m_s) AS g FROM shots") == [{"n": 50, "g": 10}]


def test_snapshot_files_are_sorted_by_aircraft_and_day(solved, tmp_path):
    snapshot.make(solved, tmp_path / "work")
    (file,) = desk.files(solved, "markers", ["onboard"], tmp_path / "cache")
    content = parquet.read(file.read_bytes())
    order = list(zip(content["aircraft"].to_pylist(), content["utc"].to_pylist(), strict=False))
    assert order == sorted(order) and len(order) == 540
    assert all(content[name].null_count == 0 for name in ATTRIBUTES)


def test_iceberg_is_the_current_snapshot_and_nothing_else(solved, tmp_path):
    catalog = iceberg.catalogue(solved, f"sqlite:///{tmp_path}/catalogue.db")
    with pytest.raises(FleetError, match="compact"):
        iceberg.update(solved, catalog)
    first = snapshot.make(solved, tmp_path / "work")
    assert set(iceberg.update(solved, catalog).values()) == {2}
    assert set(iceberg.update(solved, catalog).values()) == {0}
    newer(solved, gusty)
    snapshot.make(solved, tmp_path / "work")
    iceberg.update(solved, catalog)
    table = catalog.load_table((iceberg.NAMESPACE, "shots"))
    rows = table.scan().to_arrow()
    assert rows.num_rows == 50 and rows["gust_m_s"].null_count == 40
    states = [one.summary.additional_properties.get(iceberg.STATE) for one in table.snapshots()]
    assert states[0] == first and states[-1] == snapshot.ids(solved)[-1]
    assert table.scan(row_filter="solve = 'recalibrated'").to_arrow().num_rows == 20


def test_columns_follow_the_rule(solved):
    """Additional columns are kept, missing ones are null, another type is rejected; identifying columns are required."""
    one = State(solved).published(["onboard"])[0]
    content = parquet.read(solved.need(one.tables["shots"].key)).drop_columns(["solve"])
    whole = parquet.completed(content.append_column("gust_m_s", content["tip_deflection_m"]), "shots", "s")
    assert list(parquet.schema("shots")) == whole.column_names[:-1] and whole.column_names[-1] == "gust_m_s"
    lacking = parquet.completed(content.drop_columns(["mach"]), "shots", "s")
    assert lacking["mach"].null_count == 10 and lacking.schema.equals(whole.drop_columns(["gust_m_s"]).schema)
    with pytest.raises(FleetError, match="column tip_deflection_m is string, not double"):
        place = content.schema.get_field_index("tip_deflection_m")
        parquet.completed(content.set_column(place, "tip_deflection_m", pa.array(["long"] * 10)), "shots", "s")
    with pytest.raises(FleetError, match="lacks flight"):
        parquet.completed(content.drop_columns(["flight"]), "shots", "s")


def test_aircraft_data_are_in_every_table_of_frames(solved, recorders):
    weighed = recorder_of(recorders[0])
    desk = Desk(solved, ["onboard"])
    for table in ("shots", "markers", "parameters", "span"):
        sql = f"SELECT count(weight_kg) = count(*) AS w, count(mach) = count(*) AS m FROM {table} WHERE recorder_id = ?"
        assert desk.rows(sql, [weighed]) == [{"w": True, "m": True}], table
        assert set(parquet.schema("shots")) & set(parquet.schema(table)) > {"weight_kg", "load_factor", "mach"}
    for table in parquet.LIVE:
        assert {"weight_kg", "load_factor", "mach"} < set(parquet.schema(table))
    rows = desk.rows(
        "SELECT m.weight_kg, s.weight_kg AS of_shot FROM markers m JOIN shots s USING (recorder_id, flight, series, shot)"
    )
    assert all(row["weight_kg"] == row["of_shot"] for row in rows)


def test_live_results_have_tables(wingd, tmp_path):
    store = fly(wingd, tmp_path / "recorder", "--seed", "7", "--tip-deflections", "2.4,2.2")
    lake = Lake(f"file://{tmp_path / 'lake'}")
    call(wingd, "upload", str(store), "--to", lake.url)
    solves.define(lake, "onboard", None, [], "as recorded")
    (flight,) = solves.flights(lake)
    assert task.run(lake, "onboard", flight, wingd, tmp_path / "work") == "done"
    exported = call(wingd, "export", str(store), "--format", "csv", "--table", "live").stdout.splitlines()
    desk = Desk(lake)
    (row,) = desk.rows(
        "SELECT count(*) AS n, count(tip_deflection_m) AS deflections, any_value(status) AS status FROM live"
    )
    assert row["n"] == len(exported) - 1 > 3 and row["deflections"] > 3
    # Rows of stations and markers agree with the columns of the export.
    header = exported[0].split(",")
    column, arc = "deflection_s05_m", "arc_length_s05_m"
    label = next(value for line in exported[1:] if (value := line.split(",")[header.index(arc)]))
    values = [
        float(line.split(",")[header.index(column)]) for line in exported[1:] if line.split(",")[header.index(column)]
    ]
    found = desk.rows(
        "SELECT deflection_m FROM live_span WHERE arc_length_m = ? AND deflection_m IS NOT NULL ORDER BY number",
        [float(label)],
    )
    assert [row["deflection_m"] for row in found] == pytest.approx(values, rel=1e-6)
    markers = sum(name.startswith("u_") for name in header)
    assert desk.rows("SELECT count(DISTINCT marker) AS n FROM live_markers") == [{"n": markers}]
    assert desk.rows("SELECT results FROM live_by_flight") == [{"results": row["n"]}]
    # Aircraft data at the time of each result, and its provenance, as for frames.
    for table in ("live", "live_markers", "live_span", "shots"):
        asked = f"SELECT count(weight_kg) > 0.5 * count(*) AS most, min(weight_kg) AS w, max(mach) AS m FROM {table}"
        assert desk.rows(asked) == [{"most": True, "w": WEIGHT_KG, "m": 0.78}], table
    asked = "SELECT count(DISTINCT program) AS p, count(inputs) = count(*) AS i FROM live WHERE status = 'ok'"
    assert desk.rows(asked) == [{"p": 1, "i": True}]
    report.write(desk, tmp_path / "fleet.html", "onboard")
    assert "Live results" in (tmp_path / "fleet.html").read_text()


def test_live_exports_of_old_and_new_programs_make_the_same_rows():
    """Stations named by arc length, and numbered stations with the arc length in a column."""
    once = {
        "recorder_id": ["r", "r"],
        "flight": ["f0001"] * 2,
        "boot_id": ["b"] * 2,
        "number": [1, 2],
        "solved": [1, 0],
    }
    marker = {"u_M01_px": [10.0, None], "deflection_M01_m": [0.5, None], "markers_x": [1, 1]}
    span = {"0.0": [0.0, 0.0], "31.00564147942904": [2.5, None]}
    old = pa.table({**once, **marker, "twist_tip_deg": [1.5, None], **{f"deflection_{arc}_m": v for arc, v in span.items()},
                    **{f"span_{arc}_m": v for arc, v in span.items()}})  # fmt: skip
    new = {
        **once,
        "result_id": ["b/1", "b/2"],
        "status": ["ok", "failed"],
        **marker,
        "torsion_tip_twist_deg": [1.5, None],
    }
    for k, (arc, values) in enumerate(span.items(), 1):
        new |= {f"deflection_s{k:02}_m": values, f"span_s{k:02}_m": values, f"arc_length_s{k:02}_m": [float(arc)] * 2}
    # A third station, of another installation.
    new |= {f"{name}_s03_m": pa.nulls(2, pa.float64()) for name in ("deflection", "span", "arc_length")}
    old_rows, new_rows = parquet.live_rows(old), parquet.live_rows(pa.table(new))
    for table in ("live_span", "live_markers"):
        columns = old_rows[table].column_names
        assert new_rows[table].select(columns).to_pylist() == old_rows[table].to_pylist(), table
    assert old_rows["live_span"]["arc_length_m"].to_pylist() == [0.0, 31.00564147942904] * 2
    assert old_rows["live"]["status"].to_pylist() == new_rows["live"]["status"].to_pylist() == ["ok", "failed"]
    assert (
        new_rows["live"]["twist_tip_deg"].to_pylist() == [1.5, None]
        and "deflection_s01_m" not in new_rows["live"].column_names
    )
    whole = [parquet.completed(rows["live"], "live", "kept") for rows in (old_rows, new_rows)]
    assert [one["result_id"].to_pylist() for one in whole] == [[None, None], ["b/1", "b/2"]]


def test_the_report_answers_and_says_what_is_absent(solved, tmp_path):
    page = tmp_path / "fleet.html"
    report.write(Desk(solved), page, "recalibrated", "onboard")
    text = page.read_text()
    assert "D-DEMA" in text and "D-DEMB" in text and solves.flights(solved)[0].recorder in text
    assert "recalibrated minus onboard, mm" in text and "deflection against weight times load factor" in text
    assert "<script" not in text and "http" not in text, "opens offline"


def test_the_report_draws_the_worst(solved, tmp_path):
    """Forty wings, and the one that differs most has the fewest flights."""
    made = Lake(f"file://{tmp_path / 'synthetic'}")
    synthesise.make(solved, made, 81)
    desk = Desk(made)
    sql = (
        "SELECT aircraft, wing FROM aircraft_against_type WHERE solve = 'onboard' ORDER BY abs(over_sigma) DESC LIMIT 1"
    )
    (worst,) = desk.rows(sql)
    (few,) = desk.rows("SELECT count(*) AS n FROM deflection_by_aircraft WHERE solve = 'onboard' AND flights > 2")
    assert few["n"] < 8
    drawn = report._worst(desk, report._OF_TYPE, ["onboard"])
    assert len(drawn) == 8 and (worst["aircraft"], worst["wing"]) in drawn
    report.write(desk, tmp_path / "fleet.html", "onboard", "recalibrated", True)
    assert "Drawn are the 8 wings" in (tmp_path / "fleet.html").read_text()


def test_synthetic_flights_say_so_and_their_truth_is_found_again(solved, tmp_path):
    made = Lake(f"file://{tmp_path / 'synthetic'}")
    synthesise.make(solved, made, 120)
    asked = Desk(made)
    assert asked.rows("SELECT count(DISTINCT (recorder_id, flight)) AS n FROM frames")[0]["n"] == 120
    for row in asked.rows("FROM line_of_type WHERE solve = 'onboard'"):
        truth = synthesise.SLOPES_M_PER_T[synthesise.TYPES.index(row["aircraft_type"])]
        assert abs(row["slope_m_per_t"] - truth) < 0.03 * truth
    found = asked.rows(
        "SELECT avg(difference_m) AS m, count(difference_m) AS n FROM compared('onboard', 'recalibrated')"
    )[0]
    assert abs(found["m"] - synthesise.SHIFT_M) < 4 * synthesise.SHIFT_SIGMA_M / found["n"] ** 0.5
    reasons = {r["reason"] for r in asked.rows("FROM failing_flights")}
    assert reasons == {"synthetic: no marker was found, the image is dark"}
    page = tmp_path / "fleet.html"
    report.write(asked, page, "recalibrated", "onboard", made.is_synthetic())
    assert "These flights are synthetic" in page.read_text()
    with pytest.raises(FleetError, match="is synthetic itself"):
        synthesise.make(made, Lake(f"file://{tmp_path / 'twice'}"), 1)


def test_a_figure_is_an_element_of_a_page():
    points = [(20_000.0 + k, 0.1 * k, 0.05) for k in range(500)]
    figure = charts.chart(
        [charts.Series("<a>", points), charts.Series("b", points[:2], line=True)], "day", "y", "of < x", True
    )
    assert figure == charts.chart(
        [charts.Series("<a>", points), charts.Series("b", points[:2], line=True)], "day", "y", "of < x", True
    )
    assert "http" not in figure and "&lt;a&gt;" in figure and len(figure) < 60_000
    assert "No data" in charts.chart([charts.Series("none", [])], "x", "y", "of nothing")


def test_a_bucket_is_read_as_a_directory_is(wingd, solved, server, tmp_path):
    lake = Lake("s3://fleet/asked")
    for key in solved.keys(""):
        lake.create(key, solved.need(key))
    wanted = answers(solved)
    cache = tmp_path / "cache"
    assert answers(lake, cache) == wanted
    # Also from the cache, unless it is damaged.
    for path in cache.rglob("*.parquet"):
        data = bytearray(path.read_bytes())
        data[len(data) // 2] ^= 4
        path.write_bytes(bytes(data))
    assert answers(lake, cache) == wanted
    snapshot.make(lake, tmp_path / "work")
    assert answers(lake, tmp_path / "other") == wanted
    catalog = iceberg.catalogue(lake, f"sqlite:///{tmp_path}/catalogue.db")
    iceberg.update(lake, catalog)
    assert catalog.load_table((iceberg.NAMESPACE, "markers")).scan().to_arrow().num_rows == 1080


def test_a_rest_catalogue_does_as_well(solved, server, tmp_path):
    """Catalogue of the S3 server: metadata in its own bucket, data in place."""
    lake = Lake("s3://fleet/rest")
    for key in solved.keys(""):
        lake.create(key, solved.need(key))
    snapshot.make(lake, tmp_path / "work")
    # pyiceberg reads its settings when it is first imported.
    code = (
        "import sys; from wingd.fleet import iceberg; from wingd.fleet.lake import Lake; lake = Lake(sys.argv[1]);"
        "catalog = iceberg.catalogue(lake, sys.argv[2]);"
        "print([iceberg.update(lake, catalog)['shots'] for _ in range(2)]);"
        "print(catalog.load_table(('wingd', 'shots')).scan().to_arrow().num_rows)"
    )
    url = f"http://127.0.0.1:{server.iceberg}"
    environment = {**os.environ, **server.catalogue("warehouse")}
    done = subprocess.run([sys.executable, "-c", code, lake.url, url], env=environment, capture_output=True, text=True)
    assert done.stdout.splitlines() == ["[2, 0]", "40"], done.stderr
