"""The tables as engines and Iceberg see them, also when newer files have more columns; questions and report."""

from __future__ import annotations

import io
import os
import subprocess
import sys

import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from wingd_fleet import charts, desk, engines, iceberg, parquet, report, synthesise, task
from wingd_fleet.lake import VERSION, FleetError, Flight, Lake, dump

SOLVES = ("onboard", "recalibrated")


@pytest.fixture
def solved(wingd, lake, tmp_path) -> Lake:
    for solve in SOLVES:
        for flight in lake.flights():
            task.run(lake, solve, flight, wingd, tmp_path / "work")
    return lake


def newer(lake: Lake, solve: str, change) -> Flight:
    """A further flight whose tables are of a newer program: `change` makes its columns."""
    template = lake.committed("onboard")["onboard"][0]
    flight = Flight(template.aircraft, template.recorder, "f0002")
    for table in desk.TABLES:
        content = pq.read_table(io.BytesIO(lake.need(template.table(table, "onboard"))))
        for name, word in (("solve", solve), ("flight", "f0002")):
            place = content.schema.get_field_index(name)
            content = content.set_column(place, name, pa.array([word] * len(content), pa.string()))
        lake.create(flight.table(table, solve), parquet.write(change(content)))
    lake.create(flight.commit(solve), dump({}))
    return flight


def weighed(content: pa.Table) -> pa.Table:
    known = {"weight_kg": [70_000.0 + k for k in range(len(content))], "load_factor": [1.0] * len(content)}
    content = content.drop_columns([name for name in known if name in content.column_names])
    for name, values in (known | {"gust_m_s": [0.5] * len(content)}).items():
        content = content.append_column(name, pa.array(values))
    return content


def test_every_engine_reads_the_same(solved, capsys):
    assert engines.compare(solved, "recalibrated")
    assert capsys.readouterr().out.count(" 20 ") == 4, "twenty frames by each of four"


def test_iceberg_has_a_snapshot_and_a_tag_for_each_solve(solved, tmp_path):
    catalog = iceberg.catalogue(solved, f"sqlite:///{tmp_path}/catalogue.db")
    for solve in SOLVES:
        assert iceberg.update(solved, catalog, solve) == dict.fromkeys(desk.TABLES, 2)
        assert iceberg.update(solved, catalog, solve) == dict.fromkeys(desk.TABLES, 0)
    table = catalog.load_table((iceberg.NAMESPACE, "shots"))
    assert [s.summary[iceberg.SOLVE] for s in table.snapshots()] == list(SOLVES)
    assert table.scan().to_arrow().num_rows == 40
    before = table.metadata.refs["onboard"].snapshot_id
    assert set(table.scan(snapshot_id=before).to_arrow()["solve"].to_pylist()) == {"onboard"}
    one = table.scan(row_filter="solve = 'recalibrated' and aircraft = 'D-DEMB'")
    assert (len(list(one.plan_files())), one.to_arrow().num_rows) == (1, 10)


def test_columns_that_are_added_are_read_beside_files_that_lack_them(solved, tmp_path):
    catalog = iceberg.catalogue(solved, f"sqlite:///{tmp_path}/catalogue.db")
    iceberg.update(solved, catalog, "onboard")
    assert not desk.Desk(solved).has_load
    newer(solved, "onboard", weighed)
    assert iceberg.update(solved, catalog, "onboard") == dict.fromkeys(desk.TABLES, 1)
    rows = catalog.load_table((iceberg.NAMESPACE, "shots")).scan().to_arrow()
    assert rows.num_rows == 30 and rows["gust_m_s"].null_count == 20
    old = catalog.load_table((iceberg.NAMESPACE, "shots")).scan(row_filter="gust_m_s is null").to_arrow()
    assert set(old["flight"].to_pylist()) == {"f0001"} and old["tip_lift_m"].null_count == 0
    asked = desk.Desk(solved)
    assert asked.has_load
    assert asked.rows("SELECT count(weight_kg) AS n, count(*) AS all_of_them FROM frames")[0] == {
        "n": 10,
        "all_of_them": 50,
    }


def test_a_column_of_another_type_is_a_clear_fault(solved, tmp_path):
    def worded(content: pa.Table) -> pa.Table:
        name = next(n for n in ("tip_lift_m", "lift_m", "value") if n in content.column_names)
        place = content.schema.get_field_index(name)
        return content.set_column(place, name, pa.array(["long"] * len(content), pa.string()))

    catalog = iceberg.catalogue(solved, f"sqlite:///{tmp_path}/catalogue.db")
    iceberg.update(solved, catalog, "onboard")
    newer(solved, "onboard", worded)
    with pytest.raises(FleetError, match="do not go with it"):
        iceberg.update(solved, catalog, "onboard")


def test_a_table_that_lacks_a_column_of_its_version_is_not_published(solved):
    flight = solved.flights()[0]
    content = pq.read_table(io.BytesIO(solved.need(flight.table("shots", "onboard"))))
    parquet.check(content.schema, "shots")
    parquet.check(weighed(content).schema, "shots")
    with pytest.raises(FleetError, match="column tip_lift_m is missing"):
        parquet.check(content.drop_columns("tip_lift_m").schema, "shots")


def test_half_a_flight_is_seen_by_nobody(solved):
    flight = Flight("D-DEMA", solved.flights()[0].recorder, "f0009")
    shots = solved.need(solved.flights()[0].table("shots", "onboard"))
    solved.create(flight.table("shots", "onboard"), shots)
    assert desk.Desk(solved, ["onboard"]).rows("SELECT count(*) AS n FROM frames")[0]["n"] == 20


def test_the_report_answers_and_says_what_is_absent(solved, tmp_path):
    page = tmp_path / "fleet.html"
    report.write(desk.Desk(solved), page, "recalibrated", "onboard")
    text = page.read_text()
    assert "no weight and load factor" in text
    assert "D-DEMA" in text and "D-DEMB" in text and solved.flights()[0].recorder in text
    assert "recalibrated minus onboard, mm" in text
    assert "<script" not in text and "http" not in text, "opens offline"


def test_synthetic_flights_say_so_and_their_truth_is_found_again(solved, tmp_path):
    made = Lake(f"file://{tmp_path / 'synthetic'}")
    synthesise.make(solved, made, 120)
    asked = desk.Desk(made)
    assert asked.rows("SELECT count(DISTINCT (recorder_id, flight)) AS n FROM frames")[0]["n"] == 120
    for row in asked.rows("FROM line_of_type WHERE solve = 'onboard'"):
        truth = synthesise.SLOPES_M_PER_T[synthesise.TYPES.index(row["aircraft_type"])]
        assert abs(row["slope_m_per_t"] - truth) < 0.03 * truth
    found = asked.rows(
        "SELECT avg(difference_m) AS m, count(difference_m) AS n FROM compared('onboard', 'recalibrated')"
    )[0]
    assert abs(found["m"] - synthesise.SHIFT_M) < 4 * synthesise.SHIFT_SIGMA_M / found["n"] ** 0.5
    assert {r["reason"] for r in asked.rows("FROM failing_flights")} == {
        "synthetic: no marker was found, the picture is dark"
    }
    page = tmp_path / "fleet.html"
    report.write(asked, page, "recalibrated", "onboard", synthesise.is_made(made))
    assert "These flights are synthetic" in page.read_text()
    with pytest.raises(FleetError, match="is synthetic itself"):
        synthesise.make(made, Lake(f"file://{tmp_path / 'twice'}"), 1)


def test_axes_have_round_steps():
    assert charts.ticks(0.03, 0.97) == pytest.approx([0.2, 0.4, 0.6, 0.8])
    assert charts.ticks(5, 5) == [5]


def test_a_bucket_is_read_as_a_directory_is(wingd, recorders, installation, server, tmp_path):
    from .conftest import define, upload

    upload(wingd, recorders, "s3://fleet/asked")
    lake = Lake("s3://fleet/asked")
    define(lake, wingd, installation)
    for flight in lake.flights():
        task.run(lake, "onboard", flight, wingd, tmp_path / "work")
    asked = desk.Desk(lake, cache=tmp_path / "cache")
    assert asked.rows("SELECT count(*) AS n FROM frames")[0]["n"] == 20
    catalog = iceberg.catalogue(lake, f"sqlite:///{tmp_path}/catalogue.db")
    iceberg.update(lake, catalog, "onboard")
    assert catalog.load_table((iceberg.NAMESPACE, "markers")).scan().to_arrow().num_rows == 540
    assert VERSION in lake.keys("tables")[0]


def test_a_rest_catalogue_does_as_well(solved, server):
    """The S3 server's own one; its metadata lie in its own bucket, the data where they are."""
    lake = Lake("s3://fleet/rest")
    for key in solved.keys("tables") + solved.keys("commits"):
        lake.create(key, solved.need(key))
    # pyiceberg reads its settings when it is first imported.
    code = (
        "import sys; from wingd_fleet import iceberg; from wingd_fleet.lake import Lake; lake = Lake(sys.argv[1]);"
        "catalog = iceberg.catalogue(lake, sys.argv[2]);"
        "print([iceberg.update(lake, catalog, solve)['shots'] for solve in ('onboard', 'recalibrated', 'onboard')]);"
        "table = catalog.load_table(('wingd', 'shots')); print(table.scan().to_arrow().num_rows, sorted(table.metadata.refs))"
    )
    url = f"http://127.0.0.1:{server.iceberg}"
    environment = {**os.environ, **server.catalogue("warehouse")}
    done = subprocess.run([sys.executable, "-c", code, lake.url, url], env=environment, capture_output=True, text=True)
    assert done.stdout.splitlines() == ["[2, 2, 0]", "40 ['main', 'onboard', 'recalibrated']"], done.stderr
