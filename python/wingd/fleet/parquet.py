"""Tables: their columns, and the conversion of an export of `wingd` to a table."""

from __future__ import annotations

import io
import json
import re
from functools import cache
from importlib import resources
from pathlib import Path

import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

from .lake import VERSION, FleetError
from .records import sha256

# Exported unchanged; `live` is split into three tables.
EXPORTED = ("shots", "markers", "parameters", "span")
LIVE = ("live", "live_markers", "live_span")
SHAPE = "shape"
TABLES = (*EXPORTED, SHAPE, *LIVE)
# Aircraft and wing: not in a flight's tables, because they may be corrected; in snapshots and query results.
ABOUT = ("aircraft", "aircraft_type", "wing")
# Columns that identify a row.
REQUIRED = ("recorder_id", "flight")
# Rows of a row group, which is the part of a table in memory while a snapshot is written.
ROW_GROUP = 32 * 1024
# Live results converted at once: 40,000 rows for 40 stations.
RESULTS = 1024
_TYPES = {
    "string": pa.string(),
    "int64": pa.int64(),
    "double": pa.float64(),
    "float": pa.float32(),
    "bool": pa.bool_(),
    "timestamp[us, tz=UTC]": pa.timestamp("us", "UTC"),
    "list<element: float>": pa.list_(pa.field("element", pa.float32())),
}


@cache
def schema(table: str) -> dict[str, str]:
    """Return column -> type of this version: every file has these columns, newer files may have more."""
    text = resources.files(__package__).joinpath(f"schema/{VERSION}.json").read_text()
    return json.loads(text)[table]


def completed(content: pa.Table, table: str, solve: str) -> pa.Table:
    """Return an export with the columns of this version, in order, missing ones as null, further ones at the end."""
    if missing := [name for name in REQUIRED if name not in content.column_names]:
        raise FleetError(f"table {table}: lacks {', '.join(missing)}; use a wingd that matches {VERSION}")
    rows, columns = len(content), {}
    for name, kind in schema(table).items():
        if name == "solve":
            columns[name] = pa.array([solve] * rows, pa.string())
        elif name not in content.column_names:
            columns[name] = pa.nulls(rows, _TYPES[kind])
        elif str(content.schema.field(name).type) != kind:
            have = content.schema.field(name).type
            raise FleetError(
                f"table {table}: column {name} is {have}, not {kind} as in {VERSION}; use a matching wingd"
            )
        else:
            columns[name] = content[name]
    more = [name for name in content.column_names if name not in columns and name not in ABOUT]
    whole = pa.table({**columns, **{name: content[name] for name in more}})
    return whole.replace_schema_metadata({**(content.schema.metadata or {}), b"wingd.schema": VERSION.encode()})


def weighed(content: pa.Table, shots: pa.Table, table: str) -> pa.Table:
    """Add the aircraft data of each shot to a table of frames."""
    data = [name for name in schema("shots") if name in schema(table) and name not in content.column_names]
    data = [name for name in data if name in shots.column_names]
    if not data or not len(content):
        return content
    place = {key: k for k, key in enumerate(zip(shots["series"].to_pylist(), shots["shot"].to_pylist(), strict=False))}
    rows = zip(content["series"].to_pylist(), content["shot"].to_pylist(), strict=False)
    index = pa.array([place.get(key) for key in rows], pa.int64())
    for name in data:
        content = content.append_column(name, pc.take(shots[name], index))
    return content


def live(export: Path, solve: str) -> dict[str, Path]:
    """Split an export of live results, with a column for each marker and station, into three tables next to it: a row per result, per marker and per station.

    Converts some thousand results at once.
    """
    writers: dict[str, pq.ParquetWriter] = {}
    paths = {name: export.with_name(f"{name}.parquet") for name in LIVE}
    source = export.with_name("export-of-live.parquet")
    export.rename(source)
    try:
        for batch in pq.ParquetFile(source).iter_batches(batch_size=RESULTS):
            for name, content in live_rows(pa.table(batch)).items():
                if len(content):
                    whole = completed(content, name, solve)
                    if name not in writers:
                        writers[name] = pq.ParquetWriter(paths[name], whole.schema, compression="zstd")
                    writers[name].write_table(whole, row_group_size=ROW_GROUP)
    finally:
        for writer in writers.values():
            writer.close()
    return {name: paths[name] for name in writers}


def live_rows(content: pa.Table) -> dict[str, pa.Table]:
    """Return the three tables of a batch of results.

    Stations have numbered names and an arc length column (`deflection_s01_m`, `arc_length_s01_m`); before
    schema_version 2 the name was the arc length (`deflection_31.5_m`).
    """
    # Column names of torsion pairs as in v3.
    pair = re.compile(r"torsion_(.+)_((?:sigma_)?(?:angle|twist))_deg")
    content = content.rename_columns([pair.sub(r"\2_\1_deg", name) for name in content.column_names])
    names = content.column_names
    found = {}
    for table, label in (("live_markers", r"u_(.+)_px"), ("live_span", r"span_(.+)_m")):
        labels = [match[1] for name in names if (match := re.fullmatch(label, name))]
        found[table] = _rows(content, labels, table)
        names = [name for name in names if _part(name, labels) is None]
    whole = content.select(names)
    if "status" not in names and "solved" in names:
        whole = whole.append_column("status", pc.if_else(pc.equal(whole["solved"], 1), "ok", "failed"))
    return {"live": whole, **found}


def _part(name: str, labels: list[str]) -> tuple[str, str] | None:
    """`sigma_deflection_M01_m` -> (`sigma_deflection_m`, `M01`)."""
    for label in labels:
        match = re.fullmatch(rf"(.+)_{re.escape(label)}((?:_[a-z]+)?)", name)
        if match:
            return match[1] + match[2], label
    return None


def _rows(content: pa.Table, labels: list[str], table: str) -> pa.Table:
    data = [name for name in schema("live") if name in schema(table)]
    once = [name for name in data if name in content.column_names]
    parts = []
    for label in labels:
        own = {name: part[0] for name in content.column_names if (part := _part(name, [label]))}
        one = content.select([*once, *own]).rename_columns([*once, *own.values()])
        if table == "live_markers":
            one = one.append_column("marker", pa.array([label] * len(one), pa.string()))
            if "used" in one.column_names:
                one = one.set_column(one.column_names.index("used"), "used", one["used"].cast(pa.bool_()))
        elif "arc_length_m" in one.column_names:
            # Installations with fewer stations have null here.
            one = one.filter(pc.is_valid(one["arc_length_m"]))
        else:
            one = one.append_column("arc_length_m", pa.array([float(label)] * len(one), pa.float64()))
        parts.append(one)
    if not parts:
        return content.select(once).slice(0, 0)
    label = "marker" if table == "live_markers" else "arc_length_m"
    order = [("utc", "ascending"), ("number", "ascending"), (label, "ascending")]
    return pa.concat_tables(parts, promote_options="default").sort_by(
        [key for key in order if key[0] in parts[0].column_names]
    )


def write(content: pa.Table) -> bytes:
    """Return Parquet bytes that depend on the content alone."""
    output = io.BytesIO()
    pq.write_table(content, output, compression="zstd", row_group_size=ROW_GROUP)
    return output.getvalue()


def facts(data: bytes) -> dict:
    """Return the number of rows and the columns digest of a file."""
    head = pq.read_metadata(io.BytesIO(data))
    return {"rows": head.num_rows, "columns": columns(head.schema.to_arrow_schema())}


def read(data: bytes) -> pa.Table:
    """Read a table from its bytes."""
    return pq.read_table(io.BytesIO(data), use_threads=False)


def columns(content: pa.Schema) -> str:
    """Return a digest of column names and types: files with the same digest can be read together."""
    return sha256("\n".join(f"{field.name} {field.type}" for field in content).encode())[:16]
