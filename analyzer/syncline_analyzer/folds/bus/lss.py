"""LSS frames: who was given which node-ID and bit rate (CiA 305)."""

from bisect import bisect_left
from dataclasses import field

from syncline_analyzer.context import Context
from syncline_analyzer.fold import IndexedBatch
from syncline_analyzer.results import LssRow
from syncline_schemas.canopen.lss import decode_frame
from syncline_schemas.records import dataclass

REQUEST_ID, ANSWER_ID = 0x7E5, 0x7E4
MAX_ROWS = 10_000
SESSION_NS = 60_000_000_000
"""What was asked longer ago may have been another slave [ns]."""
ANSWER_NS = 2_000_000_000
"""An answer that comes later belongs to nothing [ns]."""


@dataclass(frozen=True, slots=True)
class LssSetting:
    """A node-ID or bit rate that was asked for and answered; `request`, `answer` are rows."""

    request: LssRow
    answer: LssRow

    @property
    def refused(self) -> bool:
        """Whether the slave did not take it."""
        return bool(self.answer.values.get("error"))


@dataclass(frozen=True, slots=True)
class LssTable:
    """Frames in order of `seq`, the number of those beyond, and settings with their answers."""

    rows: list[LssRow] = field(default_factory=list)
    beyond: int = 0
    settings: list[LssSetting] = field(default_factory=list)

    def node_before(self, setting: LssSetting) -> int | None:
        """Node-ID that the configured slave had, as the master asked it shortly before.

        None where several slaves answered.
        """
        asked = {
            row.values["node_id"]
            for row in self._session(setting)
            if (row.sender, row.command) == ("slave", "inquire node-ID")
        }
        return asked.pop() if len(asked) == 1 else None

    def identity(self, setting: LssSetting) -> dict[int, int]:
        """What 1018h of the configured slave holds, by subindex, as far as it was named by it."""
        return {
            _IDENTITY[name]: row.values["number"]
            for row in self._session(setting)
            for name in [row.command.removeprefix(_SELECTED).removeprefix(_INQUIRED)]
            if name in _IDENTITY and "number" in row.values
        }

    def _session(self, setting: LssSetting) -> list[LssRow]:
        """What was said shortly before a setting since its slave was selected, latest first."""
        bus, until_ns = setting.request.bus, setting.request.t_ns
        found: list[LssRow] = []
        at = bisect_left(self.rows, setting.request.seq, key=lambda row: row.seq)
        for row in reversed(self.rows[:at]):
            if row.bus != bus:
                continue
            if until_ns - row.t_ns > SESSION_NS or row.command in _OTHERS:
                break
            found.append(row)
            if row.command == _FIRST_SELECTED:
                break
        return found


_SELECTED, _INQUIRED = "switch state selective ", "inquire "
_FIRST_SELECTED = f"{_SELECTED}vendor-ID"
_IDENTITY = {"vendor-ID": 1, "product code": 2, "revision number": 3, "serial number": 4}
"""Subindex of 1018h by the name of what selects a slave, or was inquired of it."""
_OTHERS = ("switch state global", "configure node-ID")
"""Before these another slave, or another number, was spoken of."""
_CONFIGURE = ("configure node-ID", "configure bit timing", "store configuration")


class LssFold:
    """Keeps the LSS frames of all buses, and joins what was configured with its answer."""

    def __init__(self, context: Context) -> None:
        self._context = context
        self._rows: list[LssRow] = []
        self._beyond = 0
        self._open: dict[str, LssRow] = {}
        self._settings: list[LssSetting] = []

    def update(self, batch: IndexedBatch) -> None:
        """Take in the next frames."""
        found: list[tuple[int, int, bool]] = []
        for bus in batch.buses:
            for can_id in (REQUEST_ID, ANSWER_ID):
                rows = batch.rows(bus, can_id)
                # No more of them can be listed, whatever the other identifiers hold.
                listed = rows[:MAX_ROWS].tolist()
                self._beyond += len(rows) - len(listed)
                found += [(row, bus, can_id == REQUEST_ID) for row in listed]
        for row, bus, request in sorted(found):
            self._take(batch, row, bus, request=request)

    def finish(self, buses: set[str]) -> LssTable:
        """The frames on buses that speak CANopen, by name, or on which LSS got an answer."""
        speaking = buses | {each.request.bus for each in self._settings}
        rows = [row for row in self._rows if row.bus in speaking]
        settings = sorted(self._settings, key=lambda each: each.answer.seq)
        return LssTable(sorted(rows, key=lambda row: row.seq), self._beyond, settings)

    def _take(self, batch: IndexedBatch, row: int, bus: int, *, request: bool) -> None:
        if len(self._rows) >= MAX_ROWS:
            self._beyond += 1
            return
        frame = decode_frame(batch.frames.payload(row), request=request)
        entry = LssRow(
            self._context.bus_name(bus),
            batch.seq(row),
            int(batch.frames.t_ns[row]),
            "master" if request else "slave",
            frame.command,
            frame.text,
            frame.values,
        )
        self._rows.append(entry)
        if request:
            self._open[entry.bus] = entry
        elif entry.command in _CONFIGURE:
            self._answer(entry)

    def _answer(self, answer: LssRow) -> None:
        asked = self._open.get(answer.bus)
        if asked is None or asked.command != answer.command:
            return
        if not self._context.timed or 0 <= answer.t_ns - asked.t_ns <= ANSWER_NS:
            self._settings.append(LssSetting(asked, answer))
            del self._open[answer.bus]
