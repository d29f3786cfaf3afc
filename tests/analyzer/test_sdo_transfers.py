"""The SDO transfers of a capture: columns that behave like a list of rows."""

from collections.abc import Sequence

import numpy as np
import pytest

from syncline_analyzer.results import SdoRow, SdoTransfers
from tests.analyzer.analysis_builder import sdo_row
from tests.analyzer.sdo_builder import fold_table, sdo_frame

ROWS = [
    sdo_row(5, 1.0),
    sdo_row(5, 2.0, direction="upload", index=0x1018, sub=2, value=7, data=b"\7\0\0\0", size=4),
    sdo_row(6, 3.0, result="abort", abort_code=0x06020000, abort_by="server", data=b"", size=None,
            value=None),
    sdo_row(6, 4.0, bus="can1", result="no answer", answer_us=None, end_seq=None, crc_ok=False),
    sdo_row(5, 5.0, kind="block", index=None, sub=None, announced=9, crc_ok=True,
            client_cob_id=0x605),
]  # fmt: skip


@pytest.fixture(params=["given", "decoded"])
def transfers(request: pytest.FixtureRequest) -> SdoTransfers:
    """Five transfers, made of rows or of frames."""
    if request.param == "given":
        return SdoTransfers.of(ROWS)
    frames = [
        sdo_frame(0, ">", 5, bytes.fromhex("2B17100064000000")),
        sdo_frame(1, "<", 5, bytes.fromhex("6017100000000000")),
        sdo_frame(2, ">", 5, bytes.fromhex("4018100200000000")),
        sdo_frame(3, "<", 5, bytes.fromhex("4318100207000000")),
        sdo_frame(4, ">", 6, bytes.fromhex("2B17100064000000")),
        sdo_frame(5, "<", 6, bytes.fromhex("8017100000000206")),
        sdo_frame(6, ">", 6, bytes.fromhex("2B17100064000000"), bus=1),
        sdo_frame(7, ">", 5, bytes.fromhex("2B17100064000000")),
        sdo_frame(8, "<", 5, bytes.fromhex("6017100000000000")),
        sdo_frame(9_000_000, "<", 5, b""),
    ]
    return fold_table(frames).rows


def test_it_is_a_sequence_of_rows(transfers: SdoTransfers) -> None:
    listed = list(transfers)
    assert isinstance(transfers, Sequence)
    assert len(transfers) == len(listed) == 5
    assert all(isinstance(row, SdoRow) for row in listed)
    assert [transfers[at] for at in range(5)] == listed
    assert [transfers[at] for at in range(-5, 0)] == listed
    assert list(reversed(transfers)) == listed[::-1]
    assert listed[2] in transfers
    assert transfers.index(listed[3]) == 3
    assert transfers == listed
    assert transfers == SdoTransfers.of(listed)
    assert transfers != listed[:4]
    assert transfers != [*listed[:4], listed[0]]
    assert transfers
    for beyond in (5, -6):
        with pytest.raises(IndexError):
            transfers[beyond]


@pytest.mark.parametrize("cut", [slice(1, 3), slice(None, None, -2), slice(3, 1), slice(-2, None)])
def test_a_slice_is_the_same_of_fewer_rows(transfers: SdoTransfers, cut: slice) -> None:
    part = transfers[cut]
    assert isinstance(part, SdoTransfers)
    assert list(part) == list(transfers)[cut]


def test_parts_are_those_that_the_rows_say(transfers: SdoTransfers) -> None:
    rows = list(transfers)
    assert list(transfers.ok) == [row for row in rows if row.result == "ok"]
    assert list(transfers.failed) == [row for row in rows if row.result != "ok"]
    assert list(transfers.unusual) == [
        row for row in rows if row.result != "ok" or row.kind != "expedited"
    ]
    assert list(transfers.aborted) == [row for row in rows if row.result == "abort"]
    assert list(transfers.reads) == [row for row in rows if row.direction == "upload"]
    assert list(transfers.writes) == [row for row in rows if row.direction == "download"]
    assert list(transfers.accepted) == [
        row for row in rows if row.direction == "download" and row.result == "ok"
    ]
    for key in {(row.bus, row.node) for row in rows}:
        assert list(transfers.of_node(*key)) == [r for r in rows if (r.bus, r.node) == key]
    assert set(transfers.nodes()) == {(row.bus, row.node) for row in rows}
    assert list(transfers.of_node("can9", 5)) == []
    assert list(transfers.of_object(0x1017, 0)) == [r for r in rows if r.index == 0x1017]
    late = transfers.records["start_ns"] >= rows[3].start_ns
    assert list(transfers.part(late)) == rows[3:]
    assert list(transfers.part(np.array([4, 0]))) == [rows[4], rows[0]]
    assert transfers.writes.of_node("can0", 5).of_object(0x1017, 0)[0] == rows[0]


def test_records_tell_what_the_rows_tell(transfers: SdoTransfers) -> None:
    rows, records = list(transfers), transfers.records
    for name in ("seq", "start_ns", "end_ns"):
        assert records[name].tolist() == [getattr(row, name) for row in rows]
    assert (records["answer_ns"] >= 0).tolist() == [row.answer_us is not None for row in rows]
    assert records["length"].tolist() == [len(row.data) for row in rows]
    assert (records["crc"] == 0).tolist() == [row.crc_ok is False for row in rows]
    codes = [-1 if row.abort_code is None else row.abort_code for row in rows]
    assert records["abort_code"].tolist() == codes


def test_given_rows_stay_the_very_same() -> None:
    assert [one is other for one, other in zip(SdoTransfers.of(ROWS), ROWS, strict=True)] == [
        True
    ] * 5


def test_none_at_all() -> None:
    for none in (SdoTransfers.of(), fold_table([]).rows, SdoTransfers.of(ROWS)[:0]):
        assert not none
        assert none == []
        assert none.nodes() == []
        assert list(none.failed) == list(none.of_node("can0", 5)) == []
        assert list(none.of_object(0x1000, 0).accepted) == []


def test_more_rows_than_are_made_at_a_time() -> None:
    """Rows come in blocks; payloads of all kinds keep their place."""
    frames = []
    for number in range(5000):
        name = (0x2000 + number % 50).to_bytes(2, "little") + b"\0"
        value = number.to_bytes(4, "little")
        frames.append(sdo_frame(2 * number, ">", 1 + number % 100, b"\x40" + name + bytes(4)))
        frames.append(sdo_frame(2 * number + 1, "<", 1 + number % 100, b"\x43" + name + value))
    rows = fold_table(frames, batch=999).rows
    assert [int.from_bytes(row.data, "little") for row in rows] == list(range(5000))
    assert [row.node for row in rows] == [1 + number % 100 for number in range(5000)]
    assert rows.records.nbytes < 100 * 5000
