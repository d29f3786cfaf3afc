"""The disk as the recorder uses it: whole writes, synced files and names, free space."""

import errno
import os
import shutil
from importlib import import_module
from pathlib import Path

from syncline_logger.small_file import replace_file


class DiskFile:
    """A new file; what was written before `sync` returned survives a power cut.

    Nothing is buffered here, so that a write that failed never comes back later.

    Raises:
        OSError: every method, for whatever the disk says.
    """

    def __init__(self, path: Path) -> None:
        flags = os.O_RDWR | os.O_CREAT | os.O_EXCL
        flags |= getattr(os, "O_CLOEXEC", 0) | getattr(os, "O_BINARY", 0)
        self._fd = os.open(path, flags, 0o644)
        lock(self._fd)

    def write(self, data: bytes | bytearray, /) -> int:
        """Write all of the bytes."""
        left = memoryview(data)
        while left:
            left = left[os.write(self._fd, left) :]
        return len(data)

    def sync(self) -> None:
        """Wait until all that was written is on the disk."""
        os.fsync(self._fd)
        # ext4 answers that all is well, and writes nothing, once the kernel made it read-only.
        if os.name == "posix" and os.fstatvfs(self._fd).f_flag & os.ST_RDONLY:
            raise OSError(errno.EROFS, os.strerror(errno.EROFS))

    def truncate(self, size: int) -> None:
        """Cut the file off at `size`, where the next write begins."""
        os.ftruncate(self._fd, size)
        os.lseek(self._fd, size, os.SEEK_SET)

    def close(self) -> None:
        """Close the file."""
        os.close(self._fd)


class Disk:
    """Files and names of the folder in which a recorder writes."""

    def create(self, path: Path) -> DiskFile:
        """A new file. Raises FileExistsError where there is one, OSError as the disk says."""
        return DiskFile(path)

    def sync_folder(self, folder: Path) -> None:
        """Make names in a folder durable; Windows does that by itself."""
        if os.name != "posix":
            return
        fd = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(fd)
        finally:
            os.close(fd)

    def replace(self, source: Path, target: Path) -> None:
        """Give a file, which is on the disk, another name for good."""
        source.replace(target)
        self.sync_folder(target.parent)

    def remove(self, path: Path) -> None:
        """Delete a file. Raises OSError when it cannot be, other than that it is not there."""
        path.unlink(missing_ok=True)

    def free_bytes(self, folder: Path) -> int:
        """What an ordinary user may still write to the disk of a folder [bytes]."""
        return shutil.disk_usage(folder).free

    def write_text(self, path: Path, text: str) -> None:
        """Write a small file in one step: a reader, or a power cut, finds the old or the new."""
        replace_file(path, text, durable=True)
        self.sync_folder(path.parent)

    def overwrite(self, path: Path, text: str) -> None:
        """Write a small file where it is: that needs no room but its own, and is not one step.

        A refusal leaves what was there, if the disk takes it back.
        """
        with path.open("r+b", buffering=0) as file:
            before = file.read()
            try:
                _write_all(file.fileno(), text.encode())
            except OSError:
                _write_all(file.fileno(), before)
                raise


def _write_all(fd: int, data: bytes) -> None:
    """Make this the whole content of an open file, on the disk."""
    os.lseek(fd, 0, os.SEEK_SET)
    left = memoryview(data)
    while left:
        left = left[os.write(fd, left) :]
    os.ftruncate(fd, len(data))
    os.fsync(fd)


def lock(fd: int) -> bool:
    """Say that this process writes a file, until it ends; False when another one does.

    Elsewhere than on POSIX systems an open file cannot be replaced or deleted anyway.
    """
    if os.name != "posix":
        return True
    fcntl = import_module("fcntl")
    try:
        fcntl.flock(fd, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    except OSError:
        # Some network file systems know no locks: nobody can be told, nobody is kept out.
        return True
    return True


def is_being_written(path: Path) -> bool:
    """Whether a recorder that still runs has this file open."""
    if os.name != "posix":
        return False
    fd = os.open(path, os.O_RDONLY | os.O_CLOEXEC)
    try:
        return not lock(fd)
    finally:
        os.close(fd)
