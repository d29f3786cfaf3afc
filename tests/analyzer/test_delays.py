"""Who delayed whom, where it comes out late whose the frames were."""

from syncline_analyzer.results import Analysis
from tests.analyzer.control_runs import MS, Row
from tests.analyzer.waiting_runs import BITRATE, answers, sent_rows, syncs
from tests.analyzer.whole_run import beats, whole

COUNT = 300
END_MS = 1000 + 10 * COUNT


def _read(t_ms: float, node: int, index: int, value: int) -> list[Row]:
    """Subindex 1 read by SDO: the identifier of a PDO (CiA 301 7.2.4.3.5)."""
    head = index.to_bytes(2, "little") + b"\x01"
    answer = b"\x43" + head + value.to_bytes(4, "little")
    return [
        (round(t_ms * MS), 0, 0x600 + node, 0, 8, b"\x40" + head + bytes(4)),
        (round((t_ms + 1) * MS), 0, 0x580 + node, 0, 8, answer),
    ]


def _told(*more: list[Row]) -> Analysis:
    """183h and, close behind it, 184h after each SYNC."""
    frames = sent_rows([*syncs(COUNT), *answers(COUNT, 0x183, 1), *answers(COUNT, 0x184, 1, 330)])
    return whole(frames, *more, bitrate=BITRATE)


def test_frames_that_prove_to_be_its_own_delay_nobody() -> None:
    reads = _read(END_MS, 1, 0x1802, 0x183) + _read(END_MS + 5, 1, 0x1803, 0x184)
    told = _told(beats(1, 1000, END_MS), reads)
    assert {row.cob_id: row.node for row in told.pdos} == {0x183: 1, 0x184: 1}
    assert not [row for row in told.delays if row.cob_id == 0x183 or row.node == 3]


def test_frames_of_another_node_that_is_there_do() -> None:
    told = _told(beats(3, 1000, END_MS), beats(4, 1001, END_MS))
    whose = {row.cob_id: row.node for row in told.delays if row.worst_cob_id == 0x184}
    assert whose[0x183] == 3
    assert [row.node for row in told.delays if row.cob_id is None] == [3]


def test_an_identifier_of_a_node_that_nobody_heard_names_no_node() -> None:
    told = _told(beats(9, 1000, END_MS))
    assert {row.node for row in told.delays} <= {None, 9}
