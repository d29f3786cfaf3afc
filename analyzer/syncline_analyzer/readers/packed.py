"""Packed captures of formats that are read through their index: unpacked beside first."""

import shutil
import tempfile
import weakref
from collections.abc import Callable, Iterator
from pathlib import Path

from syncline_analyzer.capture import CaptureReader
from syncline_analyzer.readers.source import BLOCK_BYTES, CaptureSource
from syncline_schemas.batch import FrameBatch, Gap
from syncline_schemas.errors import CaptureError


class PackedReader:
    """A capture within .gz or .zst; the unpacked copy goes when the reader does."""

    def __init__(self, path: Path, opened: Callable[[Path], CaptureReader]) -> None:
        folder = Path(tempfile.mkdtemp(prefix="syncline-"))
        self._remove = weakref.finalize(self, shutil.rmtree, folder, ignore_errors=True)
        copy = folder / "capture"
        self._damage = _unpack(path, copy)
        self._reader = opened(copy)
        self.facts = self._reader.facts
        self.facts.path = path

    def batches(self) -> Iterator[FrameBatch | Gap]:
        """Batches in file order, with a Gap between them where the recorder was blind."""
        yield from self._reader.batches()
        if self._damage:
            self.facts.damage = "; ".join(filter(None, (self._damage, self.facts.damage)))


def _unpack(path: Path, copy: Path) -> str | None:
    """Write the unpacked bytes; what the packing lost, in words."""
    source = CaptureSource(path)
    try:
        with copy.open("wb") as out:
            while block := source.read(BLOCK_BYTES):
                out.write(block)
    except OSError as error:
        raise CaptureError(f"{path}: cannot be unpacked: {error.strerror or error}") from error
    finally:
        source.close()
    return source.damage
