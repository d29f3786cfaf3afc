"""Each rule on EMCYs: a case that triggers it, and a near miss that does not."""

import pytest

from syncline_analyzer.findings.story import joined
from syncline_analyzer.results import Finding
from syncline_schemas.batch import Gap
from syncline_schemas.description import BusDescription
from syncline_schemas.devices import load_device
from tests.analyzer.control_runs import MS, Row, Run, frame, run
from tests.analyzer.whole_run import beats, whole

ALIVE = frame(0, 0x705, "05")
POSITION_ERROR = "2073010100000000"
EEPROM_TOO = "3055810100000000"
ALL_CLEAR = "0000000000000000"
VOLTAGE = "0031050000000000"
BOOT_UP = "00"


def emcy(t_ms: float, data: str, node: int = 5) -> Row:
    return frame(t_ms, 0x080 + node, data)


def heartbeats(first_ms: int, last_ms: int, state: str = "05", node: int = 5) -> list[Row]:
    return [frame(t, 0x700 + node, state) for t in range(first_ms, last_ms, 100)]


def written(t_ms: float, index: int, value: int, size: int = 4) -> list[Row]:
    """An expedited write to node 5 and its answer 1 ms later."""
    place = f"{index & 0xFF:02X}{index >> 8:02X}00"
    command = 0x23 | (4 - size) << 2
    data = value.to_bytes(4, "little").hex()
    return [
        frame(t_ms, 0x605, f"{command:02X}{place}{data}"),
        frame(t_ms + 1, 0x585, f"60{place}00000000"),
    ]


def read(t_ms: float, index: int, sub: int, value: int, size: int) -> list[Row]:
    """An expedited read of node 5 and its answer 1 ms later."""
    place = f"{index & 0xFF:02X}{index >> 8:02X}{sub:02X}"
    command = 0x43 | (4 - size) << 2
    data = value.to_bytes(4, "little").hex()
    return [
        frame(t_ms, 0x605, f"40{place}00000000"),
        frame(t_ms + 1, 0x585, f"{command:02X}{place}{data}"),
    ]


def node_5(*rows: Row | list[Row] | Gap, device: str | None = None, **settings: object) -> Run:
    """Frames in order of time, on a bus where node 5 works."""
    flat: list[Row | Gap] = []
    for item in rows:
        flat.extend(item if isinstance(item, list) else [item])
    flat.sort(key=lambda item: item.start_ns if isinstance(item, Gap) else item[0])
    devices = {5: load_device(device)} if device else None
    return run(ALIVE, *flat, devices=devices, **settings)  # type: ignore[arg-type]


def found(result: Run, rule: str) -> list[Finding]:
    return [finding for finding in result.findings() if finding.id == rule]


def one(result: Run, rule: str) -> Finding:
    """The only finding of a rule, which names its evidence and what to do."""
    (finding,) = found(result, rule)
    assert finding.evidence
    assert finding.text.endswith(".")
    assert finding.cause
    assert finding.check_next
    return finding


@pytest.mark.triggers("emcy.active")
def test_an_active_error_is_named_with_the_node_and_its_state() -> None:
    described = BusDescription.loads('[node.5]\nname = "boom sensor"\n')
    result = node_5(heartbeats(100, 2000), emcy(1010, VOLTAGE), description=described)
    finding = one(result, "emcy.active")
    assert finding.severity == "error"
    assert finding.text.startswith(
        "Node 5 (boom sensor) reports mains voltage (3100h) at +1.010 s; it is still active"
    )
    assert finding.cause.startswith("A voltage of the node is too low or too high")
    assert "When it came, the node was OPERATIONAL." in finding.cause
    assert finding.check_next.startswith("Measure the supply")


@pytest.mark.parametrize("code", ["1032", "1023", "2171", "1075"])
def test_a_group_is_no_cause_where_a_profile_divides_it(code: str) -> None:
    """1000h names CiA 402, of which nothing is known here but the names of its objects."""
    error = emcy(1010, f"{code}040000000000")
    finding = one(node_5(read(10, 0x1000, 0, 0x00020192, 4), error), "emcy.active")
    assert "left to the device's profile (CiA 402 by its 1000h)" in finding.cause
    assert "supply" not in finding.cause + finding.check_next
    assert finding.check_next.startswith("Look the code up in the device's manual")


@pytest.mark.parametrize(
    ("kind", "code", "cause"),
    [
        (0x00020192, "3081", "What the node watches"),
        (0x00020192, "0090", "Something outside of the node"),
        (0x00030191, "1032", "A voltage of the node"),
        (0x0004019A, "1032", "A voltage of the node"),
        (0x00000000, "1032", "A voltage of the node"),
        (0x0000FFFF, "1032", "A voltage of the node"),
    ],
)
def test_what_a_profile_does_not_divide_keeps_its_cause(kind: int, code: str, cause: str) -> None:
    error = emcy(1010, f"{code}040000000000")
    told = node_5(read(10, 0x1000, 0, kind, 4), error, timed=False)
    assert one(told, "emcy.active").cause.startswith(cause)


@pytest.mark.near_miss("emcy.active")
def test_no_error_messages_and_short_frames_report_nothing() -> None:
    result = node_5(heartbeats(100, 1000), emcy(50, ALL_CLEAR), emcy(60, "0031"))
    assert found(result, "emcy.active") == []


def test_after_a_gap_an_error_may_be_over() -> None:
    gap = Gap(1100 * MS, 2500 * MS, "adapter lost", None, 0)
    seen = node_5(heartbeats(100, 1100), emcy(1010, VOLTAGE), gap, heartbeats(2500, 4000))
    finding = one(seen, "emcy.active")
    assert finding.severity == "warning"
    assert "the recorder was blind for 1.4 s after it, so it may be over" in finding.text
    again = node_5(
        heartbeats(100, 1100), emcy(1010, VOLTAGE), gap, heartbeats(2500, 4000), emcy(3000, VOLTAGE)
    )
    assert one(again, "emcy.active").severity == "error"


@pytest.mark.near_miss("emcy.active")
@pytest.mark.parametrize(
    "word", [read(3000, 0x1001, 0, 0, 1), read(3000, 0x1003, 0, 0, 1)], ids=["1001h", "1003h"]
)
def test_the_node_itself_says_in_a_read_that_its_error_is_over(word: list[Row]) -> None:
    result = node_5(heartbeats(100, 5000), emcy(1010, VOLTAGE), word)
    finding = one(result, "emcy.active")
    assert finding.severity == "warning"
    assert "cleared after 1.991 s (the node said so when its 1001h or 1003h" in finding.text
    (error,) = result.analysis.errors
    assert (error.status, error.cleared_ns) == ("cleared", 3001 * MS)
    assert error.evidence[-1] == finding.evidence[-1]
    assert error.evidence[-1] in {row.seq for row in result.analysis.sdo}


@pytest.mark.parametrize(
    "rows",
    [
        read(3000, 0x1001, 0, 5, 1),
        read(1000, 0x1001, 0, 0, 1),
        [*written(2000, 0x1003, 0, size=1), *read(3000, 0x1003, 0, 0, 1)],
        [*read(2000, 0x1001, 0, 5, 1), *read(3000, 0x1003, 0, 0, 1)],
        [*read(3000, 0x1001, 0, 0, 1), emcy(3500, VOLTAGE)],
    ],
    ids=["not 0", "before it", "list emptied by a write", "register not 0", "told again"],
)
def test_reads_that_do_not_say_that_an_error_is_over(rows: list[Row]) -> None:
    result = node_5(heartbeats(100, 5000), emcy(1010, VOLTAGE), rows)
    assert [error.status for error in result.analysis.errors] == ["still active"]


def test_a_register_that_the_error_did_not_set_and_one_that_a_read_clears_say_nothing() -> None:
    word = read(3000, 0x1001, 0, 0, 1)
    unset = node_5(heartbeats(100, 5000), emcy(1010, "0031000000000000"), word)
    assert [error.status for error in unset.analysis.errors] == ["still active"]
    latched = node_5(heartbeats(100, 5000), emcy(1010, POSITION_ERROR), word, device="lir-da158")
    assert [error.status for error in latched.analysis.errors] == ["still active"]


def test_an_error_may_be_over_where_the_whole_bus_was_silent_after_it() -> None:
    rows = [*beats(5, 0, 2000), *beats(6, 30, 2000), *beats(5, 4000, 8000), *beats(6, 4030, 8000)]
    raised = [emcy(1010, VOLTAGE)]
    found = whole(sorted([*rows, *raised], key=lambda row: row[0])).findings
    (finding,) = [each for each in found if each.id == "emcy.active"]
    assert finding.severity == "warning"
    assert "nothing at all was heard on the bus for 2." in finding.text


def test_a_node_that_fell_silent_did_not_clear_its_error() -> None:
    other = heartbeats(50, 9000, node=9)
    result = node_5(heartbeats(100, 2000), emcy(1950, VOLTAGE), other)
    assert "was not cleared before the node fell silent" in one(result, "emcy.active").text


def test_an_error_that_a_restart_ends_lasts_until_its_boot_up() -> None:
    boot_up = frame(30_000, 0x705, BOOT_UP)
    finding = one(node_5(heartbeats(100, 29_000), emcy(1010, VOLTAGE), boot_up), "emcy.active")
    assert finding.text.endswith("ended by a restart of the node, not cleared.")
    assert (finding.start_ns, finding.end_ns) == (1010 * MS, 30_000 * MS)


def test_a_clock_that_steps_back_gives_no_negative_duration() -> None:
    rows = [frame(5000, 0x085, VOLTAGE), frame(2000, 0x085, ALL_CLEAR)]
    finding = one(run(ALIVE, *rows), "emcy.active")
    assert finding.text == "Node 5 reports mains voltage (3100h) at +5.000 s; cleared."
    assert finding.end_ns >= finding.start_ns


def test_a_gap_of_another_bus_excuses_nothing() -> None:
    gap = Gap(1100 * MS, 2500 * MS, "adapter lost", None, 1)
    seen = node_5(heartbeats(100, 4000), emcy(1010, VOLTAGE), gap)
    assert one(seen, "emcy.active").severity == "error"


def test_errors_with_an_unspecific_code_are_told_apart() -> None:
    """Sevcon: 1000h stands for many faults, the maker's bytes tell which."""
    result = node_5(emcy(100, "0010018448000000"), emcy(200, "001001C445000000"))
    texts = [finding.text for finding in found(result, "emcy.active")]
    assert ["8448000000" in text for text in texts] == [True, False]
    assert ["C445000000" in text for text in texts] == [False, True]


@pytest.mark.triggers("emcy.partly_cleared")
def test_no_error_with_bits_left_is_not_healthy() -> None:
    """LA20 and trap 6 of the LIR sheet."""
    messages = [POSITION_ERROR, EEPROM_TOO, "0000800000000000"]
    rows = [emcy(100 * (n + 1), data) for n, data in enumerate(messages)]
    finding = one(node_5(rows, device="lir-da158a"), "emcy.partly_cleared")
    assert "it is not healthy: EEPROM error (5530h) is still there" in finding.text
    assert finding.severity == "warning"


def test_errors_of_which_one_is_gone_are_not_said_to_be_there() -> None:
    messages = ["0041090000000000", "0042090000000000", "0000090000000000"]
    rows = [emcy(100 * (n + 1), data) for n, data in enumerate(messages)]
    result = node_5(rows, device="jn2100")
    assert {finding.severity for finding in found(result, "emcy.active")} == {"warning"}
    left = one(result, "emcy.partly_cleared").text
    assert "maybe ambient temperature (4100h), maybe device temperature (4200h) are still" in left


@pytest.mark.near_miss("emcy.partly_cleared")
@pytest.mark.parametrize(
    "after", [emcy(400, ALL_CLEAR), frame(400, 0x705, BOOT_UP)], ids=["all clear", "boot-up"]
)
def test_a_partial_clear_that_is_not_the_last_word(after: Row) -> None:
    messages = [POSITION_ERROR, EEPROM_TOO, "0000800000000000"]
    rows = [emcy(100 * (n + 1), data) for n, data in enumerate(messages)]
    assert found(node_5(rows, after, device="lir-da158a"), "emcy.partly_cleared") == []


@pytest.mark.triggers("emcy.active_before")
@pytest.mark.parametrize(
    ("data", "device", "text"),
    [
        ("0000800000000000", "lir-da158a", "leaves others: EEPROM error (5530h)"),
        ("0000040000000000", None, "leaves others: voltage"),
        ("3081140000000000", "jn2100", "also shows the bits of another error: supply voltage"),
    ],
)
def test_bits_of_an_error_that_no_emcy_raised(data: str, device: str | None, text: str) -> None:
    finding = one(node_5(emcy(100, data), device=device), "emcy.active_before")
    assert text in finding.text
    assert "before the capture began" in finding.cause


@pytest.mark.near_miss("emcy.active_before")
@pytest.mark.parametrize(
    "data", ["3081300000000000", "3055810000000000", "2073110100000000", "1060010000040000"]
)
def test_bits_that_a_lir_may_set_with_an_error_tell_of_no_other(data: str) -> None:
    """The sheet does not say which register bits go together: 0 and 4 prove nothing."""
    assert found(node_5(emcy(100, data), device="lir-da158a"), "emcy.active_before") == []


def test_bits_left_after_a_gap_may_be_of_an_error_that_the_gap_swallowed() -> None:
    gap = Gap(1000 * MS, 1500 * MS, "adapter lost", None, None)
    later = [*heartbeats(1500, 5000), emcy(4050, "0000040000000000")]
    result = node_5(heartbeats(100, 1000), gap, later)
    finding = one(result, "emcy.active_before")
    assert finding.severity == "info"
    assert "while the recorder was blind" in finding.cause
    assert one(result, "emcy.partly_cleared").severity == "warning"


@pytest.mark.triggers("emcy.active_before")
def test_a_clear_of_an_error_that_the_capture_does_not_hold() -> None:
    finding = one(node_5(heartbeats(100, 4000), emcy(3050, ALL_CLEAR)), "emcy.active_before")
    assert (finding.severity, finding.evidence) == ("info", [31])


@pytest.mark.near_miss("emcy.active_before")
def test_no_error_after_a_start_or_a_gap_or_again_and_again_is_nothing() -> None:
    start = [frame(50, 0x705, BOOT_UP)]
    assert (
        found(node_5(start, heartbeats(100, 4000), emcy(3050, ALL_CLEAR)), "emcy.active_before")
        == []
    )
    gap = Gap(1000 * MS, 1500 * MS, "adapter lost", None, None)
    blind = node_5(heartbeats(100, 1000), gap, heartbeats(1500, 5000), emcy(4050, ALL_CLEAR))
    assert found(blind, "emcy.active_before") == []
    often = node_5(heartbeats(100, 5000), [emcy(t, ALL_CLEAR) for t in (3050, 4050)])
    assert found(often, "emcy.active_before") == []


@pytest.mark.triggers("emcy.active_before")
def test_a_register_that_reads_an_error_without_an_emcy() -> None:
    finding = one(node_5(read(500, 0x1001, 0, 0x05, 1)), "emcy.active_before")
    assert "reads 05h (generic, voltage) at +0.501 s" in finding.text
    assert found(node_5(read(500, 0x1001, 0, 0, 1)), "emcy.active_before") == []
    told = node_5(emcy(100, VOLTAGE), read(500, 0x1001, 0, 0x05, 1))
    assert found(told, "emcy.active_before") == []


@pytest.mark.triggers("emcy.storm")
def test_more_than_ten_in_a_second_are_a_storm() -> None:
    rows = [emcy(100 + 50 * n, (POSITION_ERROR, ALL_CLEAR)[n % 2]) for n in range(30)]
    assert (
        "sent 30 EMCYs within 1.45 s at +0.100 s: 15 times position error (7320h)."
        in one(node_5(rows, device="lir-da158a"), "emcy.storm").text
    )


@pytest.mark.near_miss("emcy.storm")
def test_ten_in_a_second_or_many_of_two_nodes_are_no_storm() -> None:
    rows = [emcy(100 + 90 * n, (POSITION_ERROR, ALL_CLEAR)[n % 2]) for n in range(10)]
    other = [emcy(130 + 90 * n, VOLTAGE, node=9) for n in range(10)]
    assert found(node_5(rows, other), "emcy.storm") == []


@pytest.mark.triggers("emcy.intermittent")
def test_an_error_that_comes_and_goes() -> None:
    rows = [emcy(1000 + 2000 * n, (VOLTAGE, ALL_CLEAR)[n % 2]) for n in range(8)]
    finding = one(node_5(heartbeats(100, 20_000), rows), "emcy.intermittent")
    assert "mains voltage (3100h) came and went 4 times within 14 s" in finding.text


@pytest.mark.near_miss("emcy.intermittent")
def test_an_error_that_came_three_times_or_in_a_storm_is_not_intermittent() -> None:
    rows = [emcy(1000 + 2000 * n, (VOLTAGE, ALL_CLEAR)[n % 2]) for n in range(6)]
    assert found(node_5(heartbeats(100, 20_000), rows), "emcy.intermittent") == []
    storm = [emcy(1000 + 20 * n, (VOLTAGE, ALL_CLEAR)[n % 2]) for n in range(40)]
    assert found(node_5(storm), "emcy.intermittent") == []


@pytest.mark.triggers("emcy.returns_after_reset")
def test_a_restart_that_cures_nothing() -> None:
    rows = [emcy(1000, VOLTAGE), frame(1500, 0x000, "8105"), frame(2000, 0x705, BOOT_UP)]
    finding = one(node_5(rows, emcy(2300, VOLTAGE)), "emcy.returns_after_reset")
    assert "came back 300 ms after it" in finding.text
    assert finding.evidence == [1, 3, 4]


@pytest.mark.near_miss("emcy.returns_after_reset")
@pytest.mark.parametrize("later", [emcy(2300, "0042090000000000"), emcy(90_000, VOLTAGE)])
def test_another_error_or_one_much_later_did_not_return(later: Row) -> None:
    rows = [emcy(1000, VOLTAGE), frame(1500, 0x000, "8105"), frame(2000, 0x705, BOOT_UP)]
    assert found(node_5(rows, later), "emcy.returns_after_reset") == []


@pytest.mark.triggers("emcy.after_write")
def test_an_error_right_after_a_write() -> None:
    result = node_5(written(1000, 0x6003, 100), emcy(1003, VOLTAGE))
    finding = one(result, "emcy.after_write")
    assert "raised mains voltage (3100h) 2 ms after an SDO write to it (6003h:00 = " in finding.text
    assert (finding.severity, finding.evidence) == ("info", [1, 3])


@pytest.mark.near_miss("emcy.after_write")
def test_a_write_long_before_and_a_repetition_accuse_no_write() -> None:
    assert found(node_5(written(1000, 0x6003, 1), emcy(1103, VOLTAGE)), "emcy.after_write") == []
    repeated = node_5(emcy(500, VOLTAGE), written(1000, 0x6003, 1), emcy(1003, VOLTAGE))
    assert found(repeated, "emcy.after_write") == []
    other = node_5(written(1000, 0x6003, 1), emcy(1003, VOLTAGE, node=9))
    assert found(other, "emcy.after_write") == []


def test_an_error_that_a_write_raised_is_told_with_the_write() -> None:
    """The write is the root where it raised the error first, not where a repetition met it."""
    result = node_5(written(1000, 0x6003, 100), emcy(1003, VOLTAGE))
    (root,) = [f for f in joined(result.findings()) if f.id.startswith("emcy.")]
    assert (root.id, root.severity) == ("emcy.after_write", "error")
    assert [link.id for link in root.chain] == ["emcy.active"]
    first = [emcy(100, VOLTAGE), emcy(200, ALL_CLEAR)]
    later = node_5(first, written(1000, 0x6003, 100), emcy(1003, VOLTAGE), emcy(1100, ALL_CLEAR))
    assert {f.id for f in joined(later.findings())} == {"emcy.active", "emcy.after_write"}


def test_an_empty_emcy_is_a_boot_up_of_the_old_kind() -> None:
    """hilch_ixxat1: 089h without data, as devices after CiA DS-301 V3 start."""
    described = BusDescription.loads('[node.5]\nname = "valve"')
    finding = one(node_5(emcy(100, ""), emcy(900, ""), description=described), "emcy.malformed")
    assert finding.text == (
        "Node 5 (valve) sent 2 empty EMCYs at +0.100 s, +0.900 s (0 instead of 8 bytes): most"
        " likely it started."
    )
    assert finding.severity == "info"
    assert "DS-301 V3" in finding.cause
    both = found(node_5(emcy(100, ""), emcy(900, "0031")), "emcy.malformed")
    assert [(f.severity, len(f.evidence)) for f in both] == [("info", 1), ("warning", 1)]


@pytest.mark.triggers("emcy.inhibit_time")
def test_two_emcys_inside_the_inhibit_time() -> None:
    result = node_5(written(1, 0x1015, 500, 2), emcy(100, VOLTAGE), emcy(120, ALL_CLEAR))
    assert (
        "the first at +0.120 s came 20 ms after the one before instead of 50 ms (sdo-write)"
        in one(result, "emcy.inhibit_time").text
    )


@pytest.mark.near_miss("emcy.inhibit_time")
def test_the_inhibit_time_holds_from_its_write_to_the_next() -> None:
    pair = [emcy(100, VOLTAGE), emcy(120, ALL_CLEAR)]
    assert found(node_5(pair), "emcy.inhibit_time") == []
    assert found(node_5(pair, written(200, 0x1015, 500, 2)), "emcy.inhibit_time") == []
    off = node_5(written(1, 0x1015, 500, 2), written(50, 0x1015, 0, 2), pair)
    assert found(off, "emcy.inhibit_time") == []
    wide = node_5(written(1, 0x1015, 500, 2), emcy(100, VOLTAGE), emcy(160, ALL_CLEAR))
    assert found(wide, "emcy.inhibit_time") == []


@pytest.mark.triggers("emcy.malformed")
@pytest.mark.parametrize(
    ("data", "reason"),
    [
        ("07", "1 instead of 8 bytes: a SYNC with counter 7"),
        ("0031", "2 instead of 8 bytes: only the code 3100h (mains voltage)"),
        ("003105", "register 05h, 5 of the maker's 5 bytes missing"),
        ("00310500000000", "register 05h, 1 of the maker's 5 bytes missing"),
    ],
)
def test_a_short_emcy_says_what_is_wrong_with_it(data: str, reason: str) -> None:
    finding = one(node_5(emcy(100, data)), "emcy.malformed")
    assert reason in finding.text
    assert finding.text.startswith("1 frame on the EMCY identifier of node 5 does not have eight")


@pytest.mark.near_miss("emcy.malformed")
def test_a_whole_emcy_is_not_malformed() -> None:
    assert found(node_5(emcy(100, VOLTAGE)), "emcy.malformed") == []


@pytest.mark.triggers("emcy.register_mismatch")
def test_an_error_code_with_an_empty_register() -> None:
    """hilch_ixxat1: 8120h with register 00h."""
    result = node_5(emcy(100, "2081000628000000"), emcy(200, "2081000628000000"))
    finding = one(result, "emcy.register_mismatch")
    assert (
        "reports CAN in error passive mode (8120h) at +0.100 s with an error register of 00h"
        in (finding.text)
    )
    assert "in 2 EMCYs" in finding.text


@pytest.mark.near_miss("emcy.register_mismatch")
def test_an_error_that_the_sheet_shows_in_the_warnings_only() -> None:
    """LIR: 6010h, a reset by the watchdog, is warning bit 2."""
    watchdog = node_5(emcy(100, "1060000000040000"), device="lir-da158a")
    assert found(watchdog, "emcy.register_mismatch") == []
    assert found(node_5(emcy(100, VOLTAGE), emcy(200, ALL_CLEAR)), "emcy.register_mismatch") == []


@pytest.mark.triggers("emcy.unknown_code")
def test_codes_that_nobody_knows() -> None:
    result = node_5(emcy(100, "3412010000000000"), emcy(200, "3512010000000000"))
    finding = one(result, "emcy.unknown_code")
    assert "2 codes (1234h, 1235h) that CiA 301 does not explain" in finding.text
    lir = one(node_5(emcy(100, "3412010000000000"), device="lir-918"), "emcy.unknown_code")
    assert "1 code (1234h) that neither CiA 301 nor the table of" in lir.text


@pytest.mark.near_miss("emcy.unknown_code")
@pytest.mark.parametrize(
    ("data", "device"), [("3055800000000000", "lir-da158a"), ("11FF810000000000", None)]
)
def test_codes_of_a_table_or_a_group_are_known(data: str, device: str | None) -> None:
    assert found(node_5(emcy(100, data), device=device), "emcy.unknown_code") == []


@pytest.mark.triggers("emcy.while_stopped")
def test_an_emcy_of_a_stopped_node() -> None:
    rows = heartbeats(1000, 9000, state="04")
    finding = one(node_5(heartbeats(100, 1000), rows, emcy(4050, VOLTAGE)), "emcy.while_stopped")
    assert "sent 1 EMCY while it was STOPPED" in finding.text


@pytest.mark.near_miss("emcy.while_stopped")
def test_an_emcy_around_a_change_of_state_is_no_breach() -> None:
    rows = heartbeats(1000, 5000, state="04") + heartbeats(5000, 9000)
    late = node_5(heartbeats(100, 1000), rows, emcy(4950, VOLTAGE))
    assert found(late, "emcy.while_stopped") == []
    early = node_5(heartbeats(100, 1000), rows, emcy(1005, VOLTAGE))
    assert found(early, "emcy.while_stopped") == []


@pytest.mark.triggers("emcy.pdo_length")
def test_a_pdo_of_the_wrong_length_is_named() -> None:
    mapping = [
        *written(10, 0x1405, 0x325),  # a record beyond the predefined four is left alone
        frame(20, 0x605, "2301140125030000"),
        frame(21, 0x585, "6001140100000000"),
        frame(30, 0x605, "2F01160001000000"),
        frame(31, 0x585, "6001160000000000"),
        frame(40, 0x605, "2301160110000062"),
        frame(41, 0x585, "6001160100000000"),
    ]
    rows = [frame(99, 0x205, "01"), frame(99.5, 0x325, "0102"), frame(99.8, 0x205, "01")]
    right = node_5(mapping, rows, frame(99.9, 0x325, "010203"), emcy(100, "2082110000000000"))
    finding = one(right, "emcy.pdo_length")
    assert "RPDO2 (325h) with 3 bytes, its mapping takes 2 100 us earlier" in finding.text.replace(
        "0.1 ms", "100 us"
    )
    assert finding.assumed == []


@pytest.mark.parametrize("batch", [1, 1 << 20])
def test_a_pdo_length_error_with_only_predefined_identifiers_says_what_it_assumes(
    batch: int,
) -> None:
    rows = [frame(99, 0x205, "01020304"), emcy(100, "1082110000000000")]
    result = node_5(rows, batch=batch)
    finding = one(result, "emcy.pdo_length")
    assert "RPDO1 (205h) with 4 bytes 1 ms earlier" in finding.text
    assert finding.assumed == ["RPDO1 of node 5 is 205h (predefined)"]
    alone = one(node_5(emcy(100, "1082110000000000")), "emcy.pdo_length")
    assert alone.text.endswith("; no PDO of another node came just before.")
    foreign = one(
        node_5(
            [frame(t, 0x50C, "0102030405060708") for t in (99, 199)],
            [emcy(t, "2082110000000000") for t in (100, 200)],
        ),
        "emcy.pdo_length",
    )
    assert "the last PDO before it was 50Ch with 8 bytes (2 times)." in foreign.text


@pytest.mark.near_miss("emcy.pdo_length")
def test_other_protocol_errors_name_no_rpdo() -> None:
    result = node_5(frame(99, 0x205, "01020304"), emcy(100, "4082110000000000"))
    assert found(result, "emcy.pdo_length") == []


@pytest.mark.triggers("emcy.history_unseen")
def test_old_errors_in_the_list_are_information() -> None:
    reads = [*read(500, 0x1003, 0, 1, 1), *read(510, 0x1003, 1, 0x5530, 4)]
    finding = one(node_5(reads, device="lir-da158a"), "emcy.history_unseen")
    assert finding.severity == "info"
    assert (
        "1003h of node 5, read at +0.511 s, holds EEPROM error (5530h), which came before this"
        in finding.text
    )


@pytest.mark.triggers("emcy.history_unseen")
def test_an_error_newer_than_one_that_was_seen_was_missed() -> None:
    reads = [*read(500, 0x1003, 1, 0x3100, 4), *read(510, 0x1003, 2, 0x4200, 4)]
    result = node_5(emcy(100, "0042090000000000"), reads)
    finding = one(result, "emcy.history_unseen")
    assert finding.severity == "warning"
    assert "mains voltage (3100h), which came during this capture without an EMCY" in finding.text


@pytest.mark.triggers("emcy.history_unseen")
def test_a_list_that_grew_by_more_than_the_emcys() -> None:
    """LIR trap 15: 1015h hides EMCYs."""
    reads = [*read(500, 0x1003, 0, 1, 1), *read(1500, 0x1003, 0, 4, 1)]
    finding = one(node_5(reads, emcy(1000, VOLTAGE)), "emcy.history_unseen")
    assert "holds at +1.501 s 3 errors more than at the read before; EMCYs told 1 of them." in (
        finding.text
    )
    assert "inhibit time 1015h held it back" in finding.cause


def test_errors_that_the_inhibit_time_held_back() -> None:
    """LIR trap 15: the list was empty inside the capture, and 0000h makes no entry."""
    inhibit = written(1, 0x1015, 10_000, 2)
    reads = [*read(5000, 0x1003, 0, 3, 1), *read(5010, 0x1003, 1, 0x3100, 4)]
    more = [*read(5020, 0x1003, 2, 0x3100, 4), *read(5030, 0x1003, 3, 0x3100, 4)]
    empty = read(500, 0x1003, 0, 0, 1)
    result = node_5(inhibit, empty, emcy(1000, VOLTAGE), emcy(3000, ALL_CLEAR), reads, more)
    told = found(result, "emcy.history_unseen")
    assert [f.severity for f in told] == ["warning", "warning"]
    assert "came during this capture without an EMCY" in told[0].text
    assert "EMCYs told 1 of them" in told[1].text
    assert all("held the EMCY back (1015h = 10000: one in 1 s, sdo-write)" in f.cause for f in told)


@pytest.mark.near_miss("emcy.history_unseen")
def test_a_list_that_the_bus_told_is_no_finding() -> None:
    reads = [
        *read(500, 0x1003, 0, 2, 1),
        *read(510, 0x1003, 1, 0x0001_3100, 4),
        *read(520, 0x1003, 2, 0x4200, 2),
        *read(530, 0x1003, 3, 0, 4),
    ]
    result = node_5(emcy(100, "0042090000000000"), emcy(200, VOLTAGE), reads)
    assert found(result, "emcy.history_unseen") == []


@pytest.mark.triggers("emcy.cleared_by_read")
def test_a_register_that_was_cleared_by_its_read() -> None:
    """LIR trap 7: 80h, then 00h, no EMCY between."""
    reads = [*read(500, 0x1001, 0, 0x80, 1), *read(900, 0x1001, 0, 0, 1)]
    result = node_5(emcy(100, "3055800000000000"), reads, device="lir-da158")
    finding = one(result, "emcy.cleared_by_read")
    assert "went back to 00h because it was read" in finding.text


@pytest.mark.near_miss("emcy.cleared_by_read")
def test_a_register_that_an_emcy_or_another_device_cleared() -> None:
    reads = [*read(500, 0x1001, 0, 0x80, 1), *read(900, 0x1001, 0, 0, 1)]
    told = node_5(emcy(100, "3055800000000000"), reads, emcy(700, ALL_CLEAR), device="lir-da158")
    assert found(told, "emcy.cleared_by_read") == []
    other = node_5(emcy(100, "3055800000000000"), reads, device="jn2100")
    assert found(other, "emcy.cleared_by_read") == []


@pytest.mark.triggers("emcy.register_unexplained")
def test_a_register_that_shows_an_error_after_all_is_clear() -> None:
    rows = [emcy(100, VOLTAGE), emcy(200, ALL_CLEAR)]
    finding = one(node_5(rows, read(500, 0x1001, 0, 0x09, 1)), "emcy.register_unexplained")
    assert "reads 09h (generic, temperature) at +0.501 s although its last EMCY" in finding.text


@pytest.mark.near_miss("emcy.register_unexplained")
def test_a_register_read_at_once_across_a_gap_or_of_a_device_that_keeps_bits() -> None:
    rows = [emcy(100, VOLTAGE), emcy(200, ALL_CLEAR)]
    rule = "emcy.register_unexplained"
    assert found(node_5(rows, read(202, 0x1001, 0, 0x05, 1)), rule) == []
    assert found(node_5(rows, read(500, 0x1001, 0, 0x01, 1), device="lir-da158"), rule) == []
    gap = Gap(300 * MS, 400 * MS, "adapter lost", None, None)
    assert found(node_5(rows, gap, read(500, 0x1001, 0, 0x09, 1)), rule) == []


def test_a_log_without_times_is_judged_by_its_order() -> None:
    rows = [emcy(0, VOLTAGE), *read(0, 0x1001, 0, 0x05, 1)]
    result = node_5(rows, timed=False)
    assert result.ids() == ["emcy.active"]
    assert [row.state for row in result.analysis.emcy_context] == ["OPERATIONAL"]


def test_nodes_of_two_buses_with_one_number_have_their_own_errors() -> None:
    other = [frame(0, 0x705, "05", bus=1), frame(300, 0x085, ALL_CLEAR, bus=1)]
    result = node_5(emcy(100, VOLTAGE), other, read(500, 0x1001, 0, 0x05, 1))
    finding = one(result, "emcy.active")
    assert (finding.bus, finding.severity) == ("can0", "error")
    assert result.ids() == ["emcy.active"]
