"""The process in which asammdf reads: bounded memory, nothing of what it prints is told."""

import os
import pickle
import sys
import tempfile
import time
import warnings
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from threading import Thread
from typing import BinaryIO, Final

from syncline_analyzer.readers.mf4 import Message
from syncline_analyzer.readers.mf4_repair import is_whole, mend
from syncline_schemas.errors import CaptureError, SynclineError

_LEAST_BYTES: Final = 2 << 30
"""Address space beside three times the file."""
_WATCH_S: Final = 1.0


def main(name: str) -> None:
    """Tell the frames of a file on the standard output."""
    out = os.fdopen(os.dup(1), "wb")
    with open(os.devnull, "wb") as nothing:
        os.dup2(nothing.fileno(), 1)
        os.dup2(nothing.fileno(), 2)
    warnings.simplefilter("ignore")
    Thread(target=_end_with, args=(os.getppid(),), daemon=True).start()
    path = Path(name)
    with suppress(BrokenPipeError):
        try:
            _bound_memory(path)
            for message in messages(path):
                _tell(out, message)
        except MemoryError:
            _tell(
                out,
                Message(refused=f"{path}: cannot be read as ASAM MDF: it needs too much memory"),
            )
        except Exception as error:  # noqa: BLE001  whatever a damaged file makes of asammdf
            _tell(out, Message(refused=_said(path, error)))
    out.flush()
    # asammdf may not end by itself after what a damaged file did to it.
    os._exit(0)


def _end_with(parent: int) -> None:
    """End when the process that asked has: nobody else ends a library that hangs."""
    while os.getppid() == parent:
        time.sleep(_WATCH_S)
    os._exit(1)


def _said(path: Path, error: Exception) -> str:
    if isinstance(error, SynclineError):
        return str(error)
    return f"{path}: cannot be read as ASAM MDF: {str(error) or type(error).__name__}"


def messages(path: Path) -> Iterator[Message]:
    """What this process tells of a file.

    Raises:
        CaptureError: the file cannot be read, or it holds no CAN frames.
    """
    from syncline_analyzer.readers.mf4_library import Mf4Frames

    with _readable(path) as (readable, damage):
        try:
            reader = Mf4Frames(readable, path)
        except CaptureError as error:
            raise CaptureError(f"{error}; {damage}" if damage else str(error)) from None
        reader.facts.damage = reader.facts.damage or damage
        yield Message(reader.facts)
        for frames in reader.batches():
            reader.facts.damage = reader.facts.damage or damage
            yield Message(reader.facts, frames)
        yield Message(reader.facts, ends=True)


def _tell(out: BinaryIO, message: Message) -> None:
    pickle.dump(message, out, protocol=5)
    out.flush()


@contextmanager
def _readable(path: Path) -> Iterator[tuple[Path, str | None]]:
    """A file that asammdf can read: this one, or a mended copy; and what is missing of it."""
    with path.open("rb") as file:
        whole = is_whole(file)
    if whole:
        yield path, None
        return
    with tempfile.TemporaryDirectory(prefix="syncline-mf4-") as folder:
        copy = Path(folder) / "mended.mf4"
        with path.open("rb") as source, copy.open("w+b") as target:
            while block := source.read(1 << 20):
                target.write(block)
            damage = mend(target, path)
        yield copy, damage


def _bound_memory(path: Path) -> None:
    try:
        import resource
    except ImportError:  # Windows
        return
    most = _LEAST_BYTES + 3 * path.stat().st_size
    with suppress(OSError, ValueError):
        resource.setrlimit(resource.RLIMIT_AS, (most, most))


if __name__ == "__main__":
    main(sys.argv[1])
