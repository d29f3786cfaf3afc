"""LSS: what a master asked, what slaves answered, and what is told of it (CiA 305)."""

from collections.abc import Iterable
from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from syncline_analyzer.results import Analysis, NmtStateRow
from syncline_schemas.batch import Gap
from syncline_schemas.canopen.lss import decode_frame
from tests.analyzer.control_runs import MS, Row, frame
from tests.analyzer.whole_run import T0, beats, found, ids, severe, whole, write


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


# -- stored, and under which number the device went on ---------------------------------------------

STORED = [ask(3010, "17"), answer(3012, "1700")]


def renumbered(*more: Iterable[Row] | Gap, reset: str = "8105") -> Analysis:
    """Node 5 is given number 8 at 3 s, is reset, and boots as node 8; node 9 works all the time."""
    given = [ask(2900, "0401"), ask(3000, "1108"), answer(3002, "1100")]
    again = [frame(3100, 0, reset), frame(3400, 0x708, "00"), *beats(8, 3500, 30_000)]
    return whole(beats(9, 0, 30_000), beats(5, 30, 3090), given, again, *more)


def serial(t_ms: float, node: int, number: int) -> list[Row]:
    """A read of 1018h:4 and its answer."""
    told = f"43181004{number:02X}000000"
    return [frame(t_ms, 0x600 + node, "4018100400000000"), frame(t_ms + 1, 0x580 + node, told)]


def selected(number: int) -> list[Row]:
    """A slave is selected by its identity, the serial number above all."""
    named = [ask(2920, "4001"), ask(2930, "4102"), ask(2940, "4203"), ask(2950, f"43{number:02X}")]
    return [*named, answer(2951, "44")]


def last_state(told: Analysis, node: int) -> NmtStateRow:
    return [row for row in told.nmt_states if row.node == node][-1]


@pytest.mark.triggers("lss.node_id_changed")
def test_a_number_that_was_stored_is_not_lost() -> None:
    (finding,) = found(renumbered(STORED), "lss.node_id_changed")
    assert "took it and stored it" in finding.text
    assert "lost" not in finding.check_next
    assert len(finding.evidence) == 5


@pytest.mark.parametrize(
    "more",
    [
        [ask(2950, "17"), answer(2952, "1700")],
        [ask(3010, "17")],
        [ask(3005, "0400"), *STORED],
        [ask(3005, "43"), *STORED],
    ],
    ids=["before it", "no answer", "after the session", "another slave"],
)
def test_a_store_that_may_be_anothers_is_not_told(more: list[Row]) -> None:
    (finding,) = found(renumbered(more), "lss.node_id_changed")
    assert "stored" not in finding.text
    assert "unless it was stored" in finding.check_next


def test_a_gap_may_hide_that_another_slave_stored() -> None:
    told = renumbered(STORED, Gap(3_003 * MS, 3_009 * MS, "overrun"))
    (finding,) = found(told, "lss.node_id_changed")
    assert "unless it was stored" in finding.check_next
    assert "it is node 8" not in finding.text


def test_a_number_that_the_device_refused_to_store() -> None:
    (finding,) = found(renumbered([ask(3010, "17"), answer(3012, "1702")]), "lss.node_id_changed")
    assert "refused to store it" in finding.text
    assert "it was not stored" in finding.check_next


@pytest.mark.parametrize("reset", ["8105", "8205", "8100"])
def test_a_device_that_goes_on_under_another_number(reset: str) -> None:
    back = [frame(3500, 0x709, "00")] if reset == "8100" else []
    told = renumbered(STORED, back, reset=reset)
    (finding,) = found(told, "lss.node_id_changed")
    begin = "A device that is taken for node 5 was given node-ID 8 by LSS, took it and stored it;"
    assert finding.text.startswith(begin)
    assert "it is node 8 since it booted at +3.400 s." in finding.text
    assert severe(told) == []
    state = last_state(told, 5)
    assert (state.state, state.start_ns - T0) == ("UNKNOWN", 3_400 * MS)
    assert "taken for node 8" in state.cause
    assert {row.node: row.final_state for row in told.nodes}[5] == "UNKNOWN"
    assert "LOST" not in {row.state for row in told.nmt_states}
    own = [row for row in told.nmt_states if row.node == 5]
    assert all(a.end_ns == b.start_ns for a, b in pairwise(own))


def test_the_identity_that_was_selected_is_that_of_the_node() -> None:
    told = renumbered(STORED, serial(1000, 5, 2), selected(2), serial(9000, 8, 2))
    (finding,) = found(told, "lss.node_id_changed")
    assert "it is node 8 since it booted" in finding.text


@pytest.mark.parametrize(
    ("more", "known"),
    [
        ([], False),
        (serial(1000, 5, 2), False),
        ([*serial(1000, 5, 2), *serial(9000, 8, 2)], True),
        ([*serial(1000, 5, 2), *selected(2)], True),
        (selected(2), False),
        ([ask(2950, "5E"), answer(2952, "5E05")], True),
    ],
    ids=["nothing", "one serial", "both serials", "selected", "only selected", "inquired"],
)
def test_whose_number_it_was_is_known_or_assumed(more: list[Row], known: bool) -> None:
    """A new device may get the number while node 5 dies by chance."""
    told = renumbered(STORED, more)
    (finding,) = found(told, "lss.node_id_changed")
    assert finding.text.startswith("Node 5 was given") == known
    assert any("taken for node 5, because" in each for each in finding.assumed) == (not known)
    assert ("taken for node 8" in last_state(told, 5).cause) == (not known)


def moved(*more: list[Row], stored: bool = False) -> Analysis:
    """Node 5 is node 8 from 3.4 s to 10 s, and boots as node 5 at 12 s."""
    given = [ask(2900, "0401"), ask(3000, "1108"), answer(3002, "1100"), frame(3100, 0, "8105")]
    again = [frame(3400, 0x708, "00"), *beats(8, 3500, 10_000)]
    back = [frame(12_000, 0x705, "00"), *beats(5, 12_100, 30_000)]
    kept = STORED if stored else []
    return whole(beats(9, 0, 30_000), beats(5, 30, 3090), given, again, back, kept, *more)


@pytest.mark.triggers("lss.node_id_changed")
def test_a_number_that_was_not_stored_is_gone_at_the_next_start() -> None:
    told = moved()
    (finding,) = found(told, "lss.node_id_changed")
    assert finding.severity == "warning"
    assert "Node 8 fell silent at +9.900 s, and node 5," in finding.text
    assert "started at +12.000 s: it started anew by itself" in finding.text
    assert any("one device" in each for each in finding.assumed)
    assert [f.id for f in told.findings if f.severity != "info"] == ["lss.node_id_changed"]
    reset = moved([frame(9_950, 0, "8108")])
    assert [f.id for f in reset.findings if f.severity != "info"] == []
    (finding,) = found(reset, "lss.node_id_changed")
    assert "it started anew with its old number" in finding.text


@pytest.mark.near_miss("lss.node_id_changed")
@pytest.mark.parametrize(
    ("more", "stored"),
    [
        ([], True),
        ([*serial(1000, 5, 1), *serial(9000, 8, 2)], False),
        ([*beats(7, 40, 3090), frame(11_000, 0x707, "00"), *beats(7, 11_100, 30_000)], False),
        ([ask(2950, "5E"), answer(2952, "5E07")], False),
        (beats(8, 13_000, 14_000), False),
    ],
    ids=["stored", "other serials", "two may be it", "it was another", "heard again"],
)
def test_a_lost_node_that_may_be_another_device_stays_lost(more: list[Row], stored: bool) -> None:
    told = moved(more, stored=stored)
    (finding,) = found(told, "lss.node_id_changed")
    assert finding.severity == "info"
    assert "nmt.node_lost" in {f.id for f in told.findings if f.node == 8}


@pytest.mark.parametrize("number", [8, 7])
def test_a_number_that_lss_gave_back_is_not_missed(number: int) -> None:
    there = [ask(9000, "0401"), ask(9100, "5E"), answer(9102, f"5E{number:02X}")]
    back = [ask(9200, "1105"), answer(9202, "1100"), frame(9950, 0, "8108")]
    told = moved([*there, *back], stored=True)
    assert ("nmt.no_boot_up" not in ids(told)) == (number == 8)
    again = [f for f in found(told, "lss.node_id_changed") if "is node 5 again" in f.text]
    assert len(again) == (number == 8)


@pytest.mark.near_miss("lss.node_id_changed")
@pytest.mark.parametrize(
    ("more", "reset"),
    [
        ([], "8109"),
        (beats(7, 10, 3095), "8100"),
        ([ask(2800, "4C")], "8105"),
        ([ask(2950, "5E"), answer(2952, "5EFF")], "8105"),
        ([ask(2950, "5E"), answer(2952, "5E07")], "8105"),
        (beats(8, 40, 2000), "8105"),
        (write(1000, 8, 0x2000, 0, 1), "8105"),
        (beats(5, 20_000, 25_000), "8105"),
        ([*serial(1000, 5, 1), *selected(2)], "8105"),
        ([*serial(1000, 5, 1), *serial(9000, 8, 2)], "8105"),
        (
            [
                ask(2700, "5E"),
                answer(2702, "5E07"),
                ask(2710, "0400"),
                *serial(1000, 5, 1),
                *selected(2),
            ],
            "8105",
        ),
        (
            [ask(2950, "5E"), answer(2952, "5E05"), answer(2953, "5E07"), *beats(7, 10, 3095)],
            "8100",
        ),
    ],
    ids=[
        "another was reset",
        "two are gone",
        "a search for new devices",
        "it had no number",
        "it had another one",
        "the number was heard before",
        "the number answered before",
        "the old one is heard again",
        "another was selected",
        "another answers",
        "another was selected after an inquiry",
        "two answered",
    ],
)
def test_what_does_not_prove_that_it_is_the_same_device(more: list[Row], reset: str) -> None:
    told = renumbered(STORED, more, reset=reset)
    (finding,) = found(told, "lss.node_id_changed")
    assert "it is node 8" not in finding.text
    assert not finding.text.startswith("Node 5")
    assert "LOST" in {row.state for row in told.nmt_states if row.node == 5}


@pytest.mark.parametrize(("number", "told"), [(1, True), (2, False)])
def test_a_node_that_hangs_when_another_device_gets_a_number(number: int, told: bool) -> None:
    more = [*serial(1000, 5, number), *selected(2)]
    assert ("nmt.no_boot_up" in ids(renumbered(STORED, more))) == told


def test_an_error_of_the_old_number_is_not_active_for_ever() -> None:
    told = renumbered([frame(1000, 0x085, "0030040000000000")])
    (finding,) = found(told, "emcy.active")
    assert "still active" not in finding.text
    assert "before the node fell silent" in finding.text
