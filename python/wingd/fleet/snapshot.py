"""Snapshots: all published rows in a few sorted files, for queries over many flights and for other engines.

A snapshot follows from commits and corrections alone; it may be deleted and written again, and is never the source of
truth.
"""

from __future__ import annotations

import hashlib
import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq

from . import parquet, records
from .lake import VERSION, Damaged, Lake
from .records import sha256
from .state import Published, State, Table, at_once
from .task import Folder

PLACE = f"snapshots/{VERSION}"
# Rows of a file: 100 to 200 MB of markers.
ROWS = 1_000_000
_ID = re.compile(rf"{PLACE}/(\d+-[0-9a-f]{{16}})/manifest\.json")


@dataclass(frozen=True)
class Snapshot:
    """A complete snapshot."""

    id: str
    corrections: int
    commits: dict[str, dict]
    # Table -> solve -> files.
    files: dict[str, dict[str, list[dict]]]

    @classmethod
    def read(cls, lake: Lake, id: str) -> Snapshot:
        """Read a complete snapshot."""
        record = records.read(lake, manifest(id))
        return cls(id, record["corrections"], record["commits"], record["files"])


def manifest(id: str) -> str:
    """Return the key of a snapshot's manifest."""
    return f"{PLACE}/{id}/manifest.json"


def ids(lake: Lake) -> list[str]:
    """Return the complete snapshots, the newest last: the numbers of commits and corrections only grow."""
    return sorted((match[1] for key in lake.keys(PLACE) if (match := _ID.fullmatch(key))), key=_age)


def _age(id: str) -> tuple[int, str]:
    return int(id.split("-")[0]), id


def id_of(state: State) -> str:
    """Return the name of the snapshot of a state."""
    corrections = len(state.corrections.records)
    text = "\n".join([*sorted(state.commits.values()), f"corrections {corrections}"])
    return f"{state.commit_count + corrections}-{sha256(text.encode())[:16]}"


def current(state: State) -> Snapshot | None:
    """Return the snapshot of exactly this state, or None."""
    id = id_of(state)
    return Snapshot.read(state.lake, id) if id in ids(state.lake) else None


def newest(lake: Lake) -> Snapshot | None:
    """Return the newest complete snapshot; None if there is none."""
    known = ids(lake)
    return Snapshot.read(lake, known[-1]) if known else None


def make(lake: Lake, work: Path, prune: bool = False, said: Callable[[str], None] = lambda text: None) -> str:
    """Write the snapshot of the current state and returns its name; existing parts are not written again."""
    state = State(lake)
    id = id_of(state)
    if id not in ids(lake):
        published = state.published()
        files: dict[str, dict[str, list[dict]]] = {}
        with Folder(work) as folder:
            for table in parquet.TABLES:
                for solve in state.solves:
                    own = [one for one in published if one.solve == solve and table in one.tables]
                    if own:
                        files.setdefault(table, {})[solve] = _write(lake, id, table, solve, own, folder)
                        said(f"{table} of {solve}: {len(own)} flights in {len(files[table][solve])} files")
        commits = {one.commit: _unsealed(state.record(one.commit)) for one in published}
        record = {"corrections": len(state.corrections.records), "commits": commits, "files": files}
        lake.settle(manifest(id), records.dump(record))
    if prune:
        remove(lake, [one for one in _all(lake) if _age(one) < _age(id)])
    return id


def _unsealed(record: dict) -> dict:
    return {name: value for name, value in record.items() if name != "seal"}


def _all(lake: Lake) -> list[str]:
    """Return all snapshots, including incomplete ones."""
    return sorted({key.split("/")[2] for key in lake.keys(PLACE)})


def remove(lake: Lake, names: list[str]) -> None:
    """Remove snapshots, the manifest first: a snapshot without a manifest is incomplete."""
    for id in names:
        lake.delete([manifest(id)])
        lake.delete(lake.keys(f"{PLACE}/{id}"))


def _write(lake: Lake, id: str, table: str, solve: str, own: list[Published], folder: Path) -> list[dict]:
    files: list[dict] = []
    types = _types(lake, table, own)
    rows, writer, path = 0, None, folder / "part.parquet"

    def put() -> None:
        nonlocal writer
        writer.close()
        writer = None
        data = path.read_bytes()
        digest = sha256(data)
        key = f"{PLACE}/{id}/{table}/solve={solve}/{len(files):04d}-{digest[:16]}.parquet"
        lake.settle(key, data)
        files.append({"key": key, "sha256": digest, "rows": rows, "columns": parquet.columns(types)})

    for group in _groups(lake, table, own, types):
        if writer is None:
            rows, writer = 0, pq.ParquetWriter(path, types, compression="zstd")
        writer.write_table(group, row_group_size=parquet.ROW_GROUP)
        rows += len(group)
        if rows >= ROWS:
            put()
    if writer is not None:
        put()
    return files


def _types(lake: Lake, table: str, own: list[Published]) -> pa.Schema:
    """Return all columns of the flights, those of the aircraft first."""
    kinds: dict[str, Table] = {}
    for one in own:
        kinds.setdefault(one.tables[table].columns, one.tables[table])
    schemas = [pq.read_schema(pa.BufferReader(bytes_of(lake, kind))) for kind in kinds.values()]
    about = pa.schema([(name, pa.string()) for name in parquet.ABOUT])
    whole = pa.unify_schemas([about, *(schema.remove_metadata() for schema in schemas)])
    return whole.with_metadata({"wingd.schema": VERSION})


def _groups(lake: Lake, table: str, own: list[Published], types: pa.Schema) -> Iterator[pa.Table]:
    """Yield the flights' rows in order, about one row group at a time."""
    waiting: list[pa.Table] = []
    for part in _batches(table, own):
        if part[0].tables[table].rows > parquet.ROW_GROUP:
            if waiting:
                yield pa.concat_tables(waiting)
            waiting = []
            source = pq.ParquetFile(pa.BufferReader(bytes_of(lake, part[0].tables[table])))
            for batch in source.iter_batches(batch_size=parquet.ROW_GROUP):
                yield _conformed(pa.table(batch), part[0], types)
            continue
        waiting += at_once(lambda one: _conformed(parquet.read(bytes_of(lake, one.tables[table])), one, types), part)
        if sum(map(len, waiting)) >= parquet.ROW_GROUP:
            yield pa.concat_tables(waiting)
            waiting = []
    if waiting:
        yield pa.concat_tables(waiting)


def _batches(table: str, own: list[Published]) -> Iterator[list[Published]]:
    """Yield the flights that are read at once: together about one row group, or a single longer flight."""
    part, rows = [], 0
    for one in own:
        length = one.tables[table].rows
        if part and (rows + length > parquet.ROW_GROUP or length > parquet.ROW_GROUP):
            yield part
            part, rows = [], 0
        part.append(one)
        rows += length
    if part:
        yield part


def _conformed(content: pa.Table, one: Published, types: pa.Schema) -> pa.Table:
    columns = []
    for field in types:
        if field.name in parquet.ABOUT:
            columns.append(pa.array([getattr(one.about, field.name)] * len(content), pa.string()))
        elif field.name in content.column_names:
            columns.append(content[field.name])
        else:
            columns.append(pa.nulls(len(content), field.type))
    return pa.Table.from_arrays(columns, schema=types)


def bytes_of(lake: Lake, table: Table) -> bytes:
    """Read a table's bytes and verifies the digest of its commit."""
    data = lake.need(table.key)
    if sha256(data) != table.sha256:
        raise Damaged([f"{lake.url}/{table.key}: is damaged: its digest does not match the commit"])
    return data


def digest_of(path: Path) -> str | None:
    """Return the SHA-256 of a file; None if it does not exist."""
    try:
        with path.open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    except FileNotFoundError:
        return None


def covered(snapshot: Snapshot | None, state: State) -> dict[str, dict]:
    """Return the commits of a snapshot that are still valid."""
    now = set(state.commits.values())
    return {key: record for key, record in (snapshot.commits if snapshot else {}).items() if key in now}
