"""The error state machine of a node against errors that are scripted apart from it."""

from dataclasses import dataclass, field

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from syncline_analyzer.folds.emcy.story import (
    MAX_EVIDENCE,
    MAX_LISTED,
    Message,
    Story,
)
from syncline_schemas.devices import Device, load_device
from syncline_schemas.emcy_errors import MAX_ACTIVE, MAX_ALIKE

STEP_NS = 1_000_000


@dataclass
class Machine:
    """A device that keeps CiA 301 7.2.7: every change sends an EMCY with the bits that are left.

    `table` gives register and the maker's five bytes of each code; both are or-ed while several
    errors are there.
    """

    table: dict[int, tuple[int, bytes]]
    active: list[int] = field(default_factory=list)
    messages: list[Message] = field(default_factory=list)
    expected: list[set[int]] = field(default_factory=list)

    def toggle(self, code: int) -> None:
        """An error appears or goes away."""
        if code in self.active:
            self.active.remove(code)
            self._send(0)
        else:
            self.active.append(code)
            self._send(code)

    def _send(self, code: int) -> None:
        register, words = 0, 0
        for error in self.active:
            register |= self.table[error][0]
            words |= int.from_bytes(self.table[error][1], "little")
        data = code.to_bytes(2, "little") + bytes([register]) + words.to_bytes(5, "little")
        seq = len(self.messages)
        self.messages.append(Message(seq, seq * STEP_NS, data))
        self.expected.append(set(self.active))


LIR_ERRORS = {
    0x7320: (0x01, bytes([1, 0, 0, 0, 0])),
    0x5530: (0x80, bytes(5)),
    0x7510: (0x10, bytes(5)),
    0x8130: (0x20, bytes(5)),
    0x6010: (0x01, bytes([0, 0, 4, 0, 0])),
    0x1000: (0x01, bytes([2, 0, 0, 0, 0])),
}
CIA_ERRORS = {
    0x2310: (0x03, bytes(5)),
    0x3120: (0x05, bytes(5)),
    0x4210: (0x09, bytes(5)),
    0x8110: (0x11, bytes(5)),
}
SHARED_ERRORS = {
    0x1000: (0x01, bytes(5)),
    0x9000: (0x01, bytes(5)),
    0x3100: (0x05, bytes(5)),
    0x3200: (0x05, bytes(5)),
    0x4200: (0x09, bytes(5)),
}
"""Errors with bits in common: which of them is gone cannot always be told."""
JN_ERRORS = {0x3100: (0x05, bytes(5)), 0x4200: (0x09, bytes(5)), 0x8130: (0x11, bytes(5))}


def told(messages: list[Message], device: Device | None) -> Story:
    story = Story("can0", 5, device)
    story.tell(messages, [])
    return story


@pytest.mark.parametrize(
    ("table", "device"),
    [
        (LIR_ERRORS, "lir-da158a"),
        (LIR_ERRORS, "lir-ma158k"),
        (JN_ERRORS, "jn2100"),
        (CIA_ERRORS, None),
    ],
)
@given(data=st.data())
@settings(deadline=None)
def test_errors_that_come_and_go_in_any_order(
    table: dict[int, tuple[int, bytes]], device: str | None, data: st.DataObject
) -> None:
    """Where every error has bits of its own, the bits left tell after each message which are there."""
    machine = Machine(table)
    for code in data.draw(st.lists(st.sampled_from(sorted(table)), max_size=20)):
        machine.toggle(code)
    story = told(machine.messages, load_device(device) if device else None)
    assert [set(row.active) for row in story.rows] == machine.expected
    assert story.before == []
    still = {error.code for error in story.errors() if error.status == "still active"}
    assert still == set(machine.active)


@pytest.mark.parametrize("device", ["jn2100", None])
@given(st.lists(st.sampled_from(sorted(SHARED_ERRORS)), max_size=20))
@settings(deadline=None)
def test_an_error_that_is_there_is_never_said_to_be_gone(
    device: str | None, codes: list[int]
) -> None:
    machine = Machine(SHARED_ERRORS)
    for code in codes:
        machine.toggle(code)
    story = told(machine.messages, load_device(device) if device else None)
    for row, expected in zip(story.rows, machine.expected, strict=True):
        assert expected <= set(row.active)
        assert expected or not row.active


def emcys(*data: str) -> list[Message]:
    return [Message(n, n * STEP_NS, bytes.fromhex(text)) for n, text in enumerate(data)]


def active_after(*data: str, device: str | None = None) -> list[list[int]]:
    story = told(emcys(*data), load_device(device) if device else None)
    return [row.active for row in story.rows]


def test_a_shared_register_bit_gives_way_to_the_alarm_word() -> None:
    """LIR: 1000h and 7320h share bit 0; alarm bit 0 says whether the position error is over."""
    sequence = ("0010010000000000", "2073010100000000", "0000010000000000")
    assert active_after(*sequence, device="lir-da158a")[-1] == [0x1000]


def test_a_clear_ends_the_only_error_of_which_no_bit_tells_that_it_stays() -> None:
    """JN2100: bit 0 goes with every error, so 1000h has none of its own."""
    sequence = ("0010010000000000", "0031050000000000", "0000050000000000")
    assert active_after(*sequence, device="jn2100")[-1] == [0x3100]
    repeated = (*sequence[:2], "0042 0D 0000000000", "0000050000000000", "0000050000000000")
    assert active_after(*repeated, device="jn2100")[-1] == [0x1000, 0x3100]


def test_an_error_that_is_told_again_after_a_clear_in_doubt_was_ended_by_it() -> None:
    """JN2100: the second clear repeats the bytes of the first one, which ended 4100h."""
    rows = ("0031050000000000", "00420D0000000000", "00100D0000000000", *["0000050000000000"] * 2)
    story = told(emcys(*rows, "0010050000000000"), load_device("jn2100"))
    told_twice = [e for e in story.errors() if e.code == 0x1000]
    assert [(e.status, e.evidence, e.certain) for e in told_twice] == [
        ("cleared", [2, 4], True),
        ("still active", [5], True),
    ]
    doubted = told(emcys(*rows), load_device("jn2100")).errors()
    assert [e.certain for e in doubted if e.code == 0x1000] == [False]


def test_an_error_that_the_device_repeats_anyway_does_not_end_by_that() -> None:
    first = ("0031050000000000", "00420D0000000000", *["00100D0000000000"] * 2)
    rows = (*first, *["0000050000000000"] * 2, "0010050000000000")
    story = told(emcys(*rows), load_device("jn2100"))
    assert [e.count for e in story.errors() if e.code == 0x1000] == [3]


def test_a_clear_that_may_end_one_of_two_leaves_both_in_doubt() -> None:
    """JN2100: 4100h and 4200h share bit 3."""
    rows = ("0041090000000000", "0042090000000000", "0000090000000000")
    doubted = told(emcys(*rows), load_device("jn2100")).errors()
    assert [(e.status, e.certain) for e in doubted] == [("still active", False)] * 2
    again = told(emcys(*rows, "0042090000000000"), load_device("jn2100")).errors()
    assert [e.certain for e in again] == [False, True]


def test_an_unknown_code_goes_with_the_bits_that_were_new_with_it() -> None:
    sequence = ("01FF810000000000", "0031850000000000", "0000050000000000")
    assert active_after(*sequence)[-1] == [0x3100]


def test_a_clear_may_name_its_error_with_a_register_left() -> None:
    """Maker's bytes as they were with the raise; CANopenNode keeps only the first of them."""
    raised = ("0010011200000000", "0010013400000000")
    assert active_after(*raised, "0000013400000000")[-1] == [0x1000]
    whole = told(emcys(*raised, "0000013400000099"), None)
    (cleared,) = [error for error in whole.errors() if error.status == "cleared"]
    assert cleared.evidence == [1, 2]


def test_a_register_of_zero_clears_everything_where_nothing_is_named() -> None:
    sequence = ("0031050000000000", "0042090000000000", "0000000000000000")
    story = told(emcys(*sequence), None)
    assert story.rows[-1].transition == "all cleared"
    assert [error.status for error in story.errors()] == ["cleared", "cleared"]


@pytest.mark.parametrize("low", range(0, 256, 51))
def test_only_the_high_byte_makes_a_clear(low: int) -> None:
    """JN2100 trap 18: any 00xxh."""
    story = told(emcys("0031050000000000", f"{low:02X}00000000000000"), load_device("jn2100"))
    assert [row.transition for row in story.rows] == ["raised", "all cleared"]


def test_a_bit_that_no_error_explains_is_left_without_a_name() -> None:
    story = told(emcys("0031050000000000", "0000090000000000"), None)
    assert (story.rows[-1].transition, story.rows[-1].active) == ("partly cleared", [])
    assert story.rows[-1].registers == ["generic", "temperature"]


def test_evidence_of_an_error_that_repeats_for_days_stays_short() -> None:
    story = told(emcys(*["3081110000000000"] * 500, "0000000000000000"), None)
    (error,) = story.errors()
    assert (error.count, len(error.evidence)) == (500, MAX_EVIDENCE)
    assert (error.evidence[0], error.evidence[-1]) == (0, 500)


@given(st.lists(st.binary(max_size=9), max_size=30))
@settings(deadline=None)
def test_any_bytes_become_rows(payloads: list[bytes]) -> None:
    story = told([Message(n, n, data) for n, data in enumerate(payloads)], load_device("lir-918"))
    assert len(story.rows) == len(payloads)
    raised = sum(row.transition in ("raised", "further") for row in story.rows)
    assert sum(error.count for error in story.errors()) == raised
    assert all(error.evidence == sorted(error.evidence) for error in story.errors())


def test_makers_bytes_that_change_with_every_message_are_no_fault_numbers() -> None:
    """A measured value or a counter in the maker's bytes: the errors stay few."""
    rows = [f"001001{n:06X}0000" for n in range(2000)]
    story = told(emcys(*rows), None)
    assert len(story.errors()) == MAX_ALIKE
    assert sum(error.count for error in story.errors()) == 2000


def test_codes_without_end_stay_bounded() -> None:
    story = told(
        emcys(*[f"{n & 0xFF:02X}{0x20 + (n >> 8):02X}010000000000" for n in range(600)]), None
    )
    assert len(story.errors()) == MAX_ACTIVE
    assert max(len(row.active) for row in story.rows) == MAX_LISTED
