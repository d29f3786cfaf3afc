"""What an engineer would tell the owner of each recorded machine, and that the findings say it.

The notes rest on the captures and on the facts that other code counted in them; nothing of the
captures is copied.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import pytest

from syncline_analyzer import open_session
from syncline_analyzer.results import Analysis, Finding, Link

CAPTURES = Path(__file__).parents[3] / "shared" / "captures"


@dataclass(frozen=True)
class Says:
    """A finding, or a link of one, that must be there and hold all these words."""

    id: str
    node: int | None
    words: tuple[str, ...]
    severity: str | None = None


@dataclass(frozen=True)
class Note:
    """What the owner is told; `says` proves it, and no other warning or error may stand beside."""

    capture: str
    told: str
    says: tuple[Says, ...]
    also_allowed: tuple[str, ...] = ()


NOTES = (
    Note(
        "abb_cm588_candump.txt",
        "Node 10 is fine. Your tool asked it for 001Ah:01, which does not exist: the two bytes of the"
        " index 1A00h are exchanged in the request. The EMCY after the boot-up says 'no error'.",
        (Says("sdo.abort", 10, ("001Ah:01", "06020000h", "1A00h"), "info"),),
    ),
    Note(
        "bg_can0_20260113_193431.log",
        "Node 1 does not know 6042h (target velocity): 8 writes and 7 reads were refused. It is not"
        " set up as the drive that your program takes it for. Both restarts were commanded.",
        (Says("sdo.abort", 1, ("6042h", "8", "06020000h"), "warning"),),
    ),
    Note(
        "canopendemo_sdo_block_fragment.txt",
        "The log begins and ends inside a block transfer; nothing in it is wrong.",
        (),
    ),
    Note(
        "deltaq_can1_log.csv",
        "The master (node 1) fell silent at +59.95 s and never came back. The charger (node 10) did"
        " what it must: it missed the heartbeat 0.34 s later, said 8130h and stopped. Look at the"
        " master, not at the charger.",
        (Says("nmt.guarding_lost", 10, ("node 1", "59.951", "8130h", "PRE-OPERATIONAL"), "error"),),
    ),
    Note(
        "hilch_ixxat1.trc",
        "Node 9 was away for 28 s and left 7 guard requests unanswered; 3 s before it was heard again"
        " it sent an empty EMCY, as devices of the old DS-301 V3 do when they start: it had no"
        " power. Node 3 had been error-passive (8120h) before and recovered. Node 2 does not exist,"
        " your master looks for it.",
        (
            Says("nmt.node_lost", 9, ("28.17 s", "7 guard requests"), "error"),
            Says("emcy.active", 3, ("8120h",), "warning"),
            Says("emcy.malformed", 9, ("0 instead of 8 bytes",)),
        ),
        ("emcy.malformed",),
    ),
    Note(
        "hilch_pcan2.trc",
        "Node 15 lost its supply (or was unplugged) at 110 s and came back with a boot-up after 87 s;"
        " everything else is in order. The resets to 2..127 are your master's search for options.",
        (Says("nmt.node_lost", 15, ("87", "boot-up"), "error"),),
    ),
    Note(
        "lely_stm32_candump_td.txt",
        "Node 2 booted and was started; nothing is wrong.",
        (),
    ),
    Note(
        "neg_j1939_bresilla_can_log.txt",
        "This is no CANopen bus.",
        (),
    ),
    Note(
        "roboteq_ros2_candump.txt",
        "Node 1, your ROS master, complains 38 times that a PDO is longer than its mapping (8220h),"
        " each time after 50Ch, which has 8 bytes: compare its RPDO mapping with what node 12 sends."
        " The log has no times, so nothing is said of periods.",
        (
            Says("emcy.pdo_length", 1, ("8220h", "38", "50Ch")),
            Says("emcy.active", 1, ("8220h", "38")),
        ),
    ),
    Note(
        "sevcon_20090330_preop.asc",
        "The controller was switched off and on three times (boot-ups in pairs, 85 ms apart). Each"
        " time it reports its own error 4681h again, and it never leaves PRE-OPERATIONAL. Before the"
        " first time it reported a supply error (3100h, its own 45C3h).",
        (
            Says("nmt.bus_silent", 1, ("2 times", "boot-up"), "warning"),
            Says("nmt.unexpected_reset", 1, ("two boot-up frames", "85"), "warning"),
            Says("emcy.active", 1, ("3100h", "45"), "warning"),
            Says("emcy.active", 1, ("1000h", "still active"), "error"),
            Says("emcy.returns_after_reset", 1, ("2 restarts",)),
        ),
    ),
    Note(
        "sevcon_20090331.candump.log.gz",
        "The controller was switched off and on ten times; nobody but it is on the bus, so the log"
        " cannot say who did it. Its errors 4884h (7 times) and 45C4h, 45C5h (3 times each) come and"
        " go. At the end the recording itself paused for 6.6 s.",
        (
            Says("nmt.bus_silent", 1, ("10 times", "92.48 s", "boot-up"), "warning"),
            Says("emcy.active", 1, ("1000h", "7 times"), "warning"),
            Says("emcy.intermittent", 1, ("6 times",)),
            Says("bus.silent", None, ("6.604 s", "accuses no node"), "warning"),
        ),
        ("sync.jitter", "emcy.active"),
    ),
)

pytestmark = pytest.mark.skipif(not CAPTURES.is_dir(), reason="the captures are not here")
each_note = pytest.mark.parametrize("note", NOTES, ids=lambda note: note.capture)


@cache
def analyzed(capture: str) -> Analysis:
    return open_session(CAPTURES / capture).analyze()


def _pieces(analysis: Analysis) -> Iterator[tuple[Finding, Finding | Link]]:
    """Every finding and link with the finding that tells it."""
    for finding in analysis.findings:
        yield finding, finding
        yield from ((finding, link) for link in finding.chain)


def _fits(says: Says, root: Finding, piece: Finding | Link) -> bool:
    told = f"{piece.text} {root.cause} {root.check_next}"
    return (
        (piece.id, piece.node) == (says.id, says.node)
        and all(word in told for word in says.words)
        and says.severity in (None, root.severity)
    )


@each_note
def test_the_findings_say_what_the_owner_is_told(note: Note) -> None:
    pieces = list(_pieces(analyzed(note.capture)))
    for says in note.says:
        assert any(_fits(says, root, piece) for root, piece in pieces), says


@each_note
def test_nothing_else_is_held_against_the_machine(note: Note) -> None:
    known = {says.id for says in note.says} | set(note.also_allowed)
    others = [
        finding.text
        for finding in analyzed(note.capture).findings
        if finding.severity != "info" and finding.id not in known
    ]
    assert others == []
