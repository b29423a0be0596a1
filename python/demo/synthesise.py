"""Synthetic flights, derived from the tables of real ones, to test how query time grows with the number of flights.

A synthetic flight is a table of a real one with another identity and day, and deflections that follow an invented weight and
load factor. Nothing in it was measured. This is marked in `synthetic.json`, in the names of the aircraft and in the report.
"""

from __future__ import annotations

import datetime

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from wingd.fleet import parquet, records, snapshot, solves
from wingd.fleet.lake import SYNTHETIC, FleetError, Flight, Lake
from wingd.fleet.records import sha256
from wingd.fleet.state import State

SOLVES = ("onboard", "recalibrated")
SEED = 20261125
# Number of aircraft, and their types; each aircraft has one recorder, every tenth a second one.
AIRCRAFT, TYPES = 40, ("SYN-A", "SYN-B")
# Range of take-off weights, t, and the fraction that a flight burns.
WEIGHTS_T, BURNT = (58.0, 78.0), 0.2
# Deflection of the tip, m per t and load factor, by type; how aircraft differ, m; turbulence in load factor.
SLOPES_M_PER_T, AIRCRAFT_SIGMA_M, GUST_SIGMA = (0.030, 0.026), 0.015, 0.04
# Copies of the template's series, to lengthen the flight.
SERIES = 5
# Flights with live results per template that has some.
LIVE_FLIGHTS = 2
# Every n-th flight is dark: its frames fail.
DARK_EVERY = 50
# Shift of the second solve relative to the first and its scatter per frame, m.
SHIFT_M, SHIFT_SIGMA_M = 0.004, 0.001


def make(source: Lake, target: Lake, count: int) -> None:
    """Write `count` flights, each in two solves, with live results if the template has some."""
    if source.is_synthetic():
        raise FleetError(f"{source.url}: is synthetic itself; give a lake of real flights")
    published = State(source).published()
    if not published:
        raise FleetError(f"{source.url}: has no tables to derive flights from")
    own = [one for one in published if one.solve == published[0].solve]
    target.create(SYNTHETIC, records.dump({"synthetic": True, "made_from": sorted(str(one.flight) for one in own)}))
    definitions = {solve: solves.define(target, solve, None, [], "synthetic")["seal"] for solve in SOLVES}
    tables = [{name: parquet.read(snapshot.bytes_of(source, t)) for name, t in one.tables.items()} for one in own]
    for number in range(count):
        _flight(target, tables[number % len(tables)], number, definitions, number < LIVE_FLIGHTS * len(tables))


def _flight(target: Lake, tables: dict[str, pa.Table], number: int, definitions: dict[str, str], live: bool) -> None:
    random = np.random.default_rng([SEED, number])
    craft = number % AIRCRAFT
    second = craft % 10 == 9 and number // AIRCRAFT % 2
    recorder = sha256(f"synthetic recorder {craft} {second}".encode())[:32]
    flight = Flight(recorder, f"f{number // AIRCRAFT + 1:04d}")
    story = _story(tables["shots"], random, craft, number)
    began = tables["shots"]["utc"][0].as_py() + datetime.timedelta(days=story["days"])
    about = {
        "aircraft": f"SYN-{craft:03d}",
        "aircraft_type": TYPES[craft % 2],
        "wing": "right" if second else "left",
        "started": began.strftime("%Y-%m-%dT%H:%M:%SZ"),
    }
    manifest = {"synthetic": True, "recorder": flight.recorder, "flight": flight.flight, "files": [], **about}
    target.create(flight.manifest, records.dump(manifest))
    for stage in ("results", "frames"):
        target.create(flight.mark(stage), records.dump({"stage": stage}))
    for solve, shift in zip(SOLVES, (0.0, SHIFT_M), strict=False):
        published = {}
        for name, content in tables.items():
            if name in parquet.LIVE and (not live or solve != SOLVES[0]):
                continue
            whose = {"solve": solve, "recorder_id": flight.recorder, "flight": flight.flight}
            content = _table(content, name, whose, story, shift, random)
            data = parquet.write(content)
            key = flight.table(name, solve, sha256(data))
            target.create(key, data)
            columns = parquet.columns(content.schema)
            published[name] = {"key": key, "sha256": sha256(data), "rows": len(content), "columns": columns}
        commit = {"solve": solve, "definition": definitions[solve], "manifest": "", "tables": published, **about}
        commit |= {"recorder": flight.recorder, "flight": flight.flight}
        target.create(flight.commit(solve, 1), records.dump(commit))


def _story(shots: pa.Table, random, craft: int, number: int) -> dict:
    """Return the course of a flight: per frame weight, load factor and deflection added to the template's."""
    frames = len(shots) * SERIES
    weight = random.uniform(*WEIGHTS_T) * (1 - BURNT * np.linspace(0, 1, frames))
    factor = 1 + GUST_SIGMA * random.standard_normal(frames)
    own = np.random.default_rng([SEED, 1, craft]).standard_normal() * AIRCRAFT_SIGMA_M
    slope = SLOPES_M_PER_T[craft % 2]
    deflection = own + slope * (weight * factor - WEIGHTS_T[0])
    return {
        "weight": weight,
        "factor": factor,
        "deflection": deflection,
        "frames": frames,
        "days": number // AIRCRAFT,
        "dark": number % DARK_EVERY == DARK_EVERY - 1,
        "turn": random.standard_normal(3) * 0.02,
        "noise": random.standard_normal(frames),
    }


def _table(content: pa.Table, table: str, whose: dict, story: dict, shift: float, random) -> pa.Table:
    if table in parquet.LIVE:
        return _live(content, whose, story)
    one = _numbers(content)
    parts = [_series(content, one, k, story, shift) for k in range(SERIES)]
    content = pa.concat_tables(parts)
    rows = len(content)
    for name, word in whose.items():
        content = _put(content, name, pa.array([word] * rows, pa.string()))
    if table == "parameters":
        turned = pc.equal(content["parameter"], "mount_rotation_deg")
        index = np.asarray(content["index"].fill_null(1)).astype(int)
        turn = story["turn"][np.clip(index, 1, 3) - 1]
        content = _put(content, "value", pc.if_else(turned, pc.add(content["value"], pa.array(turn)), content["value"]))
    if table == "markers":
        scatter = 1 + 0.1 * random.standard_normal(rows)
        for name in ("residual_u_px", "residual_v_px", "w_test"):
            content = _put(content, name, pc.multiply(content[name], pa.array(scatter)))
    return _darkened(content) if story["dark"] else content


def _live(content: pa.Table, whose: dict, story: dict) -> pa.Table:
    """Return live results unchanged, but of another flight on another day."""
    for name, word in whose.items():
        content = _put(content, name, pa.array([word] * len(content), pa.string()))
    days = pa.scalar(int(story["days"] * 24 * 3.6e9), pa.duration("us"))
    return _put(content, "utc", pc.add(content["utc"], days).cast(content["utc"].type))


def _numbers(content: pa.Table) -> np.ndarray:
    """Return the frame index of each row, from 0, in the order of the table."""
    names = [f"{s}/{n}" for s, n in zip(content["series"].to_pylist(), content["shot"].to_pylist(), strict=False)]
    order = {name: k for k, name in enumerate(dict.fromkeys(names))}
    return np.array([order[name] for name in names])


def _series(content: pa.Table, frame: np.ndarray, k: int, story: dict, shift: float) -> pa.Table:
    """Return the template's rows as the k-th part of the flight."""
    place = np.minimum(frame + k * (frame.max(initial=0) + 1), story["frames"] - 1)
    name = [f"s{int(text[1:]) + 100 * k:06d}" for text in content["series"].to_pylist()]
    content = _put(content, "series", pa.array(name, pa.string()))
    key = [f"{series}/{shot}" for series, shot in zip(name, content["shot"].to_pylist(), strict=False)]
    content = _put(content, "result_id", pa.array(key, pa.string()))
    hours = pa.scalar(int((story["days"] * 24 + k * 1.5) * 3.6e9), pa.duration("us"))
    content = _put(content, "utc", pc.add(content["utc"], hours).cast(content["utc"].type))
    # Only 5 % of the template's own deflection is kept, so that the load dominates.
    for column in ("tip_deflection_m", "deflection_m"):
        if column in content.column_names:
            deflection = pa.array(
                story["deflection"][place] + shift + (SHIFT_SIGMA_M if shift else 0) * story["noise"][place]
            )
            content = _put(content, column, pc.add(pc.multiply(content[column], 0.05), deflection))
    content = _put(content, "weight_kg", pa.array(1000 * story["weight"][place]))
    return _put(content, "load_factor", pa.array(story["factor"][place]))


def _darkened(content: pa.Table) -> pa.Table:
    """Turn a table into that of a flight at night: nothing solved."""
    rows = len(content)
    content = _put(content, "status", pa.array(["failed"] * rows, pa.string()))
    content = _put(
        content, "reason", pa.array(["synthetic: no marker was found, the image is dark"] * rows, pa.string())
    )
    for name in ("tip_deflection_m", "tip_sigma_deflection_m", "deflection_m", "value"):
        if name in content.column_names:
            content = _put(content, name, pa.nulls(rows, content[name].type))
    return content


def _put(content: pa.Table, name: str, values) -> pa.Table:
    if name in content.column_names:
        values = values.cast(content[name].type)
        return content.set_column(content.column_names.index(name), name, values)
    return content.append_column(name, values)
