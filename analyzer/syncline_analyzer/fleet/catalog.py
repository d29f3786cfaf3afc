"""The recordings of all machines in one Rerun catalog, reachable from this machine only."""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING

from syncline_analyzer.fleet.captures import CaptureEntry
from syncline_analyzer.fleet.dataset import Dataset
from syncline_analyzer.fleet.layout import recording_file
from syncline_analyzer.fleet.scope import EVERYTHING, Scope
from syncline_analyzer.fleet.storage import Storage
from syncline_analyzer.viewer import LOOPBACK
from syncline_schemas.errors import UsageError
from syncline_schemas.records import dataclass

if TYPE_CHECKING:
    from rerun.catalog import DatasetEntry

NAME = "fleet"
"""Of the data set in the catalog."""
_TABLE_BLUEPRINT, _LAYOUT = "captures.rbl", "capture.rbl"


@dataclass(frozen=True, slots=True)
class Catalog:
    """A catalog that is served.

    Attributes:
        url: of the server, for `rerun.catalog.CatalogClient`.
        table_url: of the table of all captures, for the viewer.
        captures: how many there are.
        unread: ids of those whose recording cannot be read.
    """

    url: str
    table_url: str
    captures: int
    unread: Sequence[str]


def recorded(data: Dataset, scope: Scope = EVERYTHING) -> list[CaptureEntry]:
    """The captures that have a recording, the latest first."""
    found = [entry for entry in scope.of_these(data.captures) if entry.values.get("recording")]
    return sorted(found, key=lambda each: each.values["start_utc_ns"] or 0, reverse=True)


@contextmanager
def recordings(storage: Storage, captures: Sequence[CaptureEntry]) -> Iterator[dict[str, Path]]:
    """Files of the recordings by capture id; those of an object store are copied here meanwhile.

    What is gone by now is left out.
    """
    relative = {
        entry.partition.capture_id: recording_file(entry.partition.capture_id) for entry in captures
    }
    if storage.local:
        files = {name: storage.folder(path) for name, path in relative.items()}
        yield {name: path for name, path in files.items() if path.is_file()}
        return
    with TemporaryDirectory(prefix="syncline-fleet-", ignore_cleanup_errors=True) as folder:
        files = {}
        for name, path in relative.items():
            copy = Path(folder, f"{name}.rrd")
            try:
                storage.fs.get_file(storage.path(path), str(copy))
            except FileNotFoundError:
                continue
            files[name] = copy
        yield files


@contextmanager
def served(files: Mapping[str, Path], port: int | None = None) -> Iterator[Catalog]:
    """Serve recordings as long as the context lasts, with one layout for all of them.

    Args:
        files: recordings by capture id, which is their recording id.
        port: of this machine; by default a free one.

    Raises:
        UsageError: the port is taken.
    """
    from rerun.server import Server

    paths = list(files.values())
    try:
        server = Server(host=LOOPBACK, port=port, datasets={NAME: paths})
    except ValueError as error:
        raise UsageError(f"--port {port}: {str(error).partition(chr(10))[0]}") from error
    with server, TemporaryDirectory(prefix="syncline-catalog-") as folder:
        dataset = server.client().get_dataset(NAME)
        _give_layouts(dataset, Path(folder))
        known = set(dataset.segment_ids())
        yield Catalog(
            server.url(),
            f"{server.url()}/entry/{dataset.id}",
            len(known),
            sorted(set(files) - known),
        )


def _give_layouts(dataset: "DatasetEntry", folder: Path) -> None:
    """Register the layout of all captures and that of their table; the server reads the files."""
    from syncline_analyzer.views.fleet_catalog import capture_layout, table_blueprint

    entities = {column.entity_path for column in dataset.schema().component_columns()}
    layout, table = folder / _LAYOUT, folder / _TABLE_BLUEPRINT
    capture_layout(entities).save(NAME, layout)
    table_blueprint().save(NAME, table)
    dataset.register_blueprint(layout.as_uri())
    dataset.register_blueprint(table.as_uri(), segment_table=True)
