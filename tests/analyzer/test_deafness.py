"""A recorder whose controller is bus-off is deaf: its silence proves nothing."""

import pytest

from syncline_analyzer.deafness import with_deafness
from syncline_schemas.batch import FrameBatch, FrameFlag, Gap
from syncline_schemas.can_errors import RECORDER_OFF, ErrorClass
from tests.analyzer.control_runs import MS, Row, frame

ERROR = int(FrameFlag.ERROR)


def off(t_ms: float, bus: int = 0) -> Row:
    return frame(t_ms, ErrorClass.BUS_OFF, "00" * 8, bus=bus, flags=ERROR)


def back(t_ms: float, bus: int = 0) -> Row:
    return frame(t_ms, ErrorClass.RESTARTED, "00" * 8, bus=bus, flags=ERROR)


def heard(*rows: Row, batch: int = 100) -> list[str]:
    """What comes out: the times of the rows in ms, and the gaps between them."""
    pieces = [FrameBatch.from_rows(rows[at : at + batch]) for at in range(0, len(rows), batch)]
    numbered = [(at * batch, piece) for at, piece in enumerate(pieces)]
    words, next_seq = [], 0
    for seq, item in with_deafness(numbered):
        assert seq == next_seq
        if isinstance(item, Gap):
            assert (item.reason, item.lost_frames) == (RECORDER_OFF, None)
            words.append(f"can{item.bus} deaf {item.start_ns // MS}..{item.end_ns // MS}")
        else:
            next_seq += len(item)
            words.extend(str(t_ns // MS) for t_ns in item.t_ns.tolist())
    return words


@pytest.mark.parametrize("batch", [1, 2, 3, 100])
def test_from_bus_off_to_the_restart_nothing_was_heard(batch: int) -> None:
    rows = [frame(0, 0x705, "05"), off(10), back(500), frame(510, 0x705, "05")]
    assert heard(*rows, batch=batch) == ["0", "10", "can0 deaf 10..500", "500", "510"]


@pytest.mark.parametrize("batch", [1, 3, 100])
def test_the_other_bus_goes_on(batch: int) -> None:
    rows = [off(10), frame(20, 0x705, "05", bus=1), off(25), frame(30, 0x705, "05")]
    assert heard(*rows, batch=batch) == ["10", "20", "25", "can0 deaf 10..30", "30"]


def test_twice_off_are_two_stretches() -> None:
    rows = [off(10), back(50), off(60), off(70), frame(90, 0x80), frame(95, 0x80)]
    assert heard(*rows) == [
        "10",
        "can0 deaf 10..50",
        "50",
        "60",
        "70",
        "can0 deaf 60..90",
        "90",
        "95",
    ]


def test_other_error_frames_while_off_are_no_hearing() -> None:
    passive = frame(20, 0x04, "00" * 8, flags=ERROR)
    assert heard(off(10), passive, back(30)) == ["10", "20", "can0 deaf 10..30", "30"]


def test_a_controller_that_stays_off_is_deaf_to_the_end() -> None:
    rows = [off(10), frame(400, 0x80, bus=1)]
    assert heard(*rows) == ["10", "400", "can0 deaf 10..400"]
    assert heard(frame(0, 0x80), off(10)) == ["0", "10"]


def test_a_stream_without_bus_off_passes_as_it_is() -> None:
    batch = FrameBatch.from_rows([frame(0, 0x80), back(10)])
    assert [item for _, item in with_deafness([(0, batch)])] == [batch]


def test_gaps_that_the_recorder_made_of_the_same_frames_stand_once() -> None:
    told = [Gap(MS, 3 * MS, RECORDER_OFF, None, 0), Gap(MS, 3 * MS, "unplugged")]
    kept = [item for _, item in with_deafness((0, gap) for gap in told)]
    assert kept == told[1:]
