"""The whole analysis over frames and gaps that a test wrote down."""

from collections.abc import Iterable, Iterator
from math import ceil
from pathlib import Path

from syncline_analyzer.capture import CaptureFacts, TimeBase
from syncline_analyzer.engine import analyze
from syncline_analyzer.results import Analysis, Finding
from syncline_schemas.batch import FrameBatch, FrameFlag, Gap
from syncline_schemas.description import BusDescription
from tests.analyzer.control_runs import MS, Row

T0 = 1_790_000_000_000_000_000
"""2026-09-21T14:13:20Z, where the frames of a dated run begin."""
ERROR = int(FrameFlag.ERROR)


def error(t_ms: float, classes: int, *, bus: int = 0, **places: int) -> Row:
    """An error frame; its data bytes by place: d0 ... d7."""
    data = bytearray(8)
    for place, value in places.items():
        data[int(place[1])] = value
    return (round(t_ms * MS), bus, classes, ERROR, 8, bytes(data))


def beats(
    node: int, start_ms: float, stop_ms: float, every_ms: float = 100, *, bus: int = 0
) -> list[Row]:
    """Heartbeats of an OPERATIONAL node."""
    count = ceil((stop_ms - start_ms) / every_ms)
    return [
        (round((start_ms + k * every_ms) * MS), bus, 0x700 + node, 0, 1, b"\x05")
        for k in range(count)
    ]


def every(
    can_id: int, start_ms: float, stop_ms: float, step_ms: float, data: bytes = b""
) -> list[Row]:
    """A frame again and again."""
    count = ceil((stop_ms - start_ms) / step_ms)
    return [
        (round((start_ms + k * step_ms) * MS), 0, can_id, 0, len(data), data) for k in range(count)
    ]


def write(t_ms: float, node: int, index: int, sub: int, value: int, size: int = 4) -> list[Row]:
    """An expedited download and its confirmation (CiA 301 7.2.4.3.3)."""
    head = bytes([0x23 | (4 - size) << 2]) + index.to_bytes(2, "little") + bytes([sub])
    request = head + value.to_bytes(size, "little").ljust(4, b"\0")
    answer = bytes([0x60]) + head[1:] + bytes(4)
    return [
        (round(t_ms * MS), 0, 0x600 + node, 0, 8, request),
        (round((t_ms + 1) * MS), 0, 0x580 + node, 0, 8, answer),
    ]


def whole(
    *parts: Iterable[Row] | Gap,
    in_order: bool = True,
    base: TimeBase = "utc",
    bitrate: int | None = 500_000,
    buses: tuple[str, ...] = ("can0",),
    description: BusDescription | None = None,
    damage: str | None = None,
    unparsed: int = 0,
    batch: int = 10_000,
    resolution_ns: int = 1,
) -> Analysis:
    """The analysis of frames given in ms from the start; rows are put in order of time."""
    rows = [row for part in parts if not isinstance(part, Gap) for row in part]
    if in_order:
        rows.sort(key=lambda row: row[0])
    gaps = sorted((p for p in parts if isinstance(p, Gap)), key=lambda gap: gap.end_ns)
    origin = T0 if base == "utc" else 0
    facts = CaptureFacts(Path("run.log"), "test", list(buses), base)
    facts.damage, facts.unparsed_count = damage, unparsed
    facts.resolution_ns = resolution_ns
    return analyze(
        _stream(rows, gaps, origin, batch),
        [facts],
        list(buses),
        description=description or BusDescription(),
        devices={},
        bitrate=bitrate,
    )


def _stream(
    rows: list[Row], gaps: list[Gap], origin: int, batch: int
) -> Iterator[tuple[int, FrameBatch | Gap]]:
    seq, at = 0, 0
    moved = [(t_ns + origin, *rest) for t_ns, *rest in rows]
    for gap in [*gaps, None]:
        stop = len(rows)
        if gap is not None:
            stop = next((k for k, row in enumerate(rows) if row[0] >= gap.end_ns), len(rows))
        while at < stop:
            end = min(at + batch, stop)
            piece = FrameBatch.from_rows(moved[at:end])  # type: ignore[arg-type]
            yield seq, piece
            seq += len(piece)
            at = end
        if gap is not None:
            yield (
                seq,
                Gap(
                    gap.start_ns + origin,
                    gap.end_ns + origin,
                    gap.reason,
                    gap.lost_frames,
                    gap.bus,
                ),
            )


def found(analysis: Analysis, rule_id: str) -> list[Finding]:
    """Findings of one rule."""
    return [finding for finding in analysis.findings if finding.id == rule_id]


def ids(analysis: Analysis) -> set[str]:
    """Ids of all findings and of the links of their stories."""
    told = {finding.id for finding in analysis.findings}
    return told | {link.id for finding in analysis.findings for link in finding.chain}


def severe(analysis: Analysis) -> list[str]:
    """Texts of findings that say something is wrong."""
    return [f"{f.id}: {f.text}" for f in analysis.findings if f.severity != "info"]
