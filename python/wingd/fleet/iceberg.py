"""Iceberg tables over the files of the current snapshot, for engines that need them.

An extra of the package. No data is copied, and the catalogue is never the source of truth.
"""

from __future__ import annotations

import os

import pyarrow.parquet as pq

from . import parquet, snapshot
from .lake import FleetError, Lake
from .state import State

NAMESPACE = "wingd"
# Property of an Iceberg snapshot's summary: id of the wingd snapshot.
STATE = "wingd.snapshot"
# Attempts if another call commits at the same time. pyiceberg's own retries would add the files a second time.
ATTEMPTS = 5
PROPERTIES = {"format-version": "2", "commit.retry.num-retries": "0"}


def catalogue(lake: Lake, uri: str):
    """Open a catalogue.

    `sqlite:///FILE` (or another SQLAlchemy database), or the URL of a REST catalogue, which is configured by the
    variables of pyiceberg: PYICEBERG_CATALOG__FLEET__...
    """
    os.environ.setdefault("AWS_EC2_METADATA_DISABLED", "true")
    try:
        from pyiceberg.catalog import load_catalog
    except ImportError:
        raise FleetError("pyiceberg is not installed; pip install 'wingd[iceberg]'") from None
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
    try:
        return _with_concurrent_creation(lambda: load_catalog("fleet", type=kind, **properties))
    except ModuleNotFoundError as error:
        what = "wingd[iceberg-rest]" if kind == "rest" else "wingd[iceberg]"
        raise FleetError(f"{uri}: {error.name} is not installed; pip install '{what}'") from None


def _with_concurrent_creation(call):
    """Run a call that creates something in the catalogue's database, again if another process created it at that instant."""
    try:
        from sqlalchemy.exc import IntegrityError, OperationalError
    except ImportError:
        return call()
    try:
        return call()
    except (IntegrityError, OperationalError):
        return call()


def update(lake: Lake, catalog) -> dict[str, int]:
    """Set each table to the current snapshot in one transaction; returns the number of files of each updated table.

    Concurrent or repeated calls give the same state.
    """
    from pyiceberg.exceptions import NamespaceAlreadyExistsError

    now = snapshot.current(State(lake))
    if now is None:
        raise FleetError(f"{lake.url}: there is no snapshot of the current state; write one with `wingd-fleet compact`")
    try:
        _with_concurrent_creation(lambda: catalog.create_namespace(NAMESPACE))
    except NamespaceAlreadyExistsError:
        pass
    return {table: _tried(lake, catalog, table, now) for table in parquet.TABLES if table in now.files}


def _tried(lake: Lake, catalog, name: str, now: snapshot.Snapshot) -> int:
    from pyiceberg.exceptions import CommitFailedException, TableAlreadyExistsError

    for attempt in range(ATTEMPTS):
        try:
            return _update(lake, catalog, name, now)
        except (CommitFailedException, TableAlreadyExistsError) as error:
            if attempt == ATTEMPTS - 1:
                raise FleetError(f"table {name}: other calls keep committing: {error}") from error
    raise AssertionError("unreachable")


def _update(lake: Lake, catalog, name: str, now: snapshot.Snapshot) -> int:
    from pyiceberg.expressions import AlwaysTrue

    files = [file for solve in now.files[name].values() for file in solve]
    schemas = {file["columns"]: file["key"] for file in files}
    table = _table(lake, catalog, name, next(iter(schemas.values())))
    last = table.current_snapshot()
    if last is not None and last.summary.additional_properties.get(STATE) == now.id:
        return 0
    with table.transaction() as transaction:
        with transaction.update_schema() as update:
            for key in schemas.values():
                update.union_by_name(_schema(lake, key))
        mapping = transaction.table_metadata.schema().name_mapping.model_dump_json()
        transaction.set_properties({"schema.name-mapping.default": mapping})
        if last is not None:
            transaction.delete(AlwaysTrue())
        paths = [f"{lake.url}/{file['key']}" for file in files]
        transaction.add_files(paths, {STATE: now.id}, check_duplicate_files=False)
    return len(files)


def _schema(lake: Lake, key: str):
    import pyarrow as pa

    return pq.read_schema(pa.BufferReader(lake.need(key))).remove_metadata()


def _table(lake: Lake, catalog, name: str, key: str):
    from pyiceberg.exceptions import NoSuchTableError

    try:
        return catalog.load_table((NAMESPACE, name))
    except NoSuchTableError:
        # A REST catalogue chooses the location of its metadata.
        place = None if catalog.properties.get("type") == "rest" else f"{lake.url}/iceberg/{name}"
        how = {"schema": _schema(lake, key), "location": place, "properties": PROPERTIES}
        return catalog.create_table((NAMESPACE, name), **how)
