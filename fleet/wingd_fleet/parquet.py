"""The tables: what their columns are, and how an export of `wingd` becomes one of them."""

from __future__ import annotations

import io
import json
import re
from functools import lru_cache
from importlib import resources
from pathlib import Path

import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

from .lake import VERSION, FleetError
from .records import sha256

# Exported as they are; `live` becomes three.
EXPORTED = ("shots", "markers", "parameters", "span")
LIVE = ("live", "live_markers", "live_span")
TABLES = (*EXPORTED, *LIVE)
# Whose wing it is: not in a flight's tables, for it may be corrected; in snapshots and answers.
ABOUT = ("aircraft", "aircraft_type", "wing")
# Without them a row says nothing.
REQUIRED = ("recorder_id", "flight")
# Rows of a row group: what is in memory of a table while a snapshot is written.
ROW_GROUP = 32 * 1024
# Live results taken at a time: of 40 stations 40,000 rows.
RESULTS = 1024
_TYPES = {
    "string": pa.string(),
    "int64": pa.int64(),
    "double": pa.float64(),
    "float": pa.float32(),
    "bool": pa.bool_(),
    "timestamp[us, tz=UTC]": pa.timestamp("us", "UTC"),
}


@lru_cache(maxsize=None)
def schema(table: str) -> dict[str, str]:
    """Column -> type, of this version: every file has them, newer ones may have more."""
    text = resources.files(__package__).joinpath(f"schema/{VERSION}.json").read_text()
    return json.loads(text)[table]


def completed(content: pa.Table, table: str, solve: str) -> pa.Table:
    """An export with the columns of this version, in their order, what it lacks as null; further ones after them."""
    if missing := [name for name in REQUIRED if name not in content.column_names]:
        raise FleetError(f"table {table}: lacks {', '.join(missing)}; use a wingd that fits {VERSION}")
    rows, columns = len(content), {}
    for name, kind in schema(table).items():
        if name == "solve":
            columns[name] = pa.array([solve] * rows, pa.string())
        elif name not in content.column_names:
            columns[name] = pa.nulls(rows, _TYPES[kind])
        elif str(content.schema.field(name).type) != kind:
            have = content.schema.field(name).type
            raise FleetError(
                f"table {table}: column {name} is {have}, not {kind} as in {VERSION}; use a wingd that fits"
            )
        else:
            columns[name] = content[name]
    more = [name for name in content.column_names if name not in columns and name not in ABOUT]
    whole = pa.table({**columns, **{name: content[name] for name in more}})
    return whole.replace_schema_metadata({**(content.schema.metadata or {}), b"wingd.schema": VERSION.encode()})


def weighed(content: pa.Table, shots: pa.Table, table: str) -> pa.Table:
    """A frame's table with the aircraft's data of its shot."""
    data = [name for name in schema("shots") if name in schema(table) and name not in content.column_names]
    data = [name for name in data if name in shots.column_names]
    if not data or not len(content):
        return content
    place = {key: k for k, key in enumerate(zip(shots["series"].to_pylist(), shots["shot"].to_pylist()))}
    rows = zip(content["series"].to_pylist(), content["shot"].to_pylist())
    index = pa.array([place.get(key) for key in rows], pa.int64())
    for name in data:
        content = content.append_column(name, pc.take(shots[name], index))
    return content


def live(export: Path, solve: str) -> dict[str, Path]:
    """Live results, whose export has a column for each marker and station of its installation, as three tables beside it: a row
    per result, per marker, per station of the span. Some thousand results at a time."""
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
    """The three tables of so many results. Stations have round names and their arc length beside them (`deflection_s01_m`,
    `arc_length_s01_m`), in exports of programs before schema_version 2 their arc length as a name (`deflection_31.5_m`)."""
    # Torsion pairs are named as fleets have them since v3 began.
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
            # Rows of an installation with fewer stations have none here.
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
    """As bytes that follow from the content alone."""
    output = io.BytesIO()
    pq.write_table(content, output, compression="zstd", row_group_size=ROW_GROUP)
    return output.getvalue()


def facts(data: bytes) -> dict:
    """Rows and columns of a file."""
    head = pq.read_metadata(io.BytesIO(data))
    return {"rows": head.num_rows, "columns": columns(head.schema.to_arrow_schema())}


def read(data: bytes) -> pa.Table:
    return pq.read_table(io.BytesIO(data), use_threads=False)


def columns(content: pa.Schema) -> str:
    """Names and types as a digest: files of one can be read together."""
    return sha256("\n".join(f"{field.name} {field.type}" for field in content).encode())[:16]
