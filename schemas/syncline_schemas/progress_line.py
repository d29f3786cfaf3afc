"""One line that tells how far a long job is; on a terminal only, and gone when the job is done."""

import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from typing import TextIO

QUIET_S = 1.0
"""A job that takes no longer is not told of."""
PERIOD_S = 0.2
STEADY_S = 2.0
"""Before this the time left is not told: it would jump."""

Tell = Callable[[int], None]
"""Called with the number of frames done so far."""


class ProgressLine:
    """Writes the line when it is due; what the terminal raises ends no job.

    Args:
        stream: the terminal.
        expected: how many frames there are in all, about, or what tells it when the line is first
            written; None where nobody knows.
        clock: seconds that only grow.
        columns: width of the terminal.
    """

    def __init__(
        self,
        stream: TextIO,
        expected: Callable[[], int | None] | int | None = None,
        clock: Callable[[], float] = time.monotonic,
        columns: int = 80,
    ) -> None:
        self._stream = stream
        self._expected = expected
        self._clock = clock
        self._columns = columns
        self._begun = self._due = clock()
        self._due += QUIET_S
        self._frames = 0
        self._shown = 0

    def __call__(self, frames: int) -> None:
        """Tell how many frames are done; fewer than before: the next part of the job begins."""
        now = self._clock()
        if frames < self._frames:
            self._begun = now
        self._frames = frames
        if now >= self._due:
            self._due = now + PERIOD_S
            if callable(self._expected):
                self._expected = self._expected()
            self._write(progress_text(frames, now - self._begun, self._expected))

    def say(self, text: str) -> None:
        """Tell in words what is being done, at once."""
        self._write(text)

    def clear(self) -> None:
        """Leave nothing of the line."""
        if self._shown:
            self._write("")
            with suppress(OSError, ValueError):
                self._stream.write("\r")
                self._stream.flush()
            self._shown = 0

    def _write(self, text: str) -> None:
        text = text[: max(self._columns - 1, 0)]
        with suppress(OSError, ValueError):
            self._stream.write(f"\r{text:<{self._shown}}")
            self._stream.flush()
        self._shown = len(text)


def progress_text(frames: int, elapsed_s: float, expected: int | None) -> str:
    """How far a job is: frames, frames per second, share and time left where they are known.

    >>> progress_text(3_000_000, 3.0, 12_000_000)
    '3,000,000 frames   1,000,000 frames/s   25 %   9 s left'
    >>> progress_text(3_000_000, 3.0, None)
    '3,000,000 frames   1,000,000 frames/s'
    """
    rate = frames / elapsed_s if elapsed_s > 0 else 0.0
    parts = [f"{frames:,} frames", f"{rate:,.0f} frames/s"]
    if expected and frames <= expected:
        parts.append(f"{100 * frames // expected} %")
        if elapsed_s >= STEADY_S and rate:
            parts.append(f"{_time_left((expected - frames) / rate)} left")
    return "   ".join(parts)


def _time_left(seconds: float) -> str:
    """A time left as people say it.

    >>> _time_left(9.2), _time_left(75), _time_left(7300)
    ('9 s', '1 min 15 s', '2 h 1 min')
    """
    whole = round(seconds)
    if whole < 60:
        return f"{whole} s"
    minutes, rest = divmod(whole, 60)
    return f"{minutes} min {rest} s" if minutes < 60 else f"{minutes // 60} h {minutes % 60} min"


@contextmanager
def progress_line(
    expected: Callable[[], int | None] | None = None,
) -> Iterator[ProgressLine | None]:
    """A line on stderr for as long as the block runs; None where stderr is no terminal.

    expected: tells how many frames there are in all; asked on a terminal only, after a second.
    """
    if not sys.stderr.isatty():
        yield None
        return
    from shutil import get_terminal_size

    line = ProgressLine(sys.stderr, expected, columns=get_terminal_size().columns)
    try:
        yield line
    finally:
        line.clear()
