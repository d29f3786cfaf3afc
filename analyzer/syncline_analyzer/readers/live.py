"""candump text that is still being written: frames as their lines come."""

import os
from collections.abc import Callable, Iterator
from itertools import chain
from pathlib import Path
from queue import Empty, Queue
from threading import Thread
from time import sleep
from typing import BinaryIO

from syncline_analyzer.readers.candump import CandumpFormat, is_candump
from syncline_analyzer.readers.lines import MAX_PARSED_LINE, TextReader
from syncline_analyzer.readers.source import BLOCK_BYTES, MAX_LINE_BYTES
from syncline_schemas.batch import FrameBatch, Gap

Read = Callable[[], bytes]
"""Gives what has come since it was asked last, waits where that is nothing; b"" is the end."""

_PIECE = 65_536
_WAITING_PIECES = BLOCK_BYTES // _PIECE
_LOOK_S = 0.2
_LINES_LOOKED_AT = 100


class LiveReader:
    """Reads candump text as batches of what has come; the last line of a stream may lack its end.

    Args:
        path: what the log is called.
        head: what was read of it already, with one whole line at least.
        read: gives the rest.
    """

    def __init__(self, path: Path, head: bytes, read: Read) -> None:
        self._lines = _LiveLines(head, read)
        self._reader = TextReader(path, CandumpFormat(path))
        self.facts = self._reader.facts

    def batches(self) -> Iterator[FrameBatch | Gap]:
        """Batches in the order of the text, none of which waits for the next."""
        yield from self._reader.batches_of(self._lines)


class _LiveLines:
    """Whole lines of what has come."""

    damage = None

    def __init__(self, head: bytes, read: Read) -> None:
        self.head = head
        self._read = read

    def blocks(self) -> Iterator[bytes]:
        rest, part = b"", self.head
        while part:
            text = rest + part
            end = text.rfind(b"\n") + 1 or (len(text) if len(text) > MAX_LINE_BYTES else 0)
            rest = text[end:]
            if end:
                yield text[:end]
            part = self._read()
        if rest:
            yield rest


def numbered(
    items: Iterator[FrameBatch | Gap],
) -> tuple[int | None, Iterator[tuple[int, FrameBatch | Gap]]]:
    """The first stamp, and the items with the place of their first frame; waits for the first."""
    first = next(items, None)
    if first is None:
        return None, iter(())
    first_ns = first.start_ns if isinstance(first, Gap) else int(first.t_ns[0])

    def placed() -> Iterator[tuple[int, FrameBatch | Gap]]:
        seq = 0
        for item in chain((first,), items):
            yield seq, item
            seq += 0 if isinstance(item, Gap) else len(item)

    return first_ns, placed()


def first_line(read: Read) -> bytes:
    """What comes until there is a whole line, or until it is plain that there is none."""
    head = b""
    while b"\n" not in head and len(head) <= MAX_LINE_BYTES and (part := read()):
        head += part
    return head


def is_live(head: bytes) -> bool:
    """Whether a stream that begins so is candump's text, which needs no look at what follows."""
    whole = head[: head.rfind(b"\n") + 1].splitlines()[:_LINES_LOOKED_AT]
    return is_candump([line[:MAX_PARSED_LINE] for line in whole])


def as_it_comes(descriptor: int) -> Read:
    """What a pipe or terminal gives, read aside, so that all that has come is taken at once."""
    waiting: Queue[bytes] = Queue(_WAITING_PIECES)

    def pull() -> None:
        while part := _piece(descriptor):
            waiting.put(part)
        waiting.put(b"")

    Thread(target=pull, daemon=True).start()
    ended = False

    def read() -> bytes:
        nonlocal ended
        parts = [] if ended else [_next(waiting)]
        while parts and parts[-1] and not waiting.empty() and len(parts) < _WAITING_PIECES:
            parts.append(waiting.get())
        ended = ended or not parts[-1]
        return b"".join(parts)

    return read


def _piece(descriptor: int) -> bytes:
    try:
        return os.read(descriptor, _PIECE)
    except OSError:
        return b""


def _next(waiting: "Queue[bytes]") -> bytes:
    """The next piece; waits with pauses, since a wait without end hides Ctrl-C on Windows."""
    while True:
        try:
            return waiting.get(timeout=_LOOK_S)
        except Empty:
            continue


def appended(file: BinaryIO) -> Read:
    """What a file holds and what is appended to it, without an end; a file cut short begins anew."""

    def read() -> bytes:
        while not (part := file.read(BLOCK_BYTES)):
            sleep(_LOOK_S)
            if os.fstat(file.fileno()).st_size < file.tell():
                file.seek(0)
        return part

    return read
