"""A node whose serial number is another one after a silence: its device was exchanged."""

import pytest

from syncline_schemas.batch import Gap
from tests.analyzer.control_runs import MS, Row, frame
from tests.analyzer.whole_run import beats, found, whole, write


def serial(t_ms: float, number: int) -> list[Row]:
    """A read of 1018h:4 of node 5 and its answer."""
    return [
        frame(t_ms, 0x605, "4018100400000000"),
        frame(t_ms + 1, 0x585, "43181004" + number.to_bytes(4, "little").hex()),
    ]


def cut_short(t_ms: float, number: int) -> list[Row]:
    """The same with two of the four bytes, by a device that counts them wrongly."""
    asked, told = serial(t_ms, number)
    return [asked, (*told[:5], b"\x4b" + told[5][1:])]


def away(*more: list[Row] | Gap, before: int = 1111, after: int = 2222) -> str:
    """What is told of node 5, silent from 3 s to 20 s, with its serial number read around it."""
    rows = [*beats(9, 0, 30_000), *beats(5, 30, 3_000), *beats(5, 20_100, 30_000)]
    rows += [*serial(500, before), frame(20_000, 0x705, "00"), *serial(25_000, after)]
    (finding,) = found(whole(rows, *more), "nmt.node_lost")
    return f"{finding.text} {finding.cause} {finding.check_next}"


@pytest.mark.triggers("nmt.node_lost")
def test_another_serial_number_is_another_device() -> None:
    told = away()
    assert "told 457h as its serial number (1018h:4) at +0.501 s" in told
    assert "and 8AEh at +25.001 s: the device was exchanged in between." in told
    assert "another one took its place" in told
    assert "Check plug" not in told


@pytest.mark.parametrize(("before", "after"), [(1111, 1111), (0, 2222), (1111, 0xFFFFFFFF)])
def test_the_same_or_an_unset_number_is_no_exchange(before: int, after: int) -> None:
    told = away(before=before, after=after)
    assert "exchanged" not in told
    assert "Check plug" in told


@pytest.mark.parametrize(
    "more",
    [
        Gap(1_000 * MS, 1_500 * MS, "overrun"),
        write(1_000, 5, 0x1F51, 1, 0, 1),
        write(1_000, 5, 0x1018, 4, 2222),
        serial(27_000, 1111),
        [frame(22_050, 0x705, "00")],
    ],
    ids=["gap", "program", "written", "old one again", "second start"],
)
def test_what_else_may_explain_the_number(more: list[Row] | Gap) -> None:
    assert "exchanged" not in away(more)


def test_half_of_a_number_is_no_other_one() -> None:
    rows = [*beats(9, 0, 30_000), *beats(5, 30, 3_000), *beats(5, 20_100, 30_000)]
    told = whole(rows, serial(500, 0x10457), cut_short(25_000, 0x0457))
    assert "exchanged" not in found(told, "nmt.node_lost")[0].text


def test_lss_may_have_given_the_number_to_another_device() -> None:
    given = [frame(19_000, 0x7E5, "1105".ljust(16, "0")), frame(19_002, 0x7E4, "11".ljust(16, "0"))]
    told = away(given)
    assert "it is another device, and LSS gave a device this node id at +19.002 s." in told
    assert "exchanged" not in told.split("Was it")[0]


def test_two_devices_that_were_exchanged_together_have_no_supply_in_common() -> None:
    both = [
        row for node in (5, 6) for row in (*beats(node, 30, 3_000), *beats(node, 20_100, 30_000))
    ]
    started = [frame(20_000, 0x705, "00"), frame(20_001, 0x706, "00")]
    told = whole(beats(9, 0, 30_000), both, started, serial(500, 1111), serial(25_000, 2222))
    causes = {each.node: each.cause for each in found(told, "nmt.node_lost")}
    assert "another one took its place" in causes[5]
    assert "supply" in causes[6]


def test_a_device_may_be_exchanged_while_the_machine_is_off() -> None:
    rows = [row for node in (5, 9) for row in beats(node, 0, 3_000)]
    rows += [row for node in (5, 9) for row in beats(node, 20_100, 30_000)]
    started = [frame(20_000, 0x705, "00"), frame(20_001, 0x709, "00")]
    told = whole(rows, started, serial(500, 1111), serial(25_000, 2222))
    (finding,) = found(told, "nmt.bus_silent")
    assert "Node 5 told 457h" in finding.text
    assert "exchanged in between" in finding.text
