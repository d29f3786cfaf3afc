"""A data set in an object store: an S3 server on loopback."""

import logging
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("moto")
pytest.importorskip("s3fs")

import s3fs
from click.testing import CliRunner
from moto.server import ThreadedMotoServer

from syncline_analyzer.fleet.dataset import Dataset
from syncline_analyzer.fleet.storage import open_storage
from syncline_analyzer.fleet_command import fleet
from syncline_analyzer.fleet_options import storage_options
from syncline_samples.fleet import Planted
from syncline_schemas.errors import UsageError
from tests.analyzer.fleet.fleet_builder import analyze, capture, content, small_mcap, statuses


@pytest.fixture
def options(monkeypatch: pytest.MonkeyPatch) -> Iterator[dict[str, Any]]:
    """Options of a file system on an S3 server that has the buckets `line` and `fleet`."""
    logging.getLogger("werkzeug").setLevel(logging.ERROR)
    server = ThreadedMotoServer(ip_address="127.0.0.1", port=0)
    server.start()
    host, port = server.get_host_and_port()
    monkeypatch.setenv("AWS_DEFAULT_REGION", "us-east-1")
    found = {
        "key": "test",
        "secret": "test",
        "client_kwargs": {"endpoint_url": f"http://{host}:{port}"},
    }
    fs = s3fs.S3FileSystem(**found)
    for bucket in ("line", "fleet"):
        fs.mkdir(bucket)
    yield found
    # What the server holds outlives it in its process.
    for bucket in ("line", "fleet"):
        fs.rm(bucket, recursive=True)
    server.stop()


def put(folder: Path, options: dict[str, Any]) -> None:
    """Put all captures of a folder into the bucket `line`."""
    fs = s3fs.S3FileSystem(**options)
    for path in sorted(folder.rglob("*.*")):
        fs.put_file(str(path), f"line/{path.relative_to(folder).as_posix()}")


def tables(files: dict[str, str]) -> dict[str, str]:
    """What a data set holds, but for the rows that tell where its sources are."""
    return {name: text for name, text in files.items() if not name.endswith("captures.parquet")}


def test_a_store_holds_what_a_folder_holds(tmp_path: Path, options: dict[str, Any]) -> None:
    source = tmp_path / "in"
    capture(source, 0, 0, Planted(emcys=1))
    capture(source, 1, 0)
    put(source, options)
    analyze(source, tmp_path / "out")
    done = analyze("s3://line/**", "s3://fleet/a", options=options)
    assert statuses(done) == ["analyzed"] * 2
    stored = content("s3://fleet/a", options)
    local = content(tmp_path / "out")
    assert stored.keys() == local.keys()
    assert tables(stored) == tables(local)
    entries = Dataset.open("s3://fleet/a", options).captures
    assert entries[0].files[0].url.startswith("s3://line/machine-000/")
    assert analyze("s3://line", "s3://fleet/a", options=options) == []
    # The same content, written anew: its ETag says so, and nothing is read.
    put(source, options)
    assert analyze("s3://line", "s3://fleet/a", options=options) == []
    small_mcap(tmp_path / "more" / "machine-001" / "b.mcap", recording_id="more")
    (tmp_path / "more" / "machine-001" / "c.mcap").write_bytes(b"broken")
    put(tmp_path / "more", options)
    done = analyze("s3://line", "s3://fleet/a", options=options)
    assert statuses(done) == ["analyzed", "failed"]
    (failure,) = Dataset.open("s3://fleet/a", options).failures
    assert failure.reason.startswith("s3://line/machine-001/c.mcap: no known format")


def test_in_a_store_the_row_of_a_capture_comes_last_and_goes_first(
    tmp_path: Path, options: dict[str, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    events: list[str] = []
    # fsspec gives the same file system to all of a process.
    fs = open_storage("s3://fleet/b", options).fs

    def noted(name: str) -> None:
        real = getattr(fs, name)

        def call(*args: Any, **kwargs: Any) -> Any:
            path = args[1] if name == "put_file" else args[0]
            events.append(f"{name} {str(path).rsplit('/', 1)[-1]}")
            return real(*args, **kwargs)

        monkeypatch.setattr(fs, name, call)

    path = small_mcap(tmp_path / "in" / "press" / "a.mcap", recording_id="one")
    analyze(tmp_path / "in", "s3://fleet/b", options=options)
    small_mcap(path, recording_id="one", frames=99)
    for name in ("pipe_file", "put_file", "rm_file"):
        noted(name)
    analyze(tmp_path / "in", "s3://fleet/b", options=options)
    assert events[0] == "rm_file captures.parquet"
    assert events[-1] == "put_file captures.parquet"
    written = [event for event in events if event.startswith("put_file")]
    assert "put_file nodes.parquet" in written
    assert events.index(written[0]) > events.index("rm_file nodes.parquet")


def test_a_store_that_cannot_be_opened_is_said(tmp_path: Path) -> None:
    small_mcap(tmp_path / "a.mcap")
    result = CliRunner().invoke(fleet, ["analyze", str(tmp_path), "--out", "nosuch://x"])
    assert isinstance(result.exception, UsageError)
    assert "nosuch" in str(result.exception)
    with pytest.raises(UsageError, match="write it as KEY=VALUE"):
        storage_options(("anon",))
