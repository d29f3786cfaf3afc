"""Messages between processes arrive as they were, however the pipe takes them."""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from io import FileIO
from threading import Thread

import numpy as np
import pytest

from syncline_analyzer import messages
from syncline_analyzer.messages import MessageWriter, read_message


@contextmanager
def sent(*told: object) -> Iterator[FileIO]:
    """Where messages can be read that another thread sends."""
    out, into = os.pipe()

    def send() -> None:
        with FileIO(into, "wb") as stream, MessageWriter(stream) as writer:
            for each in told:
                writer.put(each)

    thread = Thread(target=send)
    thread.start()
    try:
        with FileIO(out, "rb") as stream:
            yield stream
    finally:
        thread.join()


def test_arrays_arrive_as_they_were() -> None:
    # More than one call may write, and more than a pipe holds.
    columns = [np.full(600 + n, n, np.int64) for n in range(1500)]
    told = {"name": "a", "small": np.arange(3, dtype=np.uint8), "columns": columns}
    with sent(told, "end") as stream:
        found, end = read_message(stream), read_message(stream)
        with pytest.raises(EOFError):
            read_message(stream)
    assert (found["name"], found["small"].tolist(), end) == ("a", [0, 1, 2], "end")
    assert [column.tolist() for column in found["columns"]] == [
        [n] * (600 + n) for n in range(1500)
    ]
    found["columns"][0][0] = 7


@pytest.mark.parametrize("most", [1, 7, 4096, 100_000])
def test_what_a_call_leaves_is_written_by_the_next(
    most: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    def some(writer: MessageWriter, parts: list[memoryview]) -> int:
        return os.write(writer._out.fileno(), b"".join(parts)[:most])

    monkeypatch.setattr(MessageWriter, "_written", some)
    told = [b"x", np.arange(2 * messages._IN_LINE // 8), np.arange(9000, dtype=np.uint8)]
    with sent(told) as stream:
        found = read_message(stream)
    assert found[0] == b"x"
    assert [column.tolist() for column in found[1:]] == [
        list(range(1024)),
        [n % 256 for n in range(9000)],
    ]
