"""Recordings in steps of virtual time, on a disk that refuses when it is told to."""

import errno
import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from syncline_logger.capture_store import CaptureStore
from syncline_logger.disk import Disk, DiskFile
from syncline_logger.record_options import RecordOptions
from syncline_logger.recording import Recording, RecordResult
from syncline_schemas.batch import FrameBatch, Gap
from syncline_schemas.capture.layout import BusInfo
from syncline_schemas.capture.scan import CaptureScan

T0 = 1_760_000_000_000_000_000
MS = 1_000_000
S = 1_000 * MS

Refusal = Callable[[str, Path], int]
"""Error number for an operation on a path: "create", "write", "sync", "truncate", "close",
"replace", "remove", "text"; 0 lets it pass."""


class FailingFile(DiskFile):
    """A file whose operations fail when the disk says so; a failed write leaves half of it."""

    def __init__(self, path: Path, refuse: Callable[[str, Path], None]) -> None:
        super().__init__(path)
        self._path = path
        self._refuse = refuse

    def write(self, data: bytes | bytearray, /) -> int:
        try:
            self._refuse("write", self._path)
        except OSError:
            super().write(bytes(data[: len(data) // 2]))
            raise
        return super().write(data)

    def sync(self) -> None:
        self._refuse("sync", self._path)
        super().sync()

    def truncate(self, size: int) -> None:
        self._refuse("truncate", self._path)
        super().truncate(size)

    def close(self) -> None:
        super().close()
        self._refuse("close", self._path)


@dataclass
class FailingDisk(Disk):
    """A disk that refuses what `refusal` says; `free` is what it claims to have left."""

    refusal: Refusal = lambda what, path: 0
    free: int | None = None
    done: list[tuple[str, str]] = field(default_factory=list)

    def _refuse(self, what: str, path: Path) -> None:
        self.done.append((what, path.name))
        number = self.refusal(what, path)
        if number:
            raise OSError(number, os.strerror(number), str(path))

    def create(self, path: Path) -> DiskFile:
        self._refuse("create", path)
        return FailingFile(path, self._refuse)

    def replace(self, source: Path, target: Path) -> None:
        self._refuse("replace", source)
        super().replace(source, target)

    def remove(self, path: Path) -> None:
        self._refuse("remove", path)
        super().remove(path)

    def write_text(self, path: Path, text: str) -> None:
        self._refuse("text", path)
        super().write_text(path, text)

    def free_bytes(self, folder: Path) -> int:
        return super().free_bytes(folder) if self.free is None else self.free


FULL = errno.ENOSPC


def frames(first: int, count: int, t_ns: int, period_ns: int = MS, bus: int = 0) -> FrameBatch:
    """Frames with the numbers `first`, `first` + 1 ..., one each `period_ns` from `t_ns` on."""
    return FrameBatch.from_rows(
        (t_ns + n * period_ns, bus, 0x185, 0, 8, (first + n).to_bytes(8, "little"))
        for n in range(count)
    )


class Run:
    """A recording to which numbered frames are given, `per_step` of them each `step_ns`."""

    def __init__(
        self,
        target: Path,
        *,
        disk: Disk | None = None,
        per_step: int = 100,
        step_ns: int = S,
        start_ns: int = T0,
        buses: Sequence[str] = ("a",),
        resumes: bool = False,
        **options: Any,
    ) -> None:
        all_options: dict[str, Any] = {"recording_id": "id", "decode": False} | options
        self.recording = Recording(
            target,
            [BusInfo(name, n) for n, name in enumerate(buses)],
            RecordOptions(**all_options),
            start_ns=start_ns,
            host="here",
            resumes=resumes,
            disk=disk,
        )
        self.sent = 0
        self.now_ns = start_ns
        self.per_step = per_step
        self._step_ns = step_ns

    def step(self, count: int = 1) -> "Run":
        """Let so many steps pass, each with its frames."""
        for _ in range(count):
            batch = frames(self.sent, self.per_step, self.now_ns, self._step_ns // self.per_step)
            self.sent += len(batch)
            self.now_ns += self._step_ns
            self.recording.take_frames(batch, batch.t_ns)
            self.recording.add_all_status(self.now_ns - 1)
            self.recording.write(batch, batch.t_ns, now_ns=self.now_ns)
        return self

    @property
    def store(self) -> CaptureStore:
        """The files of the recording."""
        store = self.recording.store
        assert isinstance(store, CaptureStore)
        return store

    def kill(self) -> "Run":
        """End as a process does that is killed: nothing is closed but by the system."""
        assert self.store._open is not None
        self.store._open.file._stream.close()
        return self

    def finish(self) -> RecordResult:
        """Close the recording."""
        return self.recording.finish(self.now_ns, "stopped")


def files_of(folder: Path) -> list[Path]:
    """Captures of a folder in the order of their names."""
    return sorted(folder.glob("*.mcap"))


def numbers_in(*paths: Path) -> list[int]:
    """Numbers of the frames in these captures, in file order."""
    found: list[int] = []
    for path in paths:
        for item in CaptureScan(path).batches():
            if isinstance(item, FrameBatch):
                found += item.data[:, :8].copy().view("<u8").ravel().tolist()
    return found


def gaps_in(*paths: Path) -> list[Gap]:
    """Gaps in these captures, in file order."""
    return [g for path in paths for g in CaptureScan(path).batches() if isinstance(g, Gap)]


def lost_in(*paths: Path) -> int:
    """Frames that the gaps in these captures report as lost."""
    return sum(gap.lost_frames or 0 for gap in gaps_in(*paths))


def is_sorted(values: Sequence[int]) -> bool:
    """Whether every value is larger than the one before."""
    return bool(np.all(np.diff(values) > 0))
