"""A bus of another protocol that uses CANopen's identifiers: nobody is accused."""

import pytest

from syncline_schemas.batch import FrameFlag
from tests.analyzer.control_runs import Row, frame
from tests.analyzer.whole_run import beats, whole


def cyclic(can_id: int, every_ms: float, bus: int = 0) -> list[Row]:
    """Eight bytes that count up, for 20 s."""
    return [
        frame(can_id / 1000 + k * every_ms, can_id, f"{k * 7 % 256:02X}" * 8, bus=bus)
        for k in range(round(20_000 / every_ms))
    ]


@pytest.mark.parametrize("number", [0x000, 0x080, 0x701])
def test_identifiers_that_another_protocol_uses_are_a_note_and_no_finding(number: int) -> None:
    ids = (number, 0x601, 0x581, 0x085, 0x185)
    rows = sorted((row for can_id in ids for row in cyclic(can_id, 50)), key=lambda row: row[0])
    answered = [
        frame(20_100, 0x601, "4000100000000000"),
        frame(20_101, 0x581, "4300100092010200"),
    ]
    told = whole([*rows, *answered])
    assert told.findings == []
    assert told.nodes == []
    assert told.capture.notes == ["can0 shows no CANopen: another protocol uses its identifiers"]


def test_a_canopen_bus_stays_one_whatever_else_is_on_it() -> None:
    alone = [*beats(5, 0, 20_000), *cyclic(0x000, 100)]
    told = whole(sorted(alone, key=lambda row: row[0]))
    assert [finding.id for finding in told.findings] == ["nmt.malformed_command"]
    assert told.capture.notes == []


def test_can_fd_frames_on_canopen_identifiers_are_none_of_a_device() -> None:
    """705#05 as CAN FD between two heartbeats is no second device."""
    flagged = [frame(25 + 100 * k, 0x705, "05", flags=int(FrameFlag.FD)) for k in range(200)]
    rows = [*beats(5, 0, 20_000), *flagged, *beats(6, 50, 20_000)]
    told = whole(sorted(rows, key=lambda row: row[0]))
    assert told.findings == []
    assert {row.node: row.heartbeats for row in told.nodes} == {5: 200, 6: 200}


def test_few_odd_frames_do_not_hide_an_sdo_server() -> None:
    rows = [frame(10 * k, 0x701, "0102") for k in range(9)]
    request = [frame(500, 0x601, "4000100000000000"), frame(501, 0x581, "4300100092010200")]
    assert [row.node for row in whole([*rows, *request]).nodes] == [1]
