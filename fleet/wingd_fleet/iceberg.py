"""Iceberg tables over the committed Parquet files: one snapshot and one tag per solve. No byte is copied."""

from __future__ import annotations

import io
import os

import pyarrow.parquet as pq
from pyiceberg.catalog import Catalog, load_catalog
from pyiceberg.exceptions import NamespaceAlreadyExistsError, NoSuchTableError, ValidationError
from pyiceberg.table import Table
from pyiceberg.transforms import IdentityTransform

from .lake import TABLES, FleetError, Flight, Lake

NAMESPACE = "wingd"
PARTITIONS = ("solve", "aircraft", "recorder_id", "flight")
# A snapshot's own note of what it is.
SOLVE = "wingd.solve"


def catalogue(lake: Lake, uri: str) -> Catalog:
    """`sqlite:///FILE` (or another database of SQLAlchemy's), or the URL of a REST catalogue, whose further settings are
    pyiceberg's own: PYICEBERG_CATALOG__FLEET__..."""
    kind = "rest" if uri.startswith(("http://", "https://")) else "sql"
    properties = {"uri": uri} if kind == "rest" else {"uri": uri, "warehouse": f"{lake.url}/iceberg"}
    for name, variable in {
        "s3.endpoint": "AWS_ENDPOINT_URL",
        "s3.region": "AWS_REGION",
        "s3.access-key-id": "AWS_ACCESS_KEY_ID",
        "s3.secret-access-key": "AWS_SECRET_ACCESS_KEY",
        "s3.session-token": "AWS_SESSION_TOKEN",
    }.items():
        if os.environ.get(variable):
            properties[name] = os.environ[variable]
    return load_catalog("fleet", type=kind, **properties)


def update(lake: Lake, catalog: Catalog, solve: str) -> dict[str, int]:
    """Brings the tables up to a solve's commits; how many files each got. Nothing new: no snapshot."""
    flights = lake.committed(solve).get(solve, [])
    if not flights:
        raise FleetError(f"{lake.url}: no flight of solve {solve} is committed; run it first")
    try:
        catalog.create_namespace(NAMESPACE)
    except NamespaceAlreadyExistsError:
        pass
    return {table: _update(lake, catalog, table, solve, flights) for table in TABLES}


def _update(lake: Lake, catalog: Catalog, name: str, solve: str, flights: list[Flight]) -> int:
    table = _table(lake, catalog, name, flights[0].table(name, solve))
    known = {row["file_path"] for row in table.inspect.files().select(["file_path"]).to_pylist()}
    keys = [flight.table(name, solve) for flight in flights]
    heads = {key: pq.read_metadata(io.BytesIO(lake.need(key))) for key in keys if f"{lake.url}/{key}" not in known}
    # A file without rows belongs to no partition.
    new = [key for key, head in heads.items() if head.num_rows]
    if not new:
        return 0
    _widen(table, [heads[key].schema.to_arrow_schema() for key in new])
    table.add_files([f"{lake.url}/{key}" for key in new], {SOLVE: solve}, check_duplicate_files=False)
    snapshot = table.current_snapshot().snapshot_id
    if solve in table.metadata.refs:
        table.manage_snapshots().remove_tag(solve).commit()
    table.manage_snapshots().create_tag(snapshot, solve).commit()
    return len(new)


def _table(lake: Lake, catalog: Catalog, name: str, key: str) -> Table:
    try:
        return catalog.load_table((NAMESPACE, name))
    except NoSuchTableError:
        pass
    # A REST catalogue has places of its own for its metadata.
    place = None if catalog.properties.get("type") == "rest" else f"{lake.url}/iceberg/{name}"
    table = catalog.create_table(
        (NAMESPACE, name),
        schema=pq.read_schema(io.BytesIO(lake.need(key))).remove_metadata(),
        location=place,
        properties={"format-version": "2"},
    )
    with table.update_spec() as spec:
        for column in PARTITIONS:
            spec.add_field(column, IdentityTransform(), column)
    return catalog.load_table((NAMESPACE, name))


def _widen(table: Table, schemas: list) -> None:
    """Columns that newer files have more; a changed type is a fault."""
    seen = set()
    for schema in schemas:
        if tuple(schema.names) in seen:
            continue
        seen.add(tuple(schema.names))
        try:
            with table.update_schema() as update:
                update.union_by_name(schema.remove_metadata())
        except (ValidationError, ValueError, TypeError) as error:
            raise FleetError(f"table {table.name()[-1]}: a file's columns do not go with it: {error}") from error
    _map(table)


def _map(table: Table) -> None:
    """Names for columns that came since the first files were added: these have no ids of their own."""
    key = "schema.name-mapping.default"
    mapping = table.schema().name_mapping.model_dump_json()
    if table.properties.get(key) != mapping:
        with table.transaction() as transaction:
            transaction.set_properties({key: mapping})
