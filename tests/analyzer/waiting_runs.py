"""Whole runs of a bus with a script of who wants to send when; arbitration makes the rest."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from syncline_analyzer.results import Analysis, LatenessRow
from syncline_schemas.batch import FrameBatch
from syncline_schemas.wire_length import wire_bits
from tests.analyzer.arbitration_model import Line, Request
from tests.analyzer.control_runs import Row
from tests.analyzer.whole_run import beats, whole, write

MS = 1_000_000
US = 1_000
START = 1_000 * MS
PERIOD = 10 * MS
BITRATE = 500_000
BIT_NS = 2000


@dataclass(frozen=True, slots=True)
class Wish:
    """A frame that a node wants to send so long after the start of the SYNCs."""

    at_ns: int
    can_id: int
    node: int
    data: bytes = bytes(8)


def syncs(count: int) -> list[Wish]:
    return [Wish(k * PERIOD, 0x80, 0, b"") for k in range(count)]


def answers(count: int, can_id: int, node: int, after_us: int = 300) -> list[Wish]:
    """A PDO that its device has ready so long after each SYNC (jitter of 20 us)."""
    jitter = np.random.default_rng(node).integers(0, 20, count)
    ends = 94 * US
    return [
        Wish(k * PERIOD + ends + (after_us + int(jitter[k])) * US, can_id, node)
        for k in range(count)
    ]


def burst(number: int, can_ids: Iterable[int], node: int, after_us: int = 150) -> list[Wish]:
    """Frames that a node wants to send all at once after one SYNC."""
    at_ns = number * PERIOD + 94 * US + after_us * US
    return [Wish(at_ns + place, can_id, node) for place, can_id in enumerate(can_ids)]


def sent_rows(wishes: Sequence[Wish], step_ns: int = 1000, noise_us: float = 0.0) -> list[Row]:
    """What a recorder with stamps of this step takes of them, in the order of the wire.

    Its stamps come late by `noise_us` on average, but never before those of the frames before.
    """
    late = np.random.default_rng(5).exponential(noise_us * US, len(wishes)).astype(np.int64)
    last_ns = 0
    frames = [(0, 0, w.can_id, 0, len(w.data), w.data) for w in wishes]
    bits = wire_bits(FrameBatch.from_rows(frames)).tolist()
    requests = [
        Request(START + wish.at_ns, wish.can_id, wish.node, length)
        for wish, length in zip(wishes, bits, strict=True)
    ]
    data = {(r.ready_ns, r.can_id): w.data for r, w in zip(requests, wishes, strict=True)}
    found: list[Row] = []
    for each in Line(requests, bit_ns=BIT_NS).run():
        payload = data[each.request.ready_ns, each.request.can_id]
        t_ns = last_ns = max((each.end_ns + int(late[len(found)])) // step_ns * step_ns, last_ns)
        found.append((t_ns, 0, each.request.can_id, 0, len(payload), payload))
    return found


def run(
    *wishes: Iterable[Wish],
    window_us: int | None = 2000,
    types: dict[int, int] | None = None,
    moved: dict[int, tuple[int, int]] | None = None,
    node: int = 5,
    step_ns: int = 1000,
    bitrate: int | None = BITRATE,
    noise_us: float = 0.0,
) -> Analysis:
    """The analysis of a bus whose master set 1007h of a node and types of PDOs by identifier.

    `moved`: identifier and type of TPDO1 by node, where it is not the predefined one.
    """
    listed = [wish for part in wishes for wish in part]
    sent = sent_rows(listed, step_ns, noise_us)
    nodes = {wish.can_id & 0x7F for wish in listed if 0x180 < wish.can_id < 0x580} | {node}
    setup = [row for n in sorted(nodes) for row in beats(n, 3.3 + n / 10, START / MS, 100)]
    settings = {
        (can_id & 0x7F, (can_id - 0x180) >> 8): (can_id, kind)
        for can_id, kind in (types or {}).items()
    }
    settings |= {(n, 0): told for n, told in (moved or {}).items()}
    at_ms = 500.0
    if window_us is not None:
        setup += write(at_ms, node, 0x1007, 0, window_us)
    for (owner, number), (can_id, kind) in settings.items():
        setup += write(at_ms + 5, owner, 0x1800 + number, 2, kind, 1)
        setup += write(at_ms + 10, owner, 0x1800 + number, 1, can_id)
        at_ms += 10
    return whole(setup, sent, bitrate=bitrate)


def lateness(analysis: Analysis, cob_id: int) -> LatenessRow:
    return next(row for row in analysis.lateness if row.cob_id == cob_id)
