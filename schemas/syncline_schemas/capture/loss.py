"""The stretches in which a capture file is silent because part of it cannot be read."""

from syncline_schemas.batch import Gap

REASON = "damaged chunk in the capture file"
_NEVER = 1 << 63


class LossTracker:
    """Turns lost chunks into gaps: silence of the file must not be taken for silence of the bus.

    Fed in file order. A lost chunk whose own times are unknown makes a gap from the last message
    before it to the first message after it.
    """

    def __init__(self) -> None:
        self._last_ns = 0
        self._open = False

    def lost(self, start_ns: int | None, end_ns: int | None, frames: int | None) -> Gap | None:
        """Take in a lost chunk; its gap, or None when that ends with the next chunk."""
        if start_ns is None or end_ns is None or not self._last_ns <= start_ns <= end_ns < _NEVER:
            self._open = True
            return None
        self._last_ns = end_ns
        return Gap(start_ns, end_ns + 1, REASON, frames)

    def read(self, first_ns: int, last_ns: int) -> Gap | None:
        """Take in a chunk that was read; the gap that ends with it."""
        gap = None
        if self._open and first_ns > self._last_ns:
            gap = Gap(self._last_ns, first_ns, REASON)
        self._open = False
        self._last_ns = max(last_ns, self._last_ns)
        return gap

    def finish(self) -> Gap | None:
        """The gap that nothing ends."""
        return Gap(self._last_ns, self._last_ns + 1, REASON) if self._open else None
