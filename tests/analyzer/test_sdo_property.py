"""SDO transfers of every kind, encoded here after CiA 301, interleaved, cut and batched at random."""

import random
from binascii import crc_hqx
from dataclasses import dataclass, field, replace

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from syncline_analyzer.results import SdoRow
from tests.analyzer.sdo_builder import Row, fold_table, sdo_frame

Frames = list[tuple[str, bytes]]
"""(">" from the client or "<" from the server, data bytes)."""


@dataclass(frozen=True)
class Script:
    """What happens in one transfer."""

    index: int = 0x2000
    sub: int = 0
    upload: bool = True
    kind: str = "expedited"
    data: bytes = b"\x01"
    sized: bool = True
    crc: bool = True
    block_size: int = 4
    lost: frozenset[int] = frozenset()
    """Positions in the data, in segments, that the receiver misses the first time."""
    switch: bool = False
    """The server answers the request for a block upload with the normal protocol."""
    abort_after: int | None = None
    """Frames after which somebody aborts."""
    abort_side: str = "<"
    short: bool = False
    """Frames are only as long as what they say."""

    @property
    def multiplexer(self) -> bytes:
        return self.index.to_bytes(2, "little") + bytes([self.sub])


@dataclass
class Coded:
    """A script as frames, and what the analyzer is to say of it."""

    script: Script
    frames: Frames = field(default_factory=list)
    result: str = "ok"
    code: int | None = None
    data: bytes = b""
    kind: str = "expedited"


def coded(script: Script) -> Coded:
    """Frames of a transfer, and its expected end."""
    frames = _BY_KIND[script.kind](script)
    made = Coded(script, frames, data=script.data, kind=script.kind)
    if script.switch and script.kind == "block" and script.upload:
        made.kind = "segmented" if len(script.data) > 4 else "expedited"
    at = script.abort_after
    if at is not None and 0 < at < len(frames) and not (at == 1 and script.abort_side == ">"):
        code = 0x08000000 + at
        abort = b"\x80" + script.multiplexer + code.to_bytes(4, "little")
        made.frames = [*frames[:at], (script.abort_side, abort)]
        made.result, made.code = "abort", code
    if not script.short:
        made.frames = [(side, data.ljust(8, b"\0")) for side, data in made.frames]
    return made


def _expedited(s: Script) -> Frames:
    size = len(s.data)
    sized = 3 | (4 - size) << 2 if s.sized else 2
    value = s.data if s.sized else s.data.ljust(4, b"\0")
    if s.upload:
        return [
            (">", b"\x40" + s.multiplexer),
            ("<", bytes([0x40 | sized]) + s.multiplexer + value),
        ]
    return [(">", bytes([0x20 | sized]) + s.multiplexer + value), ("<", b"\x60" + s.multiplexer)]


def _total(s: Script) -> bytes:
    return len(s.data).to_bytes(4, "little") if s.sized else b""


def _segmented(s: Script) -> Frames:
    parts = [s.data[at : at + 7] for at in range(0, len(s.data), 7)] or [b""]
    client, server = (
        (b"\x40", bytes([0x40 | s.sized])) if s.upload else (bytes([0x20 | s.sized]), b"\x60")
    )
    sizes = (b"", _total(s)) if s.upload else (_total(s), b"")
    frames = [(">", client + s.multiplexer + sizes[0]), ("<", server + s.multiplexer + sizes[1])]
    for number, part in enumerate(parts):
        toggle = number % 2 << 4
        last = number == len(parts) - 1
        segment = bytes([toggle | 7 - len(part) << 1 | last]) + part
        if s.upload:
            frames += [(">", bytes([0x60 | toggle])), ("<", segment)]
        else:
            frames += [(">", segment), ("<", bytes([0x20 | toggle]))]
    return frames


def _block(s: Script) -> Frames:
    if s.switch and s.upload:
        normal = _segmented(s) if len(s.data) > 4 else _expedited(s)
        request = bytes([0xA0 | s.crc << 2]) + s.multiplexer + bytes([s.block_size, 100])
        return [(">", request), *normal[1:]]
    sender, receiver = ("<", ">") if s.upload else (">", "<")
    offer = bytes([0xC0 | s.crc << 2 | s.sized << 1]) + s.multiplexer + _total(s)
    ask = bytes([0xA0 | s.crc << 2]) + s.multiplexer + bytes([s.block_size])
    frames = [(receiver, ask), (sender, offer)] if s.upload else [(sender, offer), (receiver, ask)]
    frames += [(">", b"\xa3")] if s.upload else []
    parts = [s.data[at : at + 7] for at in range(0, len(s.data), 7)]
    at, lost = 0, set(s.lost)
    while at < len(parts):
        sent = parts[at : at + s.block_size]
        good = len(sent)
        for number, part in enumerate(sent, 1):
            last = at + number == len(parts)
            frames.append((sender, bytes([number | last << 7]) + part.ljust(7, b"\0")))
            if at + number - 1 in lost and good == len(sent):
                good = number - 1
        lost -= set(range(at, at + len(sent)))
        frames.append((receiver, bytes([0xA2, good, s.block_size])))
        at += good
    crc = crc_hqx(s.data, 0) if s.crc else 0
    end = bytes([0xC1 | 7 - len(parts[-1]) << 2]) + crc.to_bytes(2, "little")
    return [*frames, (sender, end), (receiver, b"\xa1")]


_BY_KIND = {"expedited": _expedited, "segmented": _segmented, "block": _block}


@st.composite
def scripts(draw: st.DrawFn) -> Script:
    kind = draw(st.sampled_from(["expedited", "segmented", "block"]))
    sized = draw(st.booleans())
    longest = {"expedited": 4, "segmented": 40, "block": 130}[kind]
    shortest = 4 if kind == "expedited" and not sized else kind != "segmented"
    data = draw(st.binary(min_size=int(shortest), max_size=longest))
    return Script(
        index=draw(st.integers(0x2000, 0x9FFF)),
        sub=draw(st.integers(0, 255)),
        upload=draw(st.booleans()),
        kind=kind,
        data=data,
        sized=sized,
        crc=draw(st.booleans()),
        block_size=draw(st.integers(1, 9)),
        lost=draw(st.frozensets(st.integers(0, 18), max_size=2)),
        switch=draw(st.booleans()) and (len(data) > 4 or sized or len(data) == 4),
        abort_after=draw(st.none() | st.integers(1, 30)),
        abort_side=draw(st.sampled_from("<>")),
        short=draw(st.booleans()) and kind != "block",
    )


def _interleaved(
    transfers: list[tuple[int, Coded]], seed: int
) -> tuple[list[Row], list[tuple[int, Coded, list[int]]]]:
    """Frames of all nodes, each node's in order; and every transfer with its frames' `seq`."""
    source = random.Random(seed)
    queues: dict[int, list[tuple[int, str, bytes]]] = {}
    for number, (node, made) in enumerate(transfers):
        queues.setdefault(node, []).extend((number, side, data) for side, data in made.frames)
    rows: list[Row] = []
    seqs: dict[int, list[int]] = {}
    while any(queues.values()):
        node = source.choice([node for node, queue in queues.items() if queue])
        number, side, data = queues[node].pop(0)
        seqs.setdefault(number, []).append(len(rows))
        rows.append(sdo_frame(len(rows) * 500, side, node, data))
    return rows, [(node, made, seqs[n]) for n, (node, made) in enumerate(transfers)]


def said(row: SdoRow) -> tuple[object, ...]:
    return (row.node, row.seq, row.end_seq, row.index, row.sub, row.direction, row.result,
            row.abort_code)  # fmt: skip


def expected(node: int, made: Coded, seqs: list[int], first: int = 0) -> tuple[object, ...]:
    script = made.script
    direction = "upload" if script.upload else "download"
    return (node, seqs[0] - first, seqs[-1] - first, script.index, script.sub, direction,
            made.result, made.code)  # fmt: skip


def check_payload(row: SdoRow, made: Coded) -> None:
    if made.result != "ok":
        return
    assert row.kind == made.kind
    assert row.data == made.data
    if made.script.sized or made.kind != "expedited":
        assert row.size == len(made.data)
    checked = made.kind == "block" and made.script.crc
    assert row.crc_ok is (True if checked else None)


TRANSFERS = st.lists(st.tuples(st.integers(1, 4), scripts().map(coded)), min_size=1, max_size=8)


@given(TRANSFERS, st.integers(0, 2**32))
@settings(max_examples=120, deadline=None)
def test_every_transfer_is_a_row_with_its_payload(
    transfers: list[tuple[int, Coded]], seed: int
) -> None:
    rows, placed = _interleaved(transfers, seed)
    found = fold_table(rows).rows
    wanted = sorted(placed, key=lambda entry: entry[2][0])
    assert [said(row) for row in found] == [expected(*entry) for entry in wanted]
    for row, (_, made, _) in zip(found, wanted, strict=True):
        check_payload(row, made)


@given(TRANSFERS, st.integers(0, 2**32), st.data())
@settings(max_examples=80, deadline=None)
def test_a_capture_cut_anywhere_keeps_the_whole_transfers_and_invents_none(
    transfers: list[tuple[int, Coded]], seed: int, data: st.DataObject
) -> None:
    rows, placed = _interleaved(transfers, seed)
    first = data.draw(st.integers(0, len(rows) - 1))
    stop = data.draw(st.integers(first + 1, len(rows)))
    batch = data.draw(st.integers(1, 9))
    found = fold_table(rows[first:stop]).rows
    assert fold_table(rows[first:stop], batch=batch).rows == found
    by_key = {(row.node, row.seq): row for row in found}
    for node, made, seqs in placed:
        row = by_key.pop((node, seqs[0] - first), None)
        if first <= seqs[0] and seqs[-1] < stop:
            assert row is not None
            assert said(row) == expected(node, made, seqs, first)
            check_payload(row, made)
        elif first <= seqs[0] < stop:
            assert row is not None
            assert row.result == "interrupted"
    assert {row.result for row in by_key.values()} <= {"no answer", "interrupted"}


@given(TRANSFERS, st.integers(0, 2**32), st.data())
@settings(max_examples=80, deadline=None)
def test_frames_that_are_missing_never_give_wrong_data(
    transfers: list[tuple[int, Coded]], seed: int, data: st.DataObject
) -> None:
    """A recorder that loses frames: a value is the one that was sent, or it is left open.

    Two segments that are lost with their answers leave no trace where no size was announced.
    """
    rows, placed = _interleaved(transfers, seed)
    lost = data.draw(st.sets(st.integers(0, len(rows) - 1), max_size=4))
    kept = [row for number, row in enumerate(rows) if number not in lost]
    sent = {(made.script.index, made.script.sub): made.script for _, made, _ in placed}
    if len(sent) < len(placed):
        return
    for row in fold_table(kept).rows:
        script = sent.get((row.index or 0, row.sub or 0))
        assert row.crc_ok is not False or (script is not None and not script.sized)
        sure = script is not None and (script.sized or row.crc_ok)
        if sure and script is not None and row.result == "ok" and row.value is not None:
            assert row.data == script.data


@pytest.mark.parametrize("side", "<>")
@pytest.mark.parametrize("upload", [True, False])
def test_every_phase_of_a_block_transfer_can_be_aborted(side: str, upload: bool) -> None:
    script = Script(kind="block", upload=upload, data=bytes(range(40)), lost=frozenset({2}))
    for at in range(2, len(coded(script).frames)):
        made = coded(replace(script, abort_after=at, abort_side=side))
        rows, _ = _interleaved([(5, made)], 0)
        (row,) = fold_table(rows).rows
        assert (row.result, row.abort_code, row.abort_by) == (
            "abort", made.code, "client" if side == ">" else "server",
        )  # fmt: skip


COMMANDS = [
    0x00, 0x01, 0x10, 0x11, 0x1D, 0x20, 0x21, 0x22, 0x23, 0x2F, 0x30, 0x40, 0x41, 0x42, 0x43, 0x4F,
    0x60, 0x70, 0x80, 0x81, 0x82, 0x83, 0xA0, 0xA1, 0xA2, 0xA3, 0xA4, 0xC0, 0xC1, 0xC2, 0xC4, 0xC6,
]  # fmt: skip


@st.composite
def likely_frames(draw: st.DrawFn) -> tuple[str, int, bytes]:
    """Frames that fit together more often than chance: three objects, cut short at times."""
    named = draw(st.sampled_from([b"\x00\x20\x00", b"\x01\x20\x00", b"\x00\x12\x01"]))
    rest = draw(st.sampled_from([bytes(4), b"\x08\0\0\0", b"\x02\x03\0\0", b"\x42\x06\0\0"]))
    data = bytes([draw(st.sampled_from(COMMANDS))]) + named + rest
    length = draw(st.sampled_from([8, 8, 8, 8, 7, 5, 4, 3, 1, 0]))
    return draw(st.sampled_from("<>")), draw(st.sampled_from([5, 0x42])), data[:length]


@given(st.lists(likely_frames(), max_size=60), st.integers(1, 7), st.booleans())
@settings(max_examples=200, deadline=None)
def test_no_sequence_of_frames_raises_and_batches_do_not_matter(
    frames: list[tuple[str, int, bytes]], batch: int, timed: bool
) -> None:
    rows = [
        sdo_frame(number * 700 * timed, side, node, data)
        for number, (side, node, data) in enumerate(frames)
    ]
    whole, parts = fold_table(rows, timed=timed), fold_table(rows, timed=timed, batch=batch)
    assert whole.rows == parts.rows
    assert whole.strays == parts.strays
    for row in whole.rows:
        assert row.end_ns >= row.start_ns
        assert (row.result == "abort") == (row.abort_by is not None)
    assert len({row.seq for row in whole.rows}) == len(whole.rows)
