"""IXXAT canAnalyser and other ASCII traces: IXXAT's header above a table with columns of its own."""

from pathlib import Path

from syncline_analyzer.readers.csv_columns import CsvColumns
from syncline_analyzer.readers.csv_log import CsvFormat
from syncline_analyzer.readers.ixxat import DAY_NS, bit_rate, check_stop, is_header, take_header
from syncline_analyzer.readers.lines import NoFrame, Parsed


class IxxatTableFormat(CsvFormat):
    """A table whose times count from the header's start, or tell the time of that day."""

    def __init__(self, path: Path, columns: CsvColumns) -> None:
        super().__init__(path, columns)
        self.facts.format = "ixxat"
        self._start_ns: int | None = None

    def prepare(self, head: bytes) -> None:
        """Date, bit rate and lost frames from the header, the rest from the first lines."""
        start_ns = take_header(self.facts, head)
        super().prepare(head)
        if start_ns is not None and self.facts.time_base == "relative":
            self.facts.time_base, self._start_ns = "utc", start_ns
            of_day = b"abs" in (self._columns.header or b"").lower()
            self.origin_ns = start_ns - start_ns % DAY_NS if of_day else start_ns
            self.wraps_ns = DAY_NS if of_day else 0
        rate = bit_rate(self.facts)
        if rate and "bus" not in self._columns.roles:
            self.facts.bitrates[self.facts.buses[self.bus(b"1") or 0]] = rate

    def parse(self, line: bytes) -> Parsed:
        """One line: a frame, or the header."""
        return NoFrame() if is_header(line) else super().parse(line)

    def finish(self, last_ns: int | None) -> None:
        """Say it when the frames run past the time at which the trace was stopped."""
        if self._start_ns is not None:
            check_stop(self.facts, self._start_ns, last_ns)
