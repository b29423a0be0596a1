"""The exported tables, with whose they are, and what their columns have to be."""

from __future__ import annotations

import io
import json
from importlib import resources
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq

from .lake import VERSION, FleetError

# Columns in front of the export's own.
IDENTITY = ("solve", "aircraft", "aircraft_type")


def schema(table: str) -> dict[str, str]:
    """Column -> type, of this version: every file has them, newer ones may have more."""
    text = resources.files(__package__).joinpath(f"schema/{VERSION}.json").read_text()
    return json.loads(text)[table]


def identified(file: Path, table: str, identity: dict[str, str | None]) -> tuple[bytes, dict]:
    """An exported table with its identity in front, as bytes that follow from its content alone; its facts."""
    content = pq.read_table(file)
    for place, name in enumerate(IDENTITY):
        values = pa.array([identity[name]] * len(content), pa.string())
        content = content.add_column(place, pa.field(name, pa.string()), values)
    check(content.schema, table)
    data = write(content)
    return data, facts(data)


def write(content: pa.Table) -> bytes:
    output = io.BytesIO()
    pq.write_table(content, output, compression="zstd", row_group_size=64 * 1024)
    return output.getvalue()


def check(found: pa.Schema, table: str) -> None:
    """A column of this version that is missing or of another type is a fault; further columns are none."""
    types = {field.name: str(field.type) for field in found}
    for name, kind in schema(table).items():
        if types.get(name) != kind:
            have = types.get(name, "missing")
            raise FleetError(
                f"table {table}: column {name} is {have}, not {kind} as in {VERSION}; use a wingd that fits"
            )


def facts(data: bytes) -> dict:
    """What two files of one flight and solve have in common to the last bit: rows, columns, inputs."""
    head = pq.read_metadata(io.BytesIO(data))
    notes = {k.decode(): v.decode() for k, v in (head.metadata or {}).items() if k.startswith(b"inputs ")}
    return {"rows": head.num_rows, "columns": head.schema.names, "inputs": notes}
