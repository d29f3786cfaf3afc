"""Identifiers whose payload was dropped: what the frames hold then, and what they still tell.

A redacted frame keeps its time, identifier, flags and length; its data bytes are zero. That zeros
stand there and no message is written in the metadata of the capture, so that nobody reads a
heartbeat of zeros as a boot-up.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, Any, Self

import numpy as np
from numpy.typing import NDArray

from syncline_schemas.batch import FrameBatch, FrameFlag, Gap
from syncline_schemas.canopen.services import SERVICE_OF_ID, Service
from syncline_schemas.errors import UsageError
from syncline_schemas.records import dataclass

if TYPE_CHECKING:
    from syncline_analyzer.results import Analysis, Finding

REDACTED_KEY = "redacted"
"""Key of the capture's metadata record."""

_NOTE = ("the payload of ", " was dropped before this analysis (redacted)")
_RANGE = re.compile(r"(?:0x)?([0-9a-f]{1,8})h?(?:-(?:0x)?([0-9a-f]{1,8})h?)?", re.IGNORECASE)
_NODE = re.compile(r"node[ :=]?(\d{1,3})", re.IGNORECASE)
_LAST_ID = 0x1FFFFFFF


@dataclass(frozen=True, slots=True)
class Redaction:
    """Identifiers by inclusive ranges, 11-bit and 29-bit ones alike, and whole nodes."""

    ranges: tuple[tuple[int, int], ...] = ()
    nodes: tuple[int, ...] = ()

    @classmethod
    def parse(cls, texts: Iterable[str]) -> Self:
        """From "18A", "0x180-0x1FF", "node:5", each of which may be several with commas.

        >>> Redaction.parse(["18A,200-27F", "node:5"])
        Redaction(ranges=((394, 394), (512, 639)), nodes=(5,))

        Raises:
            UsageError: a text is none of these.
        """
        ranges, nodes = [], []
        for part in (part.strip() for text in texts for part in text.split(",")):
            node, ids = _NODE.fullmatch(part), _RANGE.fullmatch(part)
            if node and 1 <= int(node[1]) <= 127:
                nodes.append(int(node[1]))
            elif (
                ids and (low := int(ids[1], 16)) <= (high := int(ids[2] or ids[1], 16)) <= _LAST_ID
            ):
                ranges.append((low, high))
            else:
                raise UsageError(
                    f"--redact {part!r}: write identifiers in hexadecimal digits as 18A or 180-1FF,"
                    " or a node as node:5"
                )
        return cls(tuple(ranges), tuple(nodes))

    @classmethod
    def of_metadata(cls, records: Iterable[Mapping[str, str]]) -> Self:
        """What the metadata of captures says was redacted; nothing for a text that is none."""
        texts = [record[REDACTED_KEY] for record in records if record.get(REDACTED_KEY)]
        try:
            return cls.parse(texts)
        except UsageError:
            return cls()

    @classmethod
    def of_analysis(cls, analysis: Analysis) -> Self:
        """What an analysis says of its capture's redaction."""
        texts = [
            note.removeprefix(_NOTE[0]).removesuffix(_NOTE[1])
            for note in analysis.capture.notes
            if note.startswith(_NOTE[0]) and note.endswith(_NOTE[1])
        ]
        return cls.of_metadata([{REDACTED_KEY: text} for text in texts])

    def __bool__(self) -> bool:
        return bool(self.ranges or self.nodes)

    @property
    def text(self) -> str:
        """The identifiers as `parse` takes them, sorted; nodes must have been resolved."""
        return ",".join(
            f"{low:X}" if low == high else f"{low:X}-{high:X}" for low, high in sorted(self.ranges)
        )

    def resolved(self, moved: Mapping[int, Iterable[int]]) -> Redaction:
        """Nodes as their identifiers: the predefined ones, and what they or the master moved.

        moved: by node, further identifiers on which it sends or is spoken to.
        """
        found = set(self.ranges)
        for node in self.nodes:
            usual = (base + node for base in range(0x80, 0x781, 0x80) if base != 0x780)
            found |= {(number, number) for number in (*usual, *moved.get(node, ()))}
        return Redaction(tuple(sorted(found)))

    def covers(self, batch: FrameBatch) -> NDArray[np.bool_]:
        """(n,) whether each frame is redacted; error frames are nobody's message."""
        found = np.zeros(len(batch), np.bool_)
        for low, high in self.ranges:
            found |= (batch.can_id >= low) & (batch.can_id <= high)
        found &= (batch.flags & FrameFlag.ERROR) == 0
        return found

    def contains(self, can_id: int) -> bool:
        """Whether an identifier is redacted."""
        return any(low <= can_id <= high for low, high in self.ranges)

    def applied(self, batch: FrameBatch) -> FrameBatch:
        """The batch without the payload of the chosen frames."""
        rows = self.covers(batch)
        if not rows.any():
            return batch
        return replace(batch, data=np.where(rows[:, np.newaxis], np.uint8(0), batch.data))


class Veil:
    """Between a redacted capture and its analysis: zeros must not be taken for messages."""

    def __init__(self, redaction: Redaction) -> None:
        self._redaction = redaction
        self._hidden = 0

    def over(
        self, items: Iterable[tuple[int, FrameBatch | Gap]]
    ) -> Iterable[tuple[int, FrameBatch | Gap]]:
        """Numbered batches as the analyses may see them."""
        if not self._redaction:
            return items
        return (
            (seq, self.hidden(item) if isinstance(item, FrameBatch) else item)
            for seq, item in items
        )

    def hidden(self, batch: FrameBatch) -> FrameBatch:
        """The batch as the analyses may see it: only PDOs still are what they were, without values.

        Any other service without its payload becomes a 29-bit frame, which is no service.
        """
        batch = self._redaction.applied(batch)
        service = SERVICE_OF_ID[np.minimum(batch.can_id, 0x7FF)]
        rows = self._redaction.covers(batch) & (service != Service.PDO)
        rows &= (batch.flags & (FrameFlag.EXTENDED | FrameFlag.REMOTE)) == 0
        self._hidden += int(np.count_nonzero(rows))
        extended = batch.flags | np.uint16(FrameFlag.EXTENDED)
        return replace(batch, flags=np.where(rows, extended, batch.flags))

    def lifted(self, analysis: Analysis) -> Analysis:
        """The analysis, of the frames as they are, without what zeros seem to tell."""
        if not self._redaction:
            return analysis
        told = without_values(analysis, self._redaction)
        extended = told.capture.extended_frames - self._hidden
        return replace(told, capture=replace(told.capture, extended_frames=extended))


def without_values(analysis: Analysis, redaction: Redaction) -> Analysis:
    """The analysis without what zeros in place of values seem to tell."""
    sensors = {
        (row.bus, row.node)
        for row in analysis.pdos
        if row.node is not None and redaction.contains(row.cob_id)
    }
    told: dict[str, Any] = {
        name: [row for row in getattr(analysis, name) if (row.bus, row.node) not in sensors]
        for name in ("traces", "trace_data", "trace_events", "tilts", "tilt_data")
    }
    twins: dict[str, Any] = {
        name: [
            row
            for row in getattr(analysis, name)
            if not sensors & {(row.bus, row.node), (getattr(row, "other_bus", row.bus), row.other)}
        ]
        for name in ("shafts", "shaft_data", "followers")
    }
    findings = [
        finding
        for finding in analysis.findings
        if not _rests_on_payload(finding, redaction, (finding.bus, finding.node) in sensors)
    ]
    note = f"{_NOTE[0]}{redaction.text}{_NOTE[1]}"
    capture = replace(analysis.capture, notes=[*analysis.capture.notes, note])
    context = [replace(row, values={}) for row in analysis.emcy_context]
    return replace(
        analysis, capture=capture, findings=findings, emcy_context=context, **told, **twins
    )


def _rests_on_payload(finding: Finding, redaction: Redaction, sensor: bool) -> bool:
    """Whether a finding may come of values, states or NMT commands that are not there."""
    family = finding.id.partition(".")[0]
    states = (0x000, *((0x700 + finding.node, 0x080 + finding.node) if finding.node else ()))
    if family in ("nmt", "pdo") and any(redaction.contains(can_id) for can_id in states):
        return True
    return sensor and family in ("angle", "device")
