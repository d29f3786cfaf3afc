"""LSS: what a master asked, what slaves answered, and what is told of it (CiA 305)."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from syncline_schemas.canopen.lss import decode_frame
from tests.analyzer.control_runs import Row, frame
from tests.analyzer.whole_run import T0, beats, found, ids, whole


def ask(t_ms: float, data: str) -> Row:
    return frame(t_ms, 0x7E5, data.ljust(16, "0"))


def answer(t_ms: float, data: str) -> Row:
    return frame(t_ms, 0x7E4, data.ljust(16, "0"))


@pytest.mark.parametrize(
    ("data", "text"),
    [
        ("0401", "switch state global: configuration"),
        ("0400", "switch state global: waiting"),
        ("1105", "configure node-ID: 5"),
        ("11FF", "configure node-ID: none (unconfigured)"),
        ("130002", "configure bit timing: 500 kbit/s"),
        ("130009", "configure bit timing: automatic detection"),
        ("130103", "configure bit timing: entry 3 of table 1"),
        ("15E803", "activate bit timing: after 1000 ms"),
        ("17", "store configuration"),
        ("4078563412", "switch state selective vendor-ID: 12345678h"),
        ("43010000A0", "switch state selective serial number: A0000001h"),
        ("4601000000", "identify remote slave vendor-ID: 00000001h"),
        ("4C", "identify non-configured remote slave"),
        ("510000000080", "fastscan: start, all unconfigured slaves answer"),
        ("51785634121F0203", "fastscan: 12345678h, from bit 31, part 2"),
        ("5A", "inquire vendor-ID"),
        ("5E", "inquire node-ID"),
        ("EE", "unknown EEh"),
    ],
)
def test_what_a_master_says(data: str, text: str) -> None:
    assert decode_frame(bytes.fromhex(data.ljust(16, "0")), request=True).text == text


@pytest.mark.parametrize(
    ("data", "text"),
    [
        ("1100", "configure node-ID: done"),
        ("1101", "configure node-ID: refused, node-ID out of range"),
        ("11FF07", "configure node-ID: refused, maker's error 7"),
        ("1301", "configure bit timing: refused, bit timing not supported"),
        ("1701", "store configuration: refused, storing not supported"),
        ("1702", "store configuration: refused, storage medium failed"),
        ("1709", "store configuration: refused, error 9"),
        ("44", "switch state selective answer"),
        ("4F", "identify slave"),
        ("50", "identify non-configured slave"),
        ("5A78563412", "inquire vendor-ID: 12345678h"),
        ("5E05", "inquire node-ID: 5"),
        ("5EFF", "inquire node-ID: none (unconfigured)"),
    ],
)
def test_what_a_slave_says(data: str, text: str) -> None:
    assert decode_frame(bytes.fromhex(data.ljust(16, "0")), request=False).text == text


@given(st.binary(max_size=8), st.booleans())
def test_nothing_raises_and_bad_lengths_are_told(data: bytes, request: bool) -> None:
    told = decode_frame(data, request=request)
    assert told.text
    if 0 < len(data) < 8:
        assert told.text.endswith(f"({len(data)} bytes instead of 8)")


def test_the_frames_are_a_table() -> None:
    told = whole(beats(9, 0, 3000), [ask(100, "0401"), ask(200, "1105"), answer(203, "1100")])
    assert [(row.sender, row.command, row.t_ns - T0) for row in told.lss] == [
        ("master", "switch state global", 100_000_000),
        ("master", "configure node-ID", 200_000_000),
        ("slave", "configure node-ID", 203_000_000),
    ]
    assert told.lss[1].values == {"node_id": 5}


def test_on_a_bus_that_is_not_canopen_there_is_none() -> None:
    rows = [frame(10 * k, 0x7E5, "0401" + "00" * 6) for k in range(5)]
    assert whole(rows).lss == []


@pytest.mark.triggers("lss.node_id_changed")
def test_a_node_id_is_given() -> None:
    told = whole(beats(9, 0, 3000), [ask(200, "1105"), answer(203, "1100")])
    (finding,) = found(told, "lss.node_id_changed")
    assert (finding.severity, finding.node) == ("info", 5)
    assert "node-ID 5" in finding.text
    assert len(finding.evidence) == 2


@pytest.mark.near_miss("lss.node_id_changed")
def test_a_node_id_that_nobody_takes_is_none() -> None:
    told = whole(beats(9, 0, 3000), [ask(200, "1105"), ask(250, "5E"), answer(260, "5E05")])
    assert ids(told) == set()


@pytest.mark.triggers("lss.bitrate_changed")
def test_a_bit_rate_is_given() -> None:
    told = whole(beats(9, 0, 3000), [ask(200, "130003"), answer(203, "1300")])
    assert "250 kbit/s" in found(told, "lss.bitrate_changed")[0].text


@pytest.mark.near_miss("lss.bitrate_changed", "lss.refused")
def test_a_late_answer_belongs_to_nothing() -> None:
    told = whole(beats(9, 0, 9000), [ask(200, "130003"), answer(5000, "1300")])
    assert ids(told) == set()


@pytest.mark.triggers("lss.refused")
def test_a_refusal_is_told_with_its_reason() -> None:
    told = whole(beats(9, 0, 3000), [ask(200, "11C8"), answer(203, "1101")])
    (finding,) = found(told, "lss.refused")
    assert finding.severity == "warning"
    assert "node-ID out of range" in finding.text
    assert "lss.node_id_changed" not in ids(told)


@pytest.mark.parametrize("asked", [True, False])
def test_a_node_that_got_another_number_is_not_lost(asked: bool) -> None:
    inquiry = [ask(2900, "5E"), answer(2902, "5E05")] if asked else []
    renamed = [ask(3000, "1108"), answer(3002, "1100"), frame(3100, 0, "8105")]
    again = [frame(3400, 0x708, "00"), *beats(8, 3500, 9000)]
    told = whole(beats(9, 0, 9000), beats(5, 30, 3090), inquiry, renamed, again)
    assert [f.id for f in told.findings if f.severity != "info"] == []
    assert "lss.node_id_changed" in ids(told)
