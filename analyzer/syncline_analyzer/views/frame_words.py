"""One frame in one line: time, bus, COB-ID, bytes, and what it is by the tables of the analysis."""

from syncline_analyzer.decode.part import Part, Tone
from syncline_analyzer.decode.sdo_words import plain_words
from syncline_analyzer.decode.services import (
    emcy_words,
    error_control_words,
    error_words,
    nmt_words,
    sync_words,
)
from syncline_analyzer.decode.stream import DecodedBatch, Decoding
from syncline_analyzer.results import Analysis, Severity
from syncline_analyzer.results.sdo_records import KINDS
from syncline_analyzer.views.decode_lines import in_order
from syncline_analyzer.views.words import Clock, hex_code, names_of, node_label, printable
from syncline_schemas.batch import FrameBatch, FrameFlag

_BYTES = 8
"""Bytes of a frame that are shown."""
_MASTER_SDO, _NODE_SDO, _EMCY, _ERROR_CONTROL = 0x600, 0x580, 0x080, 0x700
_TELLING = {True: (1, 2, 4), False: (2, 3, 4)}
"""Command specifiers of requests and of answers that name their object."""
Said = tuple[str, Severity]
"""What a frame says, and how loud that is."""
_BEFORE = {
    "NMT": "NMT ",
    "SDO req": "SDO to {whose}: ",
    "SDO ans": "SDO from {whose}: ",
    "heartbeat": "{whose}: ",
    "guarding": "{whose}: ",
}
_ALONE = ("sync", "time", "error", "other")
"""What says by itself what it is."""
_LOUDNESS: dict[Tone, Severity] = {Tone.BAD: "error", Tone.ORDER: "warning"}


class FrameLines:
    """Writes the frames of one analyzed capture."""

    def __init__(self, analysis: Analysis) -> None:
        self._clock = Clock.of(analysis.capture)
        self._buses = analysis.capture.buses
        self._width = max(map(len, self._buses)) if len(self._buses) > 1 else 0
        self._names = names_of(analysis.nodes)
        self._nodes = {(row.bus, row.node) for row in analysis.nodes}
        self._guarded = {
            (row.bus, row.node) for row in analysis.nodes if row.guard_answers > row.heartbeats
        }
        self._syncs = {(row.bus, row.cob_id) for row in analysis.sync}
        self._pdos = {(row.bus, row.cob_id): row for row in analysis.pdos}
        self._blocks: dict[tuple[str, int], list[tuple[int, int]]] = {}
        for each in analysis.sdo.part(analysis.sdo.records["kind"] == KINDS.index("block")):
            self._blocks.setdefault((each.bus, each.node), []).append((each.start_ns, each.end_ns))
        self._boots = {
            row.evidence for row in analysis.nmt_states if "boot-up" in row.cause and row.evidence
        }

    def decoded(self, decoding: Decoding) -> list[Said]:
        """What each frame of a session says, in order, decoded from the first one on."""
        told: list[Said] = []
        for item in decoding.items():
            if isinstance(item, DecodedBatch):
                parts = (self._said(part) for part in item.parts)
                told += in_order(item.parts, len(item.batch), parts)[0]
        return told

    def _said(self, part: Part) -> list[Said]:
        """The distinct words of a part, with who says them."""
        head = part.head
        bus = self._buses[head.bus] if head.bus < len(self._buses) else f"bus {head.bus}"
        whose = "" if head.node is None else self._label(bus, head.node)
        if head.family == "pdo":
            before = f"{head.service} {head.node}: "
        elif head.family in _ALONE:
            before = ""
        else:
            usual = "{service} of {whose}: " if whose else "{service} "
            before = _BEFORE.get(head.service, usual).format(service=head.service, whose=whose)
        return [
            (f"{before}{words.text}", _LOUDNESS.get(words.tone, "info")) for words in part.words
        ]

    def line(
        self, frames: FrameBatch, row: int, seq: int | None, said: Said | None = None
    ) -> tuple[str, Severity]:
        """A frame in words, and how loud they are; `said` is what it was decoded to."""
        number, can_id = int(frames.bus[row]), int(frames.can_id[row])
        bus = self._buses[number] if number < len(self._buses) else f"bus {number}"
        flags, length = int(frames.flags[row]), int(frames.dlc[row])
        wide = 8 if flags & FrameFlag.EXTENDED else 3
        data = frames.data[row, :length].tobytes()
        shown = data[:_BYTES].hex().upper() + (".." if length > _BYTES else "")
        head = f"{self.moment(int(frames.t_ns[row]))} "
        if self._width:
            head += f"{printable(bus):<{self._width}} "
        if said is not None:
            # The bytes come last: where there is little room, what they mean is seen.
            shown = "remote" if flags & FrameFlag.REMOTE else shown
            return f"{head}{hex_code(can_id, wide)} {said[0]}  [{length}] {shown}".rstrip(), said[1]
        severity: Severity = "info"
        if flags & FrameFlag.ERROR:
            words, severity = error_words(can_id, data).text, "error"
        elif flags & FrameFlag.EXTENDED:
            words = ""
        elif flags & FrameFlag.REMOTE:
            shown, words = "remote", self._remote(bus, can_id)
        else:
            words, severity = self._data(bus, can_id, data, int(frames.t_ns[row]), seq)
        return f"{head}{hex_code(can_id, wide)} {length} {shown:<16} {words}".rstrip(), severity

    def moment(self, t_ns: int) -> str:
        """Capture time to the microsecond."""
        if not self._clock.timed:
            return "-"
        us = (t_ns - self._clock.first_ns) // 1000
        seconds, us = divmod(us, 1_000_000)
        minutes, seconds = divmod(seconds, 60)
        hours, minutes = divmod(minutes, 60)
        head = f"{hours}:{minutes:02}" if hours else f"{minutes}"
        return f"{head}:{seconds:02}.{us:06}"

    def _label(self, bus: str, node: int) -> str:
        return f"node {self._names.get((bus, node), node_label(node))}"

    def _remote(self, bus: str, can_id: int) -> str:
        node = can_id & 0x7F
        if can_id & ~0x7F == _ERROR_CONTROL and node:
            return f"guard request to {self._label(bus, node)}"
        pdo = self._pdos.get((bus, can_id))
        return f"asks for {pdo.pdo or 'PDO'} of {self._label(bus, pdo.node or node)}" if pdo else ""

    def _sdo(self, bus: str, node: int, data: bytes, t_ns: int, *, asks: bool) -> str:
        """What begins a transfer or stands alone; other frames carry no object."""
        within = self._blocks.get((bus, node), ())
        if any(start_ns < t_ns < end_ns for start_ns, end_ns in within):
            return "part of a block transfer"
        if not data or data[0] >> 5 not in _TELLING[asks]:
            return "segment"
        return plain_words(None, data, request=asks).text

    def _data(
        self, bus: str, can_id: int, data: bytes, t_ns: int, seq: int | None
    ) -> tuple[str, Severity]:
        if can_id == 0:
            names = {node: label for (on, node), label in self._names.items() if on == bus}
            return f"NMT {nmt_words(data, names).text}", "warning"
        if (bus, can_id) in self._syncs:
            return sync_words(data).text, "info"
        if pdo := self._pdos.get((bus, can_id)):
            return f"{pdo.pdo or 'PDO'} of {self._label(bus, pdo.node or can_id & 0x7F)}", "info"
        node, function = can_id & 0x7F, can_id & ~0x7F
        if (bus, node) not in self._nodes:
            return "", "info"
        label = self._label(bus, node)
        if function == _ERROR_CONTROL:
            guarded = (bus, node) in self._guarded and data != b"\0"
            boots = seq in self._boots if seq is not None else False
            words = error_control_words(data, guarded=guarded, boots=boots)
            return f"{label}: {words.text}", "info"
        if function == _EMCY:
            return f"EMCY of {label}: {emcy_words(None, data).text}", "error"
        if function in (_MASTER_SDO, _NODE_SDO):
            asks = function == _MASTER_SDO
            said = self._sdo(bus, node, data, t_ns, asks=asks)
            return f"SDO {'to' if asks else 'from'} {label}: {said}", "info"
        return "", "info"
