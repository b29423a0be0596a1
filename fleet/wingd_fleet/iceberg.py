"""Iceberg tables over the files of the current snapshot, for engines that want them: derived, and derived anew. An extra of the
package. No byte of data is copied, nothing is believed because a catalogue says it."""

from __future__ import annotations

import os

import pyarrow.parquet as pq

from . import parquet, snapshot
from .lake import FleetError, Lake
from .state import State

NAMESPACE = "wingd"
# In an Iceberg snapshot's summary: which of our snapshots it is.
STATE = "wingd.snapshot"
# Attempts where another call commits at the same time. pyiceberg's own repeats add the files to what the other one added.
ATTEMPTS = 5
PROPERTIES = {"format-version": "2", "commit.retry.num-retries": "0"}


def catalogue(lake: Lake, uri: str):
    """`sqlite:///FILE` (or another database of SQLAlchemy's), or the URL of a REST catalogue, whose further settings are
    pyiceberg's own: PYICEBERG_CATALOG__FLEET__..."""
    os.environ.setdefault("AWS_EC2_METADATA_DISABLED", "true")
    try:
        from pyiceberg.catalog import load_catalog
    except ImportError:
        raise FleetError("pyiceberg is not installed; pip install 'wingd-fleet[iceberg]'") from None
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
        return _beside_others(lambda: load_catalog("fleet", type=kind, **properties))
    except ModuleNotFoundError as error:
        what = "wingd-fleet[iceberg-rest]" if kind == "rest" else "wingd-fleet[iceberg]"
        raise FleetError(f"{uri}: {error.name} is not installed; pip install '{what}'") from None


def _beside_others(call):
    """A call that makes something in the catalogue's database where it is missing; another process may make it at the same
    instant, and then it is there the second time."""
    try:
        from sqlalchemy.exc import IntegrityError, OperationalError
    except ImportError:
        return call()
    try:
        return call()
    except (IntegrityError, OperationalError):
        return call()


def update(lake: Lake, catalog) -> dict[str, int]:
    """Makes each table the current snapshot, in one transaction; the files of each that is new. Called twice at once, or killed
    and called again, it ends the same."""
    from pyiceberg.exceptions import NamespaceAlreadyExistsError

    now = snapshot.current(State(lake))
    if now is None:
        raise FleetError(
            f"{lake.url}: there is no snapshot of what is published now; make one with `wingd-fleet compact`"
        )
    try:
        _beside_others(lambda: catalog.create_namespace(NAMESPACE))
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
                raise FleetError(f"table {name}: other calls commit all the time: {error}") from error
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
        # A REST catalogue has places of its own for its metadata.
        place = None if catalog.properties.get("type") == "rest" else f"{lake.url}/iceberg/{name}"
        how = {"schema": _schema(lake, key), "location": place, "properties": PROPERTIES}
        return catalog.create_table((NAMESPACE, name), **how)
