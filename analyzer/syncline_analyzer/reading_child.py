"""The process that reads captures while this one analyzes: when there is one, its start, its end.

Nothing heavy is imported here: the process starts while this one imports the analyses.
"""

import pickle
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from functools import partial
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any, Literal, Self, cast

from syncline_analyzer.reading_request import Request
from syncline_schemas import second_process
from syncline_schemas.errors import CaptureError

if TYPE_CHECKING:
    import subprocess
    from io import RawIOBase

    from syncline_analyzer.reading import Reading
    from syncline_analyzer.reading_messages import End, Opened, SentStep

_PIPE_BYTES = 1 << 20
_MODULE = "syncline_analyzer.reading_process"


@contextmanager
def begun(request: Request, processes: Literal[1, 2] = 2) -> Iterator[Callable[[], "Reading"]]:
    """Begin to open captures; the function given waits until they are open.

    With two processes large ones are opened and read by one of their own, which is gone when the
    context is left, however that happens. Where there is none, the function opens them.

    Raises:
        CaptureError, UsageError: by the function, as `LocalReading` does; while frames are read
            also when the process dies.
    """
    wanted = processes > 1 and _is_worth_it(request)
    child = ReadingChild.started(request) if wanted else None
    try:
        yield partial(_opened, request, child)
    finally:
        if child is not None:
            child.end()


class ReadingChild:
    """The process that reads, from its start to its end."""

    def __init__(self, process: "subprocess.Popen[bytes]") -> None:
        self.process = process
        self._stream = cast("RawIOBase", process.stdout)

    @classmethod
    def started(cls, request: Request) -> Self | None:
        """A process that begins to read; None where none can be started."""
        process = second_process.process(_MODULE)
        if process is None:
            return None
        assert process.stdin is not None
        assert process.stdout is not None
        with suppress(OSError), process.stdin:
            process.stdin.write(pickle.dumps(request))
        _widen(process.stdout)
        return cls(process)

    def first(self) -> "Opened | None":
        """The first message; None from a process that could not start."""
        try:
            return cast("Opened", self._next())
        except EOFError:
            return None

    def message(self) -> "SentStep | End":
        """The next message. Raises: what the child raised; CaptureError where it died."""
        try:
            return cast("SentStep | End", self._next())
        except EOFError:
            code = self.process.wait()
            raise CaptureError(
                f"the process that read the captures ended before their end (exit code {code}),"
                " perhaps for lack of memory: try again, or a part of them with --from and --to"
            ) from None

    def _next(self) -> Any:
        from syncline_analyzer.messages import read_message
        from syncline_analyzer.reading_messages import Failed

        message = read_message(self._stream)
        if isinstance(message, Failed):
            raise message.error
        return message

    def end(self) -> None:
        """End the process, if it has not ended, and wait for it."""
        self._stream.close()
        self.process.kill()
        self.process.wait()


def _opened(request: Request, child: ReadingChild | None) -> "Reading":
    if child is not None and (opened := child.first()) is not None:
        from syncline_analyzer.remote_reading import RemoteReading

        return RemoteReading(opened, child)
    from syncline_analyzer.reading import LocalReading

    return LocalReading(request)


def _is_worth_it(request: Request) -> bool:
    """Whether there is a second processor, and enough to read for it."""
    return second_process.has_room() and _bytes(request.paths) >= second_process.LEAST_BYTES


def _bytes(paths: Iterable[Path]) -> int:
    """Bytes of the files together; 0 where one is not there."""
    try:
        return sum(path.stat().st_size for path in paths)
    except OSError:
        return 0


def _widen(pipe: IO[bytes]) -> None:
    """Make a pipe take more than 64 KiB at once, where that can be done."""
    with suppress(ImportError, AttributeError, OSError):
        import fcntl

        fcntl.fcntl(pipe, fcntl.F_SETPIPE_SZ, _PIPE_BYTES)
