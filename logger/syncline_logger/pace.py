"""When the next chunk is written, so that the stated loss bound holds on a slow disk too."""

from syncline_logger.record_options import RecordOptions


class WritePace:
    """Leaves room in the bound for a chunk that takes as long as the slowest one lately.

    The first ones take longer than those that follow, and so does each that begins a new file; the
    recorder therefore begins with short periods.

    >>> pace = WritePace(RecordOptions(flush_ns=1000))
    >>> [pace.after(spent_ns) for spent_ns in (0, 10, 400, 0, 0)]
    [563, 618, 600, 650, 694]
    """

    def __init__(self, options: RecordOptions) -> None:
        self._options = options
        self._slowest_ns = options.flush_ns // 2

    def after(self, spent_ns: int) -> int:
        """How long after the beginning of a chunk the next one begins [ns]."""
        self._slowest_ns = max(spent_ns, self._slowest_ns * 7 // 8)
        return self._options.period_after(self._slowest_ns)
