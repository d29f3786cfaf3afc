"""Who sends a frame, by what the bus told and by CiA 301."""

import pytest

from syncline_analyzer.folds.timing.senders import Sender, Senders
from syncline_analyzer.folds.timing.waiting import MASTER, UNKNOWN
from syncline_analyzer.pdo_binding import PdoBindings
from syncline_schemas.batch import FrameBatch, FrameFlag
from tests.analyzer.timing_builder import context, frame, learn


def senders(*objects: tuple[int, int, int, int]) -> Senders:
    """After the objects (node, index, sub, value) were read."""
    ctx = context()
    for node, index, sub, value in objects:
        learn(ctx, node, index, sub, value)
    bindings = PdoBindings(ctx.shadow)
    bindings.refresh(0)
    return Senders(ctx, bindings)


@pytest.mark.parametrize(
    ("can_id", "expected"),
    [
        (0x000, Sender(MASTER, "NMT")),
        (0x080, Sender(MASTER, "SYNC")),
        (0x085, Sender(5, "EMCY")),
        (0x100, Sender(MASTER, "TIME")),
        (0x185, Sender(5, "TPDO1 (guess)")),
        (0x205, Sender(MASTER, "RPDO1 (guess)")),
        (0x585, Sender(5, "SDO answer")),
        (0x605, Sender(MASTER, "SDO request")),
        (0x705, Sender(5, "error control")),
        (0x7E4, Sender(UNKNOWN, "LSS")),
        (0x7E5, Sender(MASTER, "LSS")),
        (0x6E0, Sender(UNKNOWN, "other")),
    ],
)
def test_the_predefined_connection_set_tells_it(can_id: int, expected: Sender) -> None:
    found = senders()
    found.nodes(FrameBatch.from_rows([frame(0, 0x705, b"\x05")]), 0, 0)
    assert found.of(0, can_id, 0) == expected


@pytest.mark.parametrize("can_id", [0x185, 0x205])
def test_a_predefined_pdo_of_a_node_that_nobody_heard_may_be_anybodys(can_id: int) -> None:
    assert senders().of(0, can_id, 0).node == UNKNOWN


def test_what_the_bus_told_comes_first() -> None:
    found = senders(
        (9, 0x1800, 1, 0x1A5),
        (3, 0x1400, 1, 0x1A6),
        (7, 0x1200, 1, 0x640),
        (7, 0x1200, 2, 0x5C0),
        (4, 0x1014, 0, 0x90),
        (6, 0x1005, 0, 0x40000080),
    )
    assert found.of(0, 0x1A5, 9) == Sender(9, "TPDO1")
    assert found.of(0, 0x1A6, 9) == Sender(MASTER, "RPDO1")
    assert found.of(0, 0x5C0, 9) == Sender(7, "SDO answer")
    assert found.of(0, 0x640, 9) == Sender(MASTER, "SDO request")
    assert found.of(0, 0x90, 9) == Sender(4, "EMCY")
    assert found.of(0, 0x80, 9) == Sender(6, "SYNC")


def test_remote_frames_come_from_who_asks_and_wide_ones_from_nobody_known() -> None:
    remote, extended = int(FrameFlag.REMOTE), int(FrameFlag.EXTENDED)
    rows = [
        frame(0, 0x705),
        frame(1, 0x705, flags=remote),
        frame(2, 0x185, flags=remote),
        frame(3, 0x705, flags=extended),
    ]
    nodes = senders().nodes(FrameBatch.from_rows(rows), 0, 0)
    assert nodes.tolist() == [5, MASTER, MASTER, UNKNOWN]
