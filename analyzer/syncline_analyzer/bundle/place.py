"""Which stretch of a capture a bundle holds: around a finding, or from and to a moment."""

import re

from syncline_analyzer.bundle.capture_file import Stretch
from syncline_analyzer.moments import Moment, parse_moment
from syncline_analyzer.results import Analysis, Finding
from syncline_schemas.errors import UsageError

BEFORE_NS, AFTER_NS = 60_000_000_000, 30_000_000_000
"""What is kept around a finding: a minute before it, half a minute after it."""
_LONGEST_NS = 600_000_000_000
"""Of a finding that lasts longer, the beginning is kept."""

_NAMED = re.compile(r"([a-z0-9_]+\.[a-z0-9_]+)(?:@(\d{1,3}))?")


def finding_at(analysis: Analysis, text: str) -> Finding:
    """The finding that a user means: "3" is the third of the report, "nmt.node_lost@5" one by name.

    Raises:
        UsageError: there is no such finding; the message names those that there are.
    """
    found = analysis.findings
    if text.isdecimal():
        if 1 <= int(text) <= len(found):
            return found[int(text) - 1]
    elif match := _NAMED.fullmatch(text):
        for finding in found:
            node = str(finding.node or "")
            if finding.id == match[1] and match[2] in (None, node):
                return finding
    known = ", ".join(dict.fromkeys(finding.id for finding in found)) or "none at all"
    raise UsageError(
        f"--around {text}: no such finding; write its place in the report (1 is the first), its id, or"
        f" id@node. There are: {known}"
    )


def around(finding: Finding, before_ns: int = BEFORE_NS, after_ns: int = AFTER_NS) -> Stretch:
    """The stretch with a finding, what followed from it, and some time before and after."""
    pieces = (finding.as_link(), *finding.chain)
    start, end = min(p.start_ns for p in pieces), max(p.end_ns for p in pieces)
    end = min(end, start + _LONGEST_NS)
    return Stretch(start - before_ns, end + after_ns + 1)


def between(start: str | None, end: str | None, first_ns: int) -> Stretch:
    """The stretch from one moment to before another, as `--from` and `--to` say them.

    Raises:
        UsageError: a text is no time, or nothing lies between them.
    """
    moments: list[Moment | None] = [parse_moment(t) if t else None for t in (start, end)]
    low, high = (m.resolved(first_ns) if m else None for m in moments)
    if low is not None and high is not None and low >= high:
        raise UsageError("the range is empty: --from is not before --to")
    return Stretch(low, high)
