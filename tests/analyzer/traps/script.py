"""A log as a list of frames, and everything that the analysis of it tells a user."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Self

from syncline_analyzer.capture import CaptureFacts
from syncline_analyzer.engine import analyze
from syncline_analyzer.results import (
    Analysis,
    EmcyRow,
    Finding,
    NmtStateRow,
    NodeRow,
    ObjectRow,
    PdoRow,
    SdoRow,
    Trace,
    TraceEventRow,
    TraceRow,
)
from syncline_analyzer.views.json_view import to_json
from syncline_analyzer.views.text import summary
from syncline_schemas.batch import FrameBatch, FrameFlag, Gap
from syncline_schemas.canopen.sdo import LOAD_SIGNATURE, SAVE_SIGNATURE
from syncline_schemas.description import BusDescription

T0 = 1_750_000_000_000_000_000
MS = 1_000_000
PRE_OPERATIONAL, OPERATIONAL, STOPPED = 0x7F, 0x05, 0x04
_SIZED = {1: 0x2F, 2: 0x2B, 3: 0x27, 4: 0x23}
_ANSWERS = {1: 0x4F, 2: 0x4B, 4: 0x43}


@dataclass
class Script:
    """Frames on a time line in ms; `node` is the one meant where none is named."""

    device: str | None = None
    node: int = 1
    bitrate: int | None = None
    overrides: str = ""
    """Lines of the description's overrides."""
    rows: list[tuple[float, int, int, int, bytes]] = field(default_factory=list)
    """(ms, bus, identifier, flags, data)"""
    gaps: list[tuple[float, float]] = field(default_factory=list)
    buses: tuple[str, ...] = ("can0",)
    more: str = ""
    """Lines of the description for other nodes."""
    described: int = 0

    def __post_init__(self) -> None:
        self.described = self.node

    def frame(self, at: float, text: str, *, bus: int = 0, flags: int = 0) -> Self:
        """A frame as candump writes it, "701#05" or "701#R"."""
        can_id, _, data = text.partition("#")
        if data == "R":
            flags |= FrameFlag.REMOTE
            data = ""
        self.rows.append((at, bus, int(can_id, 16), int(flags), bytes.fromhex(data)))
        return self

    def every(
        self, start: float, stop: float, period: float, what: str | Callable[[int], str]
    ) -> Self:
        """The same frame again and again, or that which a function makes of the count."""
        count = 0
        while start + count * period < stop:
            text = what if isinstance(what, str) else what(count)
            self.frame(start + count * period, text)
            count += 1
        return self

    def nmt(self, at: float, command: int, node: int | None = None) -> Self:
        return self.frame(at, f"000#{command:02X}{self.node if node is None else node:02X}")

    def heartbeat(
        self, start: float, stop: float, state: int = OPERATIONAL, period: float = 100
    ) -> Self:
        return self.every(start, stop, period, f"{0x700 + self.node:03X}#{state:02X}")

    def sync(self, start: float, stop: float, period: float = 20) -> Self:
        return self.every(start, stop, period, "080#")

    def pdo(
        self,
        start: float,
        stop: float,
        period: float,
        value: Callable[[int], int | tuple[int, ...]],
        *,
        base: int = 0x180,
        bits: int = 32,
    ) -> Self:
        """TPDO1 with values of so many bits."""

        def text(count: int) -> str:
            found = value(count)
            values = found if isinstance(found, tuple) else (found,)
            return f"{base + self.node:03X}#{little(*values, bits=bits)}"

        return self.every(start, stop, period, text)

    def write(
        self,
        at: float,
        index: int,
        sub: int = 0,
        value: int = 0,
        *,
        size: int | None = None,
        abort: int | None = None,
        answered: bool = True,
    ) -> Self:
        """A write and its answer 1 ms later; without a size as 22h with four bytes."""
        command = 0x22 if size is None else _SIZED[size]
        self.frame(at, f"{0x600 + self.node:03X}#{command:02X}{_key(index, sub)}{little(value)}")
        if abort is not None:
            return self.abort(at + 1, index, sub, abort)
        if answered:
            self.frame(at + 1, f"{0x580 + self.node:03X}#60{_key(index, sub)}00000000")
        return self

    def read(
        self,
        at: float,
        index: int,
        sub: int = 0,
        value: int = 0,
        *,
        size: int = 4,
        abort: int | None = None,
        request: int = 0x40,
    ) -> Self:
        """A read and its answer 1 ms later."""
        self.frame(at, f"{0x600 + self.node:03X}#{request:02X}{_key(index, sub)}00000000")
        if abort is not None:
            return self.abort(at + 1, index, sub, abort)
        answer = f"{_ANSWERS[size]:02X}{_key(index, sub)}{little(value)}"
        return self.frame(at + 1, f"{0x580 + self.node:03X}#{answer}")

    def abort(self, at: float, index: int, sub: int, code: int) -> Self:
        return self.frame(at, f"{0x580 + self.node:03X}#80{_key(index, sub)}{little(code)}")

    def save(self, at: float, sub: int = 1) -> Self:
        return self.write(at, 0x1010, sub, SAVE_SIGNATURE)

    def load(self, at: float, sub: int = 1) -> Self:
        return self.write(at, 0x1011, sub, LOAD_SIGNATURE)

    def boot(self, at: float, byte: int = 0) -> Self:
        return self.frame(at, f"{0x700 + self.node:03X}#{byte:02X}")

    def emcy(self, at: float, code: int, register: int, rest: str = "0000000000") -> Self:
        return self.frame(at, f"{0x80 + self.node:03X}#{little(code, bits=16)}{register:02X}{rest}")

    def told(self, batch: int = 1 << 20) -> "Told":
        """What the whole analysis tells, fed in batches of so many frames."""
        rows = sorted(self.rows, key=lambda row: row[0])
        stream: list[tuple[int, FrameBatch | Gap]] = []
        seq = 0
        edges = [*self.gaps, (float("inf"), float("inf"))]
        for start, end in edges:
            part = [row for row in rows[seq:] if row[0] < end]
            if part:
                frames = FrameBatch.from_rows([_row(row) for row in part])
                for at in range(0, len(part), batch):
                    stream.append((seq + at, frames[at : at + batch]))
                seq += len(part)
            if end != float("inf"):
                gap = Gap(T0 + round(start * MS), T0 + round(end * MS), "adapter lost")
                stream.append((seq, gap))
        facts = CaptureFacts(Path("script.log"), "candump", list(self.buses))
        analysis = analyze(
            stream,
            [facts],
            list(self.buses),
            description=BusDescription.loads(self._description()),
            devices={},
            bitrate=self.bitrate,
        )
        return Told(analysis, self.described)

    def _description(self) -> str:
        text = ""
        if self.device:
            text = f'[node.{self.described}]\ndevice = "{self.device}"\n'
            if self.overrides:
                text += f"[node.{self.described}.overrides]\n{self.overrides}\n"
        return text + self.more


@dataclass
class Told:
    """The analysis, asked as a reader would."""

    analysis: Analysis
    node: int

    @property
    def ids(self) -> list[str]:
        return [finding.id for finding in self.analysis.findings]

    @property
    def accusations(self) -> list[str]:
        """Texts of everything worse than an info; empty on a healthy machine."""
        return [f"{f.id}: {f.text}" for f in self.analysis.findings if f.severity != "info"]

    def findings(self, id: str) -> list[Finding]:
        return [finding for finding in self.analysis.findings if finding.id == id]

    def finding(self, id: str) -> Finding:
        """The only finding of this id."""
        found = self.findings(id)
        assert len(found) == 1, (id, self.text)
        return found[0]

    @property
    def text(self) -> str:
        """Every finding in words."""
        return "\n".join(
            f"{f.severity} {f.id} {f.node}: {f.text} | {f.cause} | {f.check_next}"
            + "".join(f" -> {link.text}" for link in f.chain)
            for f in self.analysis.findings
        )

    @property
    def summary(self) -> str:
        """The text that `syncline analyze` prints."""
        return summary(self.analysis, width=400)

    @property
    def json(self) -> str:
        return to_json(self.analysis)

    def row(self, node: int | None = None) -> NodeRow:
        number = self.node if node is None else node
        return next(row for row in self.analysis.nodes if row.node == number)

    @property
    def nodes(self) -> list[int]:
        return [row.node for row in self.analysis.nodes]

    def states(self, node: int | None = None) -> list[NmtStateRow]:
        number = self.node if node is None else node
        return [row for row in self.analysis.nmt_states if row.node == number]

    def state_names(self, node: int | None = None) -> list[str]:
        return [row.state for row in self.states(node)]

    def state_at(self, ms: float, node: int | None = None) -> NmtStateRow:
        t_ns = T0 + round(ms * MS)
        return next(row for row in self.states(node) if row.start_ns <= t_ns < row.end_ns)

    def trace(self, index: int = 0x6004) -> Trace:
        return next(
            t for t in self.analysis.trace_data if (t.node, t.object >> 8) == (self.node, index)
        )

    def trace_row(self, index: int = 0x6004) -> TraceRow:
        return next(
            t for t in self.analysis.traces if (t.node, t.object >> 8) == (self.node, index)
        )

    def traced(self) -> list[int]:
        return [row.object >> 8 for row in self.analysis.traces]

    def events(self, kind: str, index: int = 0x6004) -> list[TraceEventRow]:
        return [e for e in self.analysis.trace_events if (e.kind, e.object >> 8) == (kind, index)]

    def object(self, index: int, sub: int = 0) -> ObjectRow:
        found = [
            o for o in self.analysis.objects if (o.node, o.index, o.sub) == (self.node, index, sub)
        ]
        assert found, f"{index:04X}h:{sub:02X} is not known"
        return found[-1]

    def sdo(self, index: int, sub: int = 0) -> list[SdoRow]:
        return [row for row in self.analysis.sdo if (row.index, row.sub) == (index, sub)]

    def pdo(self, can_id: int) -> PdoRow:
        return next(row for row in self.analysis.pdos if row.cob_id == can_id)

    @property
    def emcy(self) -> list[EmcyRow]:
        return self.analysis.emcy


def little(*values: int, bits: int = 32) -> str:
    """Values as they stand on the wire, in hexadecimal digits."""
    return "".join((v & (1 << bits) - 1).to_bytes(bits // 8, "little").hex() for v in values)


def says(text: str, *words: str | Iterable[str]) -> bool:
    """Whether all words are in a text (of several, any)."""
    low = text.lower()
    return all(
        word.lower() in low if isinstance(word, str) else any(w.lower() in low for w in word)
        for word in words
    )


def numbered_traps(namespace: dict[str, Any]) -> set[int]:
    """Numbers of the traps that a module tests, by the names of its tests."""
    return {
        int(name.split("_")[2])
        for name in namespace
        if name.startswith("test_trap_") and name.split("_")[2].isdigit()
    }


def _key(index: int, sub: int) -> str:
    return f"{little(index, bits=16)}{sub:02X}"


def _row(row: tuple[float, int, int, int, bytes]) -> tuple[int, int, int, int, int, bytes]:
    at, bus, can_id, flags, data = row
    length = 1 if flags & FrameFlag.REMOTE and not data else len(data)
    return T0 + round(at * MS), bus, can_id, flags, length, data
