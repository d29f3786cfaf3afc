"""Plain SDO transfers taken in as columns: the same as every frame through the state machine."""

import random
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from syncline_analyzer.context import Context
from syncline_analyzer.fold import IndexedBatch
from syncline_analyzer.folds.sdo.fold import Reset, SdoFold, SdoTable
from syncline_analyzer.folds.sdo.pairs import SdoFrames
from syncline_analyzer.folds.sdo.values import known_value, known_values
from syncline_analyzer.object_history import Known
from syncline_analyzer.reads import Reads, raw_of
from syncline_analyzer.shadow import Shadow
from syncline_schemas.batch import FrameBatch
from syncline_schemas.canopen.datatypes import DATA_TYPES
from syncline_schemas.devices import Device, load_device
from tests.analyzer.sdo_builder import Row, sdo_frame

BUSES = ["can0", "can1"]
NODES = (5, 6)
USUAL = {
    (0x1000, 0): 0x10196, (0x1008, 0): int.from_bytes(b"L918", "little"), (0x1015, 0): 100,
    (0x1010, 1): int.from_bytes(b"save", "little"), (0x1011, 1): int.from_bytes(b"load", "little"),
    (0x1018, 2): 0xD0001, (0x1200, 1): 0x605, (0x1800, 1): 0x185, (0x2002, 0): 1, (0x2040, 0): 3,
    (0x2041, 0): 3, (0x207F, 0): 1, (0x6000, 0): 4, (0x6004, 0): 0xFFFFFFFE, (0x6010, 0): 2,
    (0x6200, 0): 50, (0x6509, 0): 0xFFFFFFFF,
}  # fmt: skip
"""The value that each object mostly has, so that it repeats: orders, identities, positions ..."""
OBJECTS = tuple(USUAL)
VALUES = (0, 1, 5, 0x615, 0x40000185, 0xFFFFFFFF, int.from_bytes(b"L158", "little"), 0x4019A)
"""Those that it has at times."""
NO_PAIRS = np.zeros(0, np.intp), np.zeros(0, np.intp)


@dataclass(frozen=True)
class Run:
    """What the fold and the shadow made of frames."""

    table: SdoTable
    shadow: Shadow
    reads: list[list[list[int]]]
    """Repeated reads of positions, as they were taken after each batch."""


def traffic(source: random.Random, count: int) -> Iterator[Row]:
    """Transfers of a few objects by several nodes: plain, refused, without answer, cut, in pieces."""
    t_us = 0.0
    objects = source.sample(OBJECTS, source.choice([3, 6, len(OBJECTS)]))
    for _ in range(count):
        node, bus = source.choice(NODES), source.choice([0, 0, 0, 1])
        index, sub = source.choice(objects)
        name = index.to_bytes(2, "little") + bytes([sub])
        often = source.random() < 0.75
        value = (USUAL[index, sub] if often else source.choice(VALUES)).to_bytes(4, "little")
        size = 0x43 if often else source.choice([0x43, 0x47, 0x4B, 0x4F, 0x42])
        ask, answer = b"\x40" + name + bytes(4), bytes([size]) + name + value
        match source.choice("rrrrrrrrrrrwwwanclssd"):
            case "r":
                sent = [(">", ask), ("<", answer)]
            case "w":
                sent = [
                    (">", bytes([size - 0x20]) + name + value),
                    ("<", b"\x60" + name + bytes(4)),
                ]
            case "a":
                code = source.choice([0x06020000, 0x06010002]).to_bytes(4, "little")
                sent = [(">", ask), ("<", b"\x80" + name + code)]
            case "n":
                sent = [(">", ask)]
            case "c":
                sent = [(">", ask), ("<", answer[: source.choice([0, 3, 7])])]
            case "l":
                sent = [("<", answer)]
            case "d":
                sent = [(">", ask), (">", ask), ("<", answer), ("<", answer)]
            case _:
                value = source.choice(VALUES).to_bytes(4, "little")
                sent = [(">", ask), ("<", b"\x41" + name + b"\x08\0\0\0"), (">", b"\x60" + bytes(7)),
                        ("<", b"\0" + value + b"abc"), (">", b"\x70" + bytes(7)),
                        ("<", b"\x1dd" + bytes(6))]  # fmt: skip
        for side, data in sent:
            t_us += source.choice([300, 700, 60_000])
            moved = source.random() < 0.02
            yield sdo_frame(t_us, side, source.choice((0x15, 7)) if moved else node, data, bus=bus)


def run(rows: list[Row], batch: int, resets: list[Reset], devices: dict[int, Device]) -> Run:
    shadow = Shadow(lambda number: BUSES[number], None, devices)
    fold = SdoFold(Context(BUSES, shadow))
    reads = []
    for start in range(0, len(rows), batch):
        frames = FrameBatch.from_rows(rows[start : start + batch])
        fold.update(
            IndexedBatch(frames, start), [r for r in resets if start <= r.seq < start + batch]
        )
        taken = [
            shadow.take_rereads(bus, node, *key, start + batch)
            for bus in (0, 1)
            for node in NODES
            for key in OBJECTS
        ]
        reads += [[each.seq.tolist(), each.t_ns.tolist(), each.raw.tolist()] for each in taken]
    return Run(fold.finish(rows[-1][0] + 10**9), shadow, reads)


def singly(*args: Any) -> Run:
    """The same with every frame through the state machine."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(SdoFrames, "pairs", lambda self: NO_PAIRS)
        return run(*args)


def known_of(shadow: Shadow) -> dict[Any, Any]:
    places = sorted(shadow.nodes())
    return {
        place: (
            list(shadow.history(*place)),
            shadow.identity(*place),
            [shadow.read_again(*place, *key) for key in OBJECTS],
            [shadow.is_refused(*place, *key) for key in OBJECTS],
            device.name if (device := shadow.device(*place)) else None,
        )
        for place in places
    }


def odd_device() -> Device:
    """A device on which one object may concern others in every way that a maker may say."""
    device = load_device("jn2100", ())
    odd = replace(
        device.quirks,
        aliases={(0x2040, 0): (0x2041, 0)},
        reset_writes={(0x2002, 0): 1},
        factory_reset_writes={(0x207F, 0): 1},
        side_effects=(((0x6000, 0), (0x6509, 0), 0),),
        stored_at_once=((0x6010, 0),),
        pdo_cob_id_mask=0x80000000,
    )
    return replace(device, quirks=odd)


DEVICES: tuple[dict[int, Device], ...] = (
    {},
    {5: odd_device(), 6: odd_device()},
    {5: load_device("lir-da158", ()), 6: odd_device()},
)


@given(
    st.integers(0, 2**32),
    st.integers(1, 250),
    st.sampled_from([7, 40, 1000]),
    st.lists(st.integers(0, 200), max_size=3),
    st.sampled_from(DEVICES),
)
@settings(max_examples=150, deadline=None, suppress_health_check=[HealthCheck.too_slow])
def test_columns_and_frames_one_by_one_agree(
    seed: int, count: int, batch: int, at: list[int], devices: dict[int, Device]
) -> None:
    rows = list(traffic(random.Random(seed), count))
    resets = [
        Reset(seq, rows[seq][0], 0, 5 if seq % 2 else 0, 0x81) for seq in sorted(set(at))
        if seq < len(rows)
    ]  # fmt: skip
    one, other = run(rows, batch, resets, devices), singly(rows, batch, resets, devices)
    assert list(one.table.rows) == list(other.table.rows)
    for name in ("toggle_errors", "repeated", "ended_by"):
        assert one.table.rows.records[name].tolist() == other.table.rows.records[name].tolist()
    assert one.table.counts == other.table.counts
    assert one.table.strays == other.table.strays
    odd, odder = ({k: [(o.kind, o.seq, o.asked.seq, o.since_ns, o.named, o.differs) for o in v]
                   for k, v in each.table.oddities.items()} for each in (one, other))  # fmt: skip
    assert odd == odder
    assert known_of(one.shadow) == known_of(other.shadow)
    assert one.reads == other.reads


@pytest.mark.parametrize("index", [0x1018, 0x2000])
def test_a_read_in_pieces_between_two_equal_ones(index: int) -> None:
    """An object of the identity, which is looked at one by one, and one that is not."""
    name = index.to_bytes(2, "little") + b"\2"
    plain = [(">", b"\x40" + name + bytes(4)), ("<", b"\x43" + name + b"\7\0\0\0")]
    pieces = [
        (">", b"\x40" + name + bytes(4)),
        ("<", b"\x41" + name + b"\4\0\0\0"),
        (">", b"\x60" + bytes(7)),
        ("<", b"\x07\x08" + bytes(6)),
    ]
    sent = [*plain, *plain, *pieces, *plain, *plain]
    rows = [sdo_frame(t_us, side, 5, data) for t_us, (side, data) in enumerate(sent)]
    shadow = run(rows, 1000, [], {5: load_device("jn2100", ())}).shadow
    changes = shadow.spans(0, 5, index, 2)
    assert [span.change.known and span.change.known.value for span in changes] == [7, 8, 7]
    assert [span.change.seq for span in changes] == [1, 7, 9]


def test_that_traffic_is_taken_in_both_ways(monkeypatch: pytest.MonkeyPatch) -> None:
    """The property above means something: the pairs are found, and left out where they are hidden."""
    found = []
    plain = SdoFrames.plain

    def counted(self: SdoFrames) -> Any:
        found.append(len(plain(self)))
        return plain(self)

    monkeypatch.setattr(SdoFrames, "plain", counted)
    rows = list(traffic(random.Random(1), 300))
    run(rows, 1000, [], {})
    singly(rows, 1000, [], {})
    assert max(found) > 60
    assert 0 in found


@given(
    st.sampled_from([*DATA_TYPES, None]),
    st.lists(st.tuples(st.integers(0, 2**32 - 1), st.integers(0, 4)), min_size=1, max_size=9),
)
def test_values_of_many_are_those_of_each(code: int | None, held: list[tuple[int, int]]) -> None:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("syncline_analyzer.folds.sdo.values.type_code", lambda *_: code)
        kept = [word & ((1 << 8 * size) - 1 if size else 0xFFFFFFFF) for word, size in held]
        size = np.array([each for _, each in held], np.uint8)
        values = known_values(None, 0x2000, 0, np.array(kept, np.uint32), size).tolist()
        data = [w.to_bytes(4, "little")[: s or 4] for w, (_, s) in zip(kept, held, strict=True)]
        assert values == [known_value(None, 0x2000, 0, each) for each in data]


@given(st.lists(st.integers(0, 5), max_size=60), st.lists(st.integers(1, 9), max_size=12))
def test_a_history_that_grows_in_pieces(values: list[int], cuts: list[int]) -> None:
    """The older half goes at the same change, whether they come one by one or many at once."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("syncline_analyzer.object_history.MAX_CHANGES", 8)
        shadow, other = (Shadow(lambda number: BUSES[number]) for _ in range(2))
        begin = 0
        for step in [*cuts, 60]:
            part = values[begin : begin + step]
            seqs = np.arange(begin, begin + len(part))
            if part:
                read = np.array([value != 5 for value in part])
                shadow.learn_columns(0, 5, (0x2000, 0), np.array(part), read, seqs, seqs * 10)
            for seq, value in zip(seqs.tolist(), part, strict=True):
                source = "sdo-read" if value != 5 else "sdo-write"
                other.learn(0, 5, 0x2000, 0, Known(value, source, seq, seq * 10))  # type: ignore[arg-type]
            begin += step
        assert list(shadow.history(0, 5)) == list(other.history(0, 5))


def test_reads_are_taken_up_to_a_frame() -> None:
    shadow = Shadow(lambda number: BUSES[number])
    told = [Known(7, "sdo-read", seq, seq * 10) for seq in range(6)]
    shadow.confirm(0, 5, (0x6004, 0), Reads.of(*told[3:]))
    shadow.confirm(0, 5, (0x6004, 0), Reads.of(*told[:3]))
    first = shadow.take_rereads(0, 5, 0x6004, 0, 1)
    rest = shadow.take_rereads(0, 5, 0x6004, 0, 9)
    assert (first.seq.tolist(), rest.seq.tolist()) == ([0, 1], [2, 3, 4, 5])
    assert (first.t_ns.tolist(), first.raw.tolist()) == ([0, 10], [7, 7])
    assert len(shadow.take_rereads(0, 5, 0x6004, 0, 9)) == 0


def test_raw_values_are_the_low_32_bits() -> None:
    assert [raw_of(value) for value in (-1, 1 << 40 | 3, b"\1\2\0\0\5", b"")] == [
        0xFFFFFFFF, 3, 0x201, 0,
    ]  # fmt: skip
