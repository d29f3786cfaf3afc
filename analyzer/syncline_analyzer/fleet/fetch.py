"""Files of a recording on this machine: local ones where they are, others copied."""

import hashlib
import shutil
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from fsspec.implementations.local import LocalFileSystem

from syncline_analyzer.fleet.identity import content_hash, file_digest
from syncline_analyzer.fleet.recording import File
from syncline_analyzer.fleet.storage import open_url
from syncline_schemas.errors import CaptureError
from syncline_schemas.records import dataclass

_BLOCK_BYTES = 4 << 20


@dataclass(frozen=True, slots=True)
class Fetched:
    """Files that can be opened, in the order in which they were asked for."""

    paths: list[Path]
    content_sha256: str


@contextmanager
def fetched(files: Sequence[File], options: Mapping[str, Any]) -> Iterator[Fetched]:
    """The files, and what they hold, read once; copies are gone afterwards.

    Raises:
        CaptureError: a file cannot be read, or there is no room for the copies.
    """
    with TemporaryDirectory(prefix="syncline-fleet-", ignore_cleanup_errors=True) as name:
        folder = Path(name)
        room = shutil.disk_usage(folder).free
        places, digests = [], []
        for number, file in enumerate(files):
            try:
                path, digest = _fetch(file, folder / str(number), room, options)
            except OSError as error:
                if isinstance(error, CaptureError):
                    raise
                raise CaptureError(f"{file.url}: cannot be read: {_words(error)}") from error
            room -= 0 if path == Path(file.url) else file.size_bytes
            places.append(path)
            digests.append(digest)
        yield Fetched(places, content_hash(digests))


def _fetch(file: File, folder: Path, room: int, options: Mapping[str, Any]) -> tuple[Path, str]:
    fs, path = open_url(file.url, options)
    if isinstance(fs, LocalFileSystem):
        with Path(path).open("rb") as stream:
            return Path(path), file_digest(stream)
    if file.size_bytes > room:
        raise CaptureError(
            f"{file.url}: no room for a copy of {file.size_bytes:,} bytes in {folder.parent};"
            " set TMPDIR to a larger disk"
        )
    folder.mkdir()
    target = folder / path.rsplit("/", 1)[-1]
    digest = hashlib.sha256()
    # Read once, block by block: a capture may be larger than the memory of a worker.
    with (
        fs.open(path, "rb", block_size=_BLOCK_BYTES, cache_type="readahead") as source,
        target.open("wb") as copy,
    ):
        while block := source.read(_BLOCK_BYTES):
            digest.update(block)
            copy.write(block)
    return target, digest.hexdigest()


def _words(error: OSError) -> str:
    return error.strerror or str(error) or type(error).__name__
