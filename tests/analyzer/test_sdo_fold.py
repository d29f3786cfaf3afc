"""SDO transfers from frames written by hand after CiA 301 7.2.4.3."""

from binascii import crc_hqx
from collections.abc import Sequence

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from syncline_analyzer.results import SdoRow
from syncline_schemas.batch import Gap
from syncline_schemas.description import BusDescription
from syncline_schemas.devices import load_device
from tests.analyzer.control_runs import MS, Row, frame, run


def sdo(*exchange: tuple[str, str], node: int = 5, start_ms: float = 0.0) -> list[Row]:
    """Frames 1 ms apart; ">" from the client, "<" from the server."""
    ids = {">": 0x600 + node, "<": 0x580 + node}
    return [
        frame(start_ms + number, ids[side], data.replace(" ", ""))
        for number, (side, data) in enumerate(exchange)
    ]


def rows_of(*items: Row | Gap, **options: object) -> Sequence[SdoRow]:
    return run(*items, **options).analysis.sdo  # type: ignore[arg-type]


def test_expedited_read_and_write() -> None:
    read, write = rows_of(
        *sdo(
            (">", "40 1710 00 00000000"),
            ("<", "4B 1710 00 E8030000"),
            (">", "2B 1710 00 F4010000"),
            ("<", "60 1710 00 00000000"),
        )
    )
    assert (read.direction, read.kind, read.result, read.size) == ("upload", "expedited", "ok", 2)
    assert (read.index, read.sub, read.value, read.data) == (0x1017, 0, 1000, b"\xe8\x03")
    assert (read.seq, read.end_seq, read.answer_us) == (0, 1, 1000.0)
    assert (write.direction, write.value, write.size, write.result) == ("download", 500, 2, "ok")


def test_short_requests_are_read_as_far_as_they_go() -> None:
    rows = rows_of(
        *sdo(
            (">", "40 0014 00"),
            ("<", "4F 0014 00 02000000"),
            (">", "2F 0018 02 FE"),
            ("<", "60 0018 02 00000000"),
        )
    )
    assert [(r.result, r.value, r.data.hex()) for r in rows] == [("ok", 2, "02"), ("ok", 254, "fe")]


def test_client_42h_reads_and_22h_writes_without_size() -> None:
    """LIR manual 4.5: 42h from the client is a read request, 22h a write without a size."""
    device = {5: load_device("lir-ma158k")}
    rows = rows_of(
        *sdo(
            (">", "42 0460 00 00000000"),
            ("<", "43 0460 00 00010000"),
            (">", "22 0018 02 FE000000"),
            ("<", "60 0018 02 00000000"),
        ),
        devices=device,
    )
    assert [(r.direction, r.value, r.size, r.result) for r in rows] == [
        ("upload", 256, 4, "ok"),
        ("download", 0xFE, 1, "ok"),
    ]


def test_size_stays_open_where_nobody_says_it() -> None:
    (row,) = rows_of(*sdo((">", "22 0030 00 05000000"), ("<", "60 0030 00 00000000")))
    assert (row.size, row.value, row.data.hex()) == (None, "05000000", "05000000")


def test_segmented_read_of_a_text() -> None:
    """JN16: 1008h in one segment; here with a second one and the toggle."""
    (row,) = rows_of(
        *sdo(
            (">", "40 0810 00 00000000"),
            ("<", "41 0810 00 0A000000"),
            (">", "60 00000000000000"),
            ("<", "00 4A4E3231303020"),
            (">", "70 00000000000000"),
            ("<", "19 414243 00000000"),
        )
    )
    assert (row.kind, row.result, row.size, row.value) == ("segmented", "ok", 10, "JN2100 ABC")


def test_segmented_write() -> None:
    (row,) = rows_of(
        *sdo(
            (">", "21 0020 01 09000000"),
            ("<", "60 0020 01 00000000"),
            (">", "00 01020304050607"),
            ("<", "20 00000000000000"),
            (">", "1B 0809 0000000000"),
            ("<", "30 00000000000000"),
        )
    )
    assert (row.kind, row.direction, row.result) == ("segmented", "download", "ok")
    assert row.data == bytes(range(1, 10))


def block_upload(data: bytes, block_size: int, *, crc: int | None = None) -> list[Row]:
    """A block read of 1008h, frame by frame."""
    parts = [data[at : at + 7] for at in range(0, len(data), 7)]
    exchange = [(">", f"A4 0810 00 {block_size:02X} 00 0000")]
    exchange.append(("<", "C6 0810 00" + len(data).to_bytes(4, "little").hex()))
    exchange.append((">", "A3 00000000000000"))
    for number, part in enumerate(parts):
        last = number == len(parts) - 1
        sequence = number % block_size + 1
        exchange.append(("<", f"{sequence | 0x80 * last:02X}" + part.ljust(7, b"\0").hex()))
        if last or sequence == block_size:
            exchange.append((">", f"A2 {sequence:02X} {block_size:02X} 0000000000"))
    unused = 7 - len(parts[-1])
    check = crc_hqx(data, 0) if crc is None else crc
    exchange.append(
        ("<", f"{0xC1 | unused << 2:02X}" + check.to_bytes(2, "little").hex() + "00" * 5)
    )
    exchange.append((">", "A1 00000000000000"))
    return sdo(*exchange)


@given(st.binary(min_size=1, max_size=120), st.integers(1, 127))
@settings(max_examples=60, deadline=None)
def test_block_read_of_any_data(data: bytes, block_size: int) -> None:
    result = run(*block_upload(data, block_size))
    (row,) = result.analysis.sdo
    assert (row.kind, row.result, row.data) == ("block", "ok", data)
    assert row.crc_ok


def test_the_last_segment_of_a_block_read_is_no_abort() -> None:
    """80h | seqno looks like an abort; other tools report one here (peers.md 4.1)."""
    (row,) = rows_of(*block_upload(b"0123456789 its name", 127))
    assert (row.result, row.abort_code, row.value) == ("ok", None, "0123456789 its name")


def test_a_wrong_block_crc_is_told() -> None:
    result = run(*block_upload(b"some data here", 10, crc=0x1234))
    assert result.analysis.sdo[0].crc_ok is False
    assert result.ids() == ["sdo.block_crc"]


def test_block_write_with_a_repeated_segment() -> None:
    """The server has segment 1 only: the client sends from segment 2 on again."""
    data = b"abcdefgHIJKLMNopq"
    check = crc_hqx(data, 0).to_bytes(2, "little").hex()
    (row,) = rows_of(
        *sdo(
            (">", "C6 0120 00 11000000"),
            ("<", "A4 0120 00 03 000000"),
            (">", "01" + data[:7].hex()),
            (">", "02" + data[7:14].hex()),
            (">", "83" + data[14:].ljust(7, b"\0").hex()),
            ("<", "A2 01 03 0000000000"),
            (">", "01" + data[7:14].hex()),
            (">", "82" + data[14:].ljust(7, b"\0").hex()),
            ("<", "A2 02 03 0000000000"),
            (">", "D1" + check + "0000000000"),
            ("<", "A1 00000000000000"),
        )
    )
    assert (row.kind, row.direction, row.result, row.data) == ("block", "download", "ok", data)


@pytest.mark.parametrize("side", ["<", ">"])
def test_aborts_of_either_side(side: str) -> None:
    alive = frame(50, 0x705, "05")
    result = run(*sdo((">", "40 0010 00 00000000"), (side, "80 0010 00 00000206")), alive)
    (row,) = result.analysis.sdo
    assert (row.result, row.abort_code) == ("abort", 0x06020000)
    assert row.abort_by == {"<": "server", ">": "client"}[side]


def test_an_abort_of_another_object_does_not_end_the_transfer() -> None:
    rows = rows_of(
        *sdo(
            (">", "40 0010 00 00000000"),
            ("<", "80 0911 00 00000206"),
            ("<", "43 0010 00 96010100"),
        )
    )
    assert [(row.result, row.value) for row in rows] == [("ok", 0x00010196)]


def test_a_repeated_request_leaves_the_first_unanswered() -> None:
    rows = rows_of(
        *sdo(
            (">", "40 0010 00 00000000"),
            (">", "40 0010 00 00000000"),
            ("<", "43 0010 00 01000000"),
        )
    )
    assert [row.result for row in rows] == ["no answer", "ok"]


def test_what_runs_into_a_gap_is_interrupted() -> None:
    request = sdo((">", "40 0010 00 00000000"))
    answered = sdo((">", "40 0010 00 00000000"), ("<", "43 0010 00 01000000"), start_ms=900)
    gap = Gap(10 * MS, 800 * MS, "adapter lost")
    assert [row.result for row in rows_of(*request, gap, *answered)] == ["interrupted", "ok"]
    late = Gap(2000 * MS, 2800 * MS, "adapter lost")
    assert [row.result for row in rows_of(*request, late, *answered)] == ["no answer", "ok"]


@pytest.mark.parametrize(("end_ms", "result"), [(1010, "interrupted"), (5000, "no answer")])
def test_what_waits_at_the_end_is_unanswered_only_after_some_time(end_ms: int, result: str) -> None:
    answered = sdo((">", "40 0010 00 00000000"), ("<", "43 0010 00 01000000"))
    rows = rows_of(*answered, frame(1000, 0x605, "4000100000"), end_ms=end_ms)
    assert [row.result for row in rows] == ["ok", result]


def test_a_reset_soon_after_the_request_interrupts_and_a_late_one_does_not() -> None:
    answered = sdo((">", "40 0010 00 00000000"), ("<", "43 0010 00 01000000"))
    soon = rows_of(*answered, frame(100, 0x605, "4001100000"), frame(150, 0x000, "8105"))
    assert [row.result for row in soon] == ["ok", "interrupted"]
    late = rows_of(*answered, frame(100, 0x605, "4001100000"), frame(5150, 0x000, "8105"))
    assert [row.result for row in late] == ["ok", "no answer"]


@pytest.mark.parametrize("first", [0x01, 0x1D, 0x21, 0x40])
def test_a_capture_that_begins_within_a_transfer_invents_nothing(first: int) -> None:
    """Block segments count up from any number: as commands they would be reads, writes, aborts."""
    segments = [(">", f"{number:02X} 40001000112233") for number in range(first, 0x50)]
    answers = [("<", f"{number:02X} 40001000112233") for number in range(0x3D, 0x50)]
    alive = [frame(400, 0x705, "05"), frame(9000, 0x705, "05")]
    result = run(*sdo(*segments), alive[0], *sdo(*answers, start_ms=500), alive[1])
    assert result.analysis.sdo == []
    assert result.tables.sdo.strays[0, 5].requests == len(segments)
    assert result.tables.sdo.strays[0, 5].answers == len(answers)


def test_two_nodes_and_two_buses_do_not_mix() -> None:
    first = sdo((">", "40 0010 00 00000000"), ("<", "43 0010 00 01000000"))
    other = [(t, 1, *rest) for t, _, *rest in first]
    crossed = [first[0], other[0], other[1], first[1]]
    assert [row.bus for row in rows_of(*crossed)] == ["can0", "can1"]  # type: ignore[arg-type]
    assert {row.result for row in rows_of(*crossed)} == {"ok"}  # type: ignore[arg-type]


def test_a_device_that_names_another_node_s_identifiers_does_not_take_them() -> None:
    """1200h of node 5 says 640h and 5C0h, where node 64 answers all the time."""
    other = sdo((">", "40 0010 00 00000000"), ("<", "43 0010 00 01000000"), node=0x40)
    tell = sdo(*told(0x1200, 1, 0x640), *told(0x1200, 2, 0x5C0), start_ms=5)
    rows = rows_of(*other, *tell, *MOVED)
    assert [row.node for row in rows] == [0x40, 5, 5, 0x40]


def told(index: int, sub: int, cob_id: int) -> list[tuple[str, str]]:
    """A read of an SDO parameter."""
    name = index.to_bytes(2, "little").hex() + f"{sub:02X}"
    value = cob_id.to_bytes(4, "little").hex()
    return [(">", f"40 {name} 00000000"), ("<", f"43 {name} {value}")]


MOVED = [frame(10, 0x640, "4000100000000000"), frame(11, 0x5C0, "4300100096010100")]


@pytest.mark.parametrize("batch", [1, 3, 100])
def test_a_moved_server_is_followed_from_the_frame_on_that_tells_it(batch: int) -> None:
    tell = sdo(*told(0x1200, 1, 0x640), *told(0x1200, 2, 0x5C0))
    rows = rows_of(*tell, *MOVED, batch=batch)
    assert [(row.node, row.index) for row in rows] == [(5, 0x1200), (5, 0x1200), (5, 0x1000)]
    assert rows[-1].answer_us == 1000.0


@pytest.mark.parametrize("batch", [1, 100])
def test_an_additional_server_is_followed_until_a_reset_takes_it_back(batch: int) -> None:
    """1201h written: two clients at once, each on its server; after 81h the identifiers are free."""
    write = [
        (">", "23 0112 01 40060000"),
        ("<", "60 0112 01 00000000"),
        (">", "23 0112 02 C0050000"),
        ("<", "60 0112 02 00000000"),
    ]
    both = [
        frame(9.8, 0x605, "4018100100000000"),
        *MOVED,
        frame(11.2, 0x585, "4318100112000000"),
    ]
    again = [frame(40, 0x640, "4000100000000000"), frame(41, 0x5C0, "4300100096010100")]
    after = [frame(20, 0x000, "8105"), *again]
    rows = rows_of(*sdo(*write), *both, *after, batch=batch)
    assert [(row.node, row.index, row.result) for row in rows] == [
        (5, 0x1201, "ok"),
        (5, 0x1201, "ok"),
        (5, 0x1018, "ok"),
        (5, 0x1000, "ok"),
        (0x40, 0x1000, "ok"),
    ]


def test_a_server_that_the_bus_description_puts_elsewhere() -> None:
    text = """[node.5.objects]
"1200:1" = 0x640
"1200:2" = 0x5C0
"""
    (row,) = rows_of(*MOVED, description=BusDescription.loads(text))
    assert (row.node, row.index, row.value) == (5, 0x1000, 0x10196)


def test_a_node_that_is_polled_for_days_does_not_fill_the_memory(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Failures are listed longer than what went well; counts stay whole."""
    monkeypatch.setattr("syncline_analyzer.folds.sdo.log.MAX_ROWS", 3)
    polled = sdo((">", "40 0010 00 00000000"), ("<", "43 0010 00 01000000")) * 5
    refused = sdo((">", "40 0110 00 00000000"), ("<", "80 0110 00 00000206"))
    result = run(*polled, *refused)
    assert [row.result for row in result.analysis.sdo] == ["ok", "ok", "ok", "abort"]
    assert (result.nodes[5].sdo_transfers, result.nodes[5].sdo_aborts) == (6, 1)
    assert result.tables.sdo.unlisted == 2


def test_two_clients_on_one_server() -> None:
    """Requests overlap; each answer finds its own, also when one of them never comes."""
    rows = rows_of(
        *sdo(
            (">", "40 0010 00 00000000"),
            (">", "40 0110 00 00000000"),
            ("<", "43 0010 00 01000000"),
            (">", "40 0210 00 00000000"),
            ("<", "4F 0110 00 02000000"),
            (">", "40 0310 00 00000000"),
            ("<", "4F 0310 00 03000000"),
        )
    )
    assert [(row.index, row.result, row.value) for row in rows] == [
        (0x1000, "ok", 1),
        (0x1001, "ok", 2),
        (0x1002, "no answer", None),
        (0x1003, "ok", 3),
    ]
    assert [row.answer_us for row in rows[:2]] == [2000.0, 3000.0]


def test_an_abort_that_names_another_object_counts_when_no_answer_comes() -> None:
    rows = rows_of(
        *sdo(
            (">", "40 0010 00 00000000"),
            ("<", "80 1000 00 00000206"),
            (">", "40 0110 00 00000000"),
            ("<", "4F 0110 00 00000000"),
        )
    )
    assert [(row.index, row.result, row.abort_code, row.abort_by) for row in rows] == [
        (0x1000, "abort", 0x06020000, "server"),
        (0x1001, "ok", None, None),
    ]


@pytest.mark.parametrize("request_byte", ["41", "43", "4F", "5C"])
def test_a_read_with_reserved_bits_counts_when_it_is_answered(request_byte: str) -> None:
    (row,) = rows_of(*sdo((">", request_byte + "0010 00 00000000"), ("<", "43 0010 00 01000000")))
    assert (row.direction, row.result, row.value) == ("upload", "ok", 1)
    assert rows_of(*sdo((">", request_byte + "0010 00 00000000"))) == []


def test_a_read_that_looked_like_a_segment_of_a_block() -> None:
    """The client broke a block download off without a word and reads: 40h is also segment 64."""
    rows = rows_of(
        *sdo(
            (">", "C2 0120 00 11000000"),
            ("<", "A0 0120 00 7F 000000"),
            (">", "01 01020304050607"),
            (">", "40 0010 00 00000000"),
            ("<", "43 0010 00 01000000"),
        )
    )
    assert [(row.index, row.result) for row in rows] == [(0x2001, "interrupted"), (0x1000, "ok")]


@pytest.mark.parametrize(
    ("index", "data", "value"),
    [
        (0x1008, "4A4E32310000", "JN21"),
        (0x1018, "", None),
        (0x1029, "02", 2),
        (0x1F50, "0102", "0102"),
        (0x2000, "0102", "0102"),
    ],
)
def test_payloads_by_the_type_of_the_object(index: int, data: str, value: object) -> None:
    payload = bytes.fromhex(data)
    name = index.to_bytes(2, "little").hex() + "01" * (index != 0x1008) + "00" * (index == 0x1008)
    size = len(payload).to_bytes(4, "little").hex()
    end = f"{7 - len(payload) << 1 | 1:02X}" + payload.ljust(7, b"\0").hex()
    (row,) = rows_of(*sdo((">", f"40{name}"), ("<", f"41{name}{size}"), (">", "60"), ("<", end)))
    assert (row.result, row.value, row.size) == ("ok", value, len(payload))


@given(st.lists(st.tuples(st.sampled_from([0x585, 0x605]), st.binary(max_size=8)), max_size=40))
@settings(max_examples=150, deadline=None)
def test_any_bytes_become_rows_or_counts(frames: list[tuple[int, bytes]]) -> None:
    items = [frame(number, can_id, data.hex()) for number, (can_id, data) in enumerate(frames)]
    whole, single = run(*items), run(*items, batch=1)
    assert whole.analysis.sdo == single.analysis.sdo
    for row in whole.analysis.sdo:
        assert row.end_ns >= row.start_ns
