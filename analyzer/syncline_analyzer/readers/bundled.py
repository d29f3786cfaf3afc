"""The capture within an evidence bundle: that one file is unpacked beside, and nothing else."""

import shutil
import tempfile
import weakref
from collections.abc import Callable, Iterator
from pathlib import Path

from syncline_analyzer.bundle.archive import unpack_capture
from syncline_analyzer.capture import CaptureReader
from syncline_schemas.batch import FrameBatch, Gap


class BundledReader:
    """A capture within a bundle; the unpacked copy goes when the reader does.

    Raises:
        CaptureError: the file is no bundle, or its capture is not what its manifest says.
    """

    def __init__(self, path: Path, opened: Callable[[Path], CaptureReader]) -> None:
        folder = Path(tempfile.mkdtemp(prefix="syncline-"))
        self._remove = weakref.finalize(self, shutil.rmtree, folder, ignore_errors=True)
        copy = folder / "capture"
        unpack_capture(path, copy)
        self._reader = opened(copy)
        self.facts = self._reader.facts
        self.facts.path = path

    def batches(self) -> Iterator[FrameBatch | Gap]:
        """Batches in file order, with a Gap between them where the recorder was blind."""
        yield from self._reader.batches()
