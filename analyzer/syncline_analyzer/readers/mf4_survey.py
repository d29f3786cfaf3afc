"""What of an ASAM MDF 4 file stands: which links lead to nothing, which groups of records are described.

Source: ASAM MDF 4.1, "HDBLOCK", "DGBLOCK", "CGBLOCK", "CNBLOCK".
"""

import struct
from dataclasses import field
from typing import Final

from syncline_analyzer.readers.mf4_blocks import HEAD_BYTES, MOST_BLOCKS, Block, Blocks
from syncline_analyzer.readers.mf4_data import Data, data_of
from syncline_schemas.named_tuples import NamedTuple
from syncline_schemas.records import dataclass

_HD: Final = 64
_UNFINISHED: Final = b"UnFinMF "
_FLAGS_AT: Final = 60
_OPEN: Final = 0x1 | 0x4 | 0x10
"""Flags of an unfinished file: counts, the length of the last records, or the last list are not true."""
_MOST_DEPTH: Final = 200
_VLSD: Final = 1
"""Flag of a channel group and type of a channel: values of any length, each after its length."""
_REFERENCES: Final = (3, 4, 6, 7)
"""Links of a channel to what its values can be read without: source, conversion, unit, comment."""


class Group(NamedTuple):
    """A channel group: where its block is, and how long its records are; 0 where each tells.

    Attributes:
        described: whether the fields of its records are.
    """

    at: int
    record_id: int
    cycles: int
    record_bytes: int
    described: bool


class Signal(NamedTuple):
    """A channel whose values of any length are apart from the records.

    Attributes:
        link_at: where the link to them stands in the file.
        byte: of a record at which their place is.
    """

    link_at: int
    byte: int
    data: Data


class Records(NamedTuple):
    """A data group: its channel groups, and the records of all of them.

    Attributes:
        at: of its block.
        id_bytes: bytes before each record that name its group.
    """

    at: int
    id_bytes: int
    data: Data
    groups: dict[int, Group]
    signals: list[Signal]


@dataclass(slots=True)
class Survey:
    """What was found.

    Attributes:
        unfinished: whether the file says that it was not finished.
        dangling: links that lead to what is not there, as (block, number of the link).
        described: whether any data group is.
        undescribed: chains and channel groups whose description is not whole.
    """

    blocks: Blocks
    unfinished: bool = False
    described: bool = False
    dangling: list[tuple[Block, int]] = field(default_factory=list)
    records: list[Records] = field(default_factory=list)
    undescribed: int = 0

    @property
    def whole(self) -> bool:
        """Whether nothing is missing."""
        return not (self.unfinished or self.dangling or self.undescribed) and all(
            each.data.whole and all(signal.data.whole for signal in each.signals)
            for each in self.records
        )


def survey(blocks: Blocks) -> Survey:
    """Walk all that describes the records."""
    return _Walk(blocks).survey()


class _Walk:
    """Every block that describes something is met once."""

    def __init__(self, blocks: Blocks) -> None:
        self._blocks = blocks
        self._found = Survey(blocks)
        self._trees: dict[int, bool] = {}
        self._open_end = 0

    def survey(self) -> Survey:
        blocks, found = self._blocks, self._found
        head = blocks.read(0, _HD)
        found.unfinished = head[:8] == _UNFINISHED
        header = blocks.block(_HD)
        if header is None:
            found.undescribed = 1
            return found
        for number in range(1, 6):
            self._optional(header, number)
        flags = int.from_bytes(head[_FLAGS_AT : _FLAGS_AT + 2], "little")
        self._open_end = blocks.size if found.unfinished and flags & _OPEN else 0
        for group in self._chain(header, 0):
            found.described = True
            self._optional(group, 3)
            found.records.append(self._data_group(group))
        return found

    def _chain(self, before: Block, number: int) -> list[Block]:
        """The blocks that follow one another from a link on; the last link of a cut chain dangles."""
        out: list[Block] = []
        met: set[int] = set()
        while (at := before.link(number)) and at not in met and len(met) < MOST_BLOCKS:
            met.add(at)
            block = self._blocks.block(at)
            if block is None or not block.whole:
                self._found.dangling.append((before, number))
                self._found.undescribed += 1
                break
            out.append(block)
            before, number = block, 0
        return out

    def _data_group(self, block: Block) -> Records:
        id_bytes = (self._blocks.read(block.data_at, 1) or b"\0")[0]
        data = data_of(self._blocks, block.link(2), open_end=self._open_end)
        records = Records(block.at, id_bytes, data, {}, [])
        for each in self._chain(block, 1):
            for number in (2, 3, 4, 5):
                self._optional(each, number)
            raw = self._blocks.read(each.data_at, 32).ljust(32, b"\0")
            record_id, cycles, flags, _, _, size, invalid = struct.unpack("<QQHHIII", raw)
            size = 0 if flags & _VLSD else size + invalid
            described = self._channels(each, 1, records.signals, 0)
            records.groups[record_id] = Group(each.at, record_id, cycles, size, described)
            if not described:
                self._found.dangling.append((each, 1))
                self._found.undescribed += 1
        return records

    def _channels(self, before: Block, number: int, signals: list[Signal], depth: int) -> bool:
        """Whether all channels of a chain, and those that they are made of, are described."""
        met: set[int] = set()
        while (at := before.link(number)) and at not in met and len(met) < MOST_BLOCKS:
            met.add(at)
            channel = self._blocks.block(at)
            if channel is None or not channel.whole or depth > _MOST_DEPTH:
                return False
            if channel.mark != b"##CN":
                return self._tree(at, depth)
            if not self._tree(channel.link(2), depth):
                return False
            for reference in _REFERENCES:
                self._optional(channel, reference)
            if not self._channels(channel, 1, signals, depth + 1):
                return False
            self._signal(channel, signals)
            before, number = channel, 0
        return True

    def _signal(self, channel: Block, signals: list[Signal]) -> None:
        raw = self._blocks.read(channel.data_at, 8)
        target = self._blocks.block(channel.link(5)) if raw[:1] == b"\1" else None
        apart = raw[:1] == b"\1" and channel.link(5)
        if apart and (target is None or target.mark != b"##CG"):
            place = int.from_bytes(raw[4:8], "little")
            data = data_of(self._blocks, channel.link(5))
            signals.append(Signal(channel.at + HEAD_BYTES + 8 * 5, place, data))

    def _optional(self, block: Block, number: int) -> None:
        """Note a link to what a file can be read without, if it leads to what is not whole."""
        if block.link(number) and not self._tree(block.link(number), 0):
            self._found.dangling.append((block, number))

    def _tree(self, at: int, depth: int) -> bool:
        """Whether a block and all that it leads to stand."""
        if not at:
            return True
        if at not in self._trees and len(self._trees) < MOST_BLOCKS:
            self._trees[at] = True
            block = self._blocks.block(at)
            self._trees[at] = (
                block is not None
                and block.whole
                and depth < _MOST_DEPTH
                and all(self._tree(each, depth + 1) for each in block.links)
            )
        return self._trees.get(at, True)
