"""Findings on the recording itself: gaps, damaged files, lines that could not be read."""

from collections.abc import Iterator

from syncline_analyzer.findings.rule import Facts, Rule
from syncline_analyzer.findings.stretch import seconds
from syncline_analyzer.results import Finding, GapRow
from syncline_schemas.can_errors import RECORDER_OFF, RECORDER_OVERFLOW
from syncline_schemas.wording import counted

MAX_GAPS = 10
"""More gaps with one reason on one bus become one finding."""
_NOT_CLOSED = ": no footer"
"""All that is said of a recording that was cut off and is whole up to there."""
_SHOWN = 6
"""Identifiers that a sentence names."""
_UNREAD = 0.01
"""Share of unreadable lines from which a log may be of another kind than it seems."""


def _gaps(facts: Facts) -> Iterator[Finding]:
    """Gaps by reason, but for those that other findings tell."""
    groups: dict[tuple[str | None, str], list[GapRow]] = {}
    for gap in facts.analysis.capture.gaps:
        if gap.reason not in (RECORDER_OFF, RECORDER_OVERFLOW):
            groups.setdefault((gap.bus, gap.reason), []).append(gap)
    for group in groups.values():
        if len(group) > MAX_GAPS:
            yield _gap(facts, group)
        else:
            yield from (_gap(facts, [gap]) for gap in group)


def _gap(facts: Facts, group: list[GapRow]) -> Finding:
    first, last = group[0], group[-1]
    lost = sum(gap.lost_frames or 0 for gap in group)
    verb = "was" if lost == 1 else "were"
    lost_text = f"; {counted(lost, 'frame')} {verb} lost" if lost else ""
    lengths = [gap.end_ns - gap.start_ns for gap in group]
    blind = f"blind for {seconds(lengths[0])}{facts.at(first.start_ns)}"
    if len(group) > 1:
        blind = f"blind {len(group)} times, for up to {seconds(max(lengths))}"
    return Finding(
        "capture.gap",
        "info",
        first.bus,
        None,
        first.start_ns,
        last.end_ns,
        f"The recorder was {blind} ({first.reason}){lost_text}:"
        f" nothing is concluded from {'that time' if len(group) == 1 else 'these times'}.",
        f"The recording itself was interrupted ({first.reason}); the machine is not at fault.",
        "The adapter, its plug, and the load of the recording computer at that time.",
        [],
    )


def _damaged(facts: Facts) -> Iterator[Finding]:
    """Files of which a part could not be read."""
    capture = facts.analysis.capture
    for damage in capture.damage:
        yield Finding(
            "capture.damaged",
            "info" if _NOT_CLOSED in damage else "warning",
            None,
            None,
            capture.begin_ns,
            capture.end_ns,
            f"A part of the capture could not be read: {damage}.",
            "The recorder lost its supply while it wrote, or the file was cut off when it was"
            " copied.",
            "Copy the file again; what could be read was analyzed.",
            [],
        )


def _unparsed(facts: Facts) -> Iterator[Finding]:
    """Lines of a log that are neither frames nor anything else that is known."""
    capture = facts.analysis.capture
    if not capture.unparsed_lines:
        return
    many = capture.unparsed_lines > _UNREAD * max(capture.frames, 1)
    yield Finding(
        "capture.unparsed",
        "warning" if many else "info",
        None,
        None,
        capture.begin_ns,
        capture.end_ns,
        f"{counted(capture.unparsed_lines, 'line')} of the log could not be read, beside"
        f" {counted(capture.frames, 'frame')} that could.",
        "The file was cut off or edited, or a program wrote other text between the frames.",
        "Look at these lines (syncline info names the first ones); a frame in them is missing here.",
        [],
    )


def _doubled(facts: Facts) -> Iterator[Finding]:
    """Frames that stand twice in the capture, by bus."""
    for row in facts.analysis.doubled:
        shown = ", ".join(f"{cob_id:03X}h" for cob_id in row.cob_ids[:_SHOWN])
        more = " and more" if len(row.cob_ids) > _SHOWN else ""
        what = {
            "all": f"Every frame of {row.bus} stands",
            "own": f"What the master sends on {row.bus} ({shown}{more}) stands",
            "some": f"Frames of {row.bus} ({shown}{more}) stand",
        }[row.scope]
        whole = row.scope == "all"
        yield Finding(
            "capture.doubled",
            "warning" if whole else "info",
            row.bus,
            None,
            row.start_ns,
            row.end_ns,
            f"{what} twice in the capture, the copy {row.delay_us:.4g} us after its frame:"
            f" nothing that is told here counts the {counted(row.copies, 'second frame')}.",
            "Two channels on one bus were recorded under one name, or a file was joined with itself."
            if whole
            else "The recording computer sent these frames itself, and its driver handed over each"
            " one twice: as sent and as received.",
            "Record each bus once."
            if whole
            else "Switch off the echo of own frames in the recording program; the bus is not at"
            " fault.",
            row.evidence,
        )


RULES = (
    Rule(
        "capture.gap",
        "The recorder was blind; nothing is concluded from that time.",
        "The gap itself, as the recorder noted it.",
        ("Only gaps that the recorder noted; its own bus-off and overruns are told as such.",),
        _gaps,
        untimed=True,
    ),
    Rule(
        "capture.damaged",
        "A part of the capture could not be read.",
        "What the reader says of the file.",
        ("A recording that merely was not closed is told as a note.",),
        _damaged,
        untimed=True,
    ),
    Rule(
        "capture.unparsed",
        "Lines of the log could not be read.",
        "Their number.",
        ("Comments, headers and statistics of the known formats are read and left out.",),
        _unparsed,
        untimed=True,
    ),
    Rule(
        "capture.doubled",
        "The recording holds frames twice; the copies are left out of the analysis.",
        "The first copies.",
        (
            "Equal frames at most 1 ms apart, in pairs that lie much further apart than their frames.",
            (
                "One identifier alone only where no wire can carry the second frame so soon: a fast"
                " producer and two devices with one node id take longer."
            ),
            "Not where the stamps are those of bundles or too coarse to tell.",
        ),
        _doubled,
    ),
)
